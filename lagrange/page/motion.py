"""What a page computes with: the exported JavaScript of a system, and how it is called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError
from lagrange.export.contents import module_of, wanted
from lagrange.export.registry import find, missing_operation
from lagrange.machine.model import Model
from lagrange.statement.statement import Statement

TARGET = "javascript"

ALWAYS = ("rhs", "energy", "dop853")
"""What every page computes with, beside what only some systems have."""

TOLERANCE = 1e-13
"""Both tolerances of the steps. The double pendulum then drifts by some 1e-12 in a minute; a picture takes 30 us."""

MOST_STEPS = 5000
"""Steps from one recorded state to the next at most; a pendulum takes one."""


@dataclass(frozen=True)
class MotionSource:
    """The exported module, the values of its parameters, and the contents that it has."""

    text: str
    parameters: tuple[float, ...]
    contents: tuple[str, ...]
    constrained: bool

    @property
    def script(self) -> str:
        """The module with the call that hands its functions to the page.

        An inline module cannot be imported, so that the call stands in it.
        """
        names = ["prepare", "STATE", "PREPARED", *self.contents]
        if self.constrained:
            names.append("projection")
        return f"{self.text}\nstartPage({{ {', '.join(names)} }});\n"


def contents(statement: Statement) -> tuple[str, ...]:
    """Return the contents of the module of a system."""
    found = {"energies": not statement.lagrangian_alone, "positions": bool(statement.positions)}
    return (*ALWAYS, *(name for name, there in found.items() if there))


def motion_source(model: Model, parameters: Mapping[Any, Any] | None) -> MotionSource:
    """Return the module of a model. Raises StatementError for functions that JavaScript has not."""
    target, asked = find(TARGET), contents(model.statement)
    module = module_of(model, wanted(target, model, asked, ()), (), parameters)
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, function = missing
        raise StatementError(
            f"a page of {model.statement.name} cannot be made: its {quantity} contains {function}, which JavaScript "
            "has no function for."
        )
    (text,) = target.files(module).values()
    return MotionSource(str(text), module.values, asked, len(model.equations.constraints) > 0)
