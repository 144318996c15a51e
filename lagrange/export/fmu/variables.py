"""The variables of an FMU: names, references and kinds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

from lagrange.export.descriptions import run_of
from lagrange.export.module import SourceModule

HIDDEN = ("jacobian",)
"""Quantities without variables: they serve directional derivatives only."""

STATE, DERIVATIVE, PARAMETER, INPUT = "state", "derivative", "parameter", "input"
RESULT, INDICATOR = "result", "indicator"
"""Kinds of variables: a result of a quantity, and an event indicator."""


@dataclass(frozen=True)
class ScalarVariable:
    """A real variable of an FMU; `start` is its initial value.

    For the derivative of a state `of` is the reference of that state.
    """

    name: str
    reference: int
    kind: str
    about: str = ""
    unit: str = ""
    start: float | None = None
    of: int = 0


def places(module: SourceModule) -> dict[str, int]:
    """Return the reference of the first result of each quantity, those of rhs first."""
    found, place = {}, 1 + len(module.state) + len(module.parameters)
    for one in module.quantities:
        found[one.name] = place
        place += len(one.results)
    return found


def variables(module: SourceModule) -> list[ScalarVariable]:
    """Return the variables in the order of their references: state, parameters, derivatives, results.

    Names are those of the statement; a name that is taken gets a number as suffix.
    """
    named = _namer()
    exported_run = run_of(module)
    assert exported_run is not None  # an FMU always has a run
    initial = exported_run[0].initial
    half, first = len(module.state) // 2, []
    for k, name in enumerate(module.state):
        about = f"velocity of {module.state[k - half]}" if k >= half else "coordinate"
        first.append(ScalarVariable(named(name), 1 + k, STATE, about, module.units.get(name, ""), initial[k]))
    for k, name in enumerate(module.parameters, 1 + len(module.state)):
        value = module.values[k - 1 - len(module.state)]
        kind = INPUT if name in module.inputs else PARAMETER
        about = "input: may change at any time" if kind == INPUT else "parameter"
        first.append(ScalarVariable(named(name), k, kind, about, module.units.get(name, ""), value))
    return [*first, *_results(module, named)]


def _results(module: SourceModule, named: Callable[[str], str]) -> Iterator[ScalarVariable]:
    """Yield the variables of results, quantity by quantity, for `rhs` the derivatives of the state."""
    first = places(module)
    for one in module.quantities:
        for k, name in enumerate(one.results):
            reference = first[one.name] + k
            if one.name == "rhs":
                state = module.state[k]
                about = f"time derivative of {state}"
                yield ScalarVariable(
                    named(f"der({state})"), reference, DERIVATIVE, about, _rate_unit(module, k), of=1 + k
                )
            elif one.name not in HIDDEN:
                kind = INDICATOR if one.name == "events" else RESULT
                yield ScalarVariable(named(name), reference, kind, one.about, one.unit)


def _rate_unit(module: SourceModule, k: int) -> str:
    """Return the unit of the derivative of an entry of the state, or "" if it is not stated."""
    half = len(module.state) // 2
    if k < half:
        return module.units.get(module.state[k + half], "")
    unit, time = module.units.get(module.state[k - half], ""), module.units.get("t", "")
    return f"{unit}/{time}2" if unit and time.isalpha() else ""


def _namer() -> Callable[[str], str]:
    """Return a function that makes names unique by a number as suffix."""
    taken = {"time": None}

    def named(name: str) -> str:
        tries = (name if k == 1 else f"{name}_{k}" for k in count(1))
        free = next(attempt for attempt in tries if attempt not in taken)
        taken[free] = None
        return free

    return named
