"""The computations of a page: the exported JavaScript of a system, and the call that starts it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError
from lagrange.export.contents import module_of, wanted
from lagrange.export.target import find, missing_operation
from lagrange.machine.model import Model
from lagrange.statement.statement import Statement

TARGET = "javascript"

METHOD = "dop853"
"""Integration method with which a page computes the motion."""


class NoPage(StatementError):
    """Error: a page cannot compute the motion of this system."""


ALWAYS = ("rhs", "energy", METHOD)
"""Quantities that every page exports; some systems add others."""

TOLERANCE = 1e-13
"""Relative and absolute tolerance of the steps. The double pendulum drifts by some 1e-12 in a minute; a picture takes
30 us."""

PAGE_STEPS = 5000
"""Largest number of steps between two recorded states; a pendulum takes one."""


@dataclass(frozen=True)
class MotionSource:
    """The exported JavaScript module of a system, its parameter values, and the names of the quantities it computes."""

    text: str
    parameters: tuple[float, ...]
    contents: tuple[str, ...]
    constrained: bool

    @property
    def script(self) -> str:
        """The module, followed by the call that passes its functions to the page.

        An inline module cannot be imported, so the call is inside it.
        """
        names = ["prepare", "STATE", "PREPARED", *self.contents]
        if self.constrained:
            names.append("projection")
        return f"{self.text}\nstartPage({{ {', '.join(names)} }});\n"


def contents(statement: Statement) -> tuple[str, ...]:
    """Return the names of the quantities that the module of a system exports."""
    found = {"energies": not statement.lagrangian_alone, "positions": bool(statement.positions)}
    return (*ALWAYS, *(name for name, there in found.items() if there))


def motion_source(model: Model, parameters: Mapping[Any, Any] | None) -> MotionSource:
    """Return the module of a model. Raises NoPage for functions that JavaScript lacks."""
    target, asked = find(TARGET), contents(model.statement)
    module = module_of(model, wanted(target, model, asked, (), parameters), (), parameters)
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, function = missing
        raise NoPage(
            f"a page of {model.statement.name} cannot be made: its {quantity} contains {function}, which JavaScript "
            "has no function for."
        )
    text = target.files(module)[f"{module.name}.mjs"]
    return MotionSource(str(text), module.values, asked, len(model.equations.constraints) > 0)
