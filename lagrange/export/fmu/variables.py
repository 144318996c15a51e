"""The variables of an FMU: names, references, and what an environment may do with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

from lagrange.export.descriptions import run_of
from lagrange.export.module import SourceModule

HIDDEN = ("jacobian",)
"""Quantities without variables: derivatives in a direction are what they are for."""

STATE, DERIVATIVE, PARAMETER, INPUT = "state", "derivative", "parameter", "input"
RESULT, INDICATOR = "result", "indicator"
"""Kinds of variables."""


@dataclass(frozen=True)
class Variable:
    """A real variable: `start` is its first value; `of` is the reference of the state that a derivative belongs to."""

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


def variables(module: SourceModule) -> list[Variable]:
    """Return the variables in the order of their references: state, parameters, derivatives, results.

    Names are those of the statement; one that is taken gets a number behind it.
    """
    named = _namer()
    asked = run_of(module)
    assert asked is not None  # an FMU always has a run
    initial = asked[0].initial
    found = [
        Variable(named(name), 1 + k, STATE, unit=module.units.get(name, ""), start=initial[k])
        for k, name in enumerate(module.state)
    ]
    for k, name in enumerate(module.parameters, 1 + len(module.state)):
        value = module.values[k - 1 - len(module.state)]
        kind = INPUT if name in module.inputs else PARAMETER
        found.append(Variable(named(name), k, kind, unit=module.units.get(name, ""), start=value))
    return [*found, *_results(module, named)]


def _results(module: SourceModule, named: Callable[[str], str]) -> Iterator[Variable]:
    """Yield the variables of results: derivatives of the state, then what else is exported."""
    first = places(module)
    for one in module.quantities:
        for k, name in enumerate(one.results):
            reference = first[one.name] + k
            if one.name == "rhs":
                yield Variable(named(f"der({module.state[k]})"), reference, DERIVATIVE, of=1 + k)
            elif one.name not in HIDDEN:
                kind = INDICATOR if one.name == "events" else RESULT
                yield Variable(named(name), reference, kind, one.about)


def _namer() -> Callable[[str], str]:
    """Return what gives each name once."""
    taken = {"time": None}

    def named(name: str) -> str:
        tries = (name if k == 1 else f"{name}_{k}" for k in count(1))
        found = next(one for one in tries if one not in taken)
        taken[found] = None
        return found

    return named
