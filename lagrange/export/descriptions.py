"""What the comments of an exported file say, in every language."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lagrange.export.comments import TOGETHER, plain
from lagrange.export.module import Integrator, Run, SourceModule
from lagrange.procedure.form import Procedure, Record, ReserveRecord, inner
from lagrange.procedure.outcome import Outcome

TEST = (
    "The test: results at some states, computed with 40 digits. A result may be off by 1e-12 of itself; where it is a "
    "small difference of large numbers, by 1e-12 of the largest one at that state."
)
"""What is compared with what, and how closely; behind it stands what a language does with the result."""

MOST_STEPS = 10_000_000
"""Steps between two rows of `main` at most."""

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""The tolerances of an adaptive run in the test, and its steps at most."""


def places(array: str, names: Sequence[str], element: str = "{0}[{1}]", first: int = 0) -> str:
    """Return what stands at each place of an array, in a language that spells elements so and counts from `first`."""
    shown = [f"{element.format(array, k)}{TOGETHER}{name}" for k, name in enumerate(names, first)]
    return ", ".join(shown) or f"{array} is empty"


OUTCOMES: Mapping[Outcome, str] = {
    Outcome.DONE: "done",
    Outcome.PAUSED: "max_steps reached",
    Outcome.NON_FINITE: "the state is not finite",
    Outcome.SINGULAR: "a matrix is singular",
    Outcome.STEP_TOO_SMALL: "the step became too small",
    Outcome.DIVERGED: "Newton's method diverged",
    Outcome.UNPROJECTED: "the state could not be moved onto the constraints",
}
"""What the numbers mean that integrators return."""


def outcomes() -> str:
    """Return what the numbers mean that integrators return."""
    return "Integrators return " + ", ".join(f"{int(code)}: {text}" for code, text in OUTCOMES.items()) + "."


def about_of(module: SourceModule, procedure: Procedure) -> str:
    """Return what a public function does."""
    quantity = next((one for one in module.quantities if one.procedure is procedure), None)
    if quantity is None:
        return procedure.about
    return f"{quantity.about} out: {', '.join(quantity.results)}."


def sizes(module: SourceModule) -> list[tuple[str, int, str]]:
    """Return the lengths of all arrays: a name, the length, and what it counts."""
    return [
        ("state", len(module.state), "numbers in y: coordinates, then velocities"),
        ("parameters", len(module.parameters), "numbers in parameters"),
        ("prepared", max(module.prepared, 1), "numbers in p: parameters, and what depends on them alone"),
        *((one.name, len(one.results), f"numbers in out of {one.name}") for one in module.quantities),
    ]


def columns(module: SourceModule) -> str:
    """Return the first line of the table that `main` writes."""
    return ",".join(["t", *map(plain, module.state)])


def run_of(module: SourceModule) -> tuple[Run, Integrator] | None:
    """Return what `main` does and the integrator that does it, None where it is not exported."""
    if module.run is None:
        return None
    return module.run, next(one for one in module.integrators if one.adaptive)


def integrator_of(module: SourceModule, name: str) -> Integrator:
    """Return an integrator by name."""
    return next(one for one in module.integrators if one.name == name)


def records_of(procedures: Sequence[Procedure]) -> list[Record]:
    """Return every record of some procedures, each once."""
    found: dict[Record, None] = {}
    for procedure in procedures:
        found |= dict.fromkeys(one.type for one in procedure.parameters if isinstance(one.type, Record))
        blocks = [procedure.body]
        while blocks:
            for statement in blocks.pop():
                if isinstance(statement, ReserveRecord):
                    found[statement.record] = None
                blocks += inner(statement)
    return list(found)
