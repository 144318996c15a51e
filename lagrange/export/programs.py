"""The numbers that the test and the run of an exported file are made of, as a language writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from lagrange.export.descriptions import integrator_of, outcome_texts, run_of
from lagrange.export.lines import number_lines
from lagrange.export.module import SourceModule, StepCheck
from lagrange.procedure.form import Parameter, Procedure
from lagrange.procedure.spelling import Literals

MOST_STEPS = 10_000_000
"""Steps between two rows of `main` at most."""

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""The tolerances of an adaptive run in the test, and its steps at most."""


def macro(module: SourceModule, program: str) -> str:
    """Return the macro that switches one of the programs of a file on, "test" or "main"."""
    return f"{module.name.upper()}_{program.upper()}"


def compiled(module: SourceModule, program: str, compiler: str, source: str) -> list[str]:
    """Return shell lines that compile a program that a macro switches on, and run it; `source` ends the first."""
    name = f"{module.name}_{program}"
    return [f"{compiler} -D{macro(module, program)} -o {name} {source}", f"./{name}"]


def tested(module: SourceModule) -> list[str]:
    """Return the names of the functions that are tested."""
    return [*(one.name for one in module.checks), *(one.name for one in module.step_checks)]


def results_tested(module: SourceModule) -> int:
    """Return how many results the test compares."""
    quantities = sum(len(one.results) * len(one.results[0]) for one in module.checks)
    return quantities + sum(len(one.result) for one in module.step_checks)


def arguments_in_test(
    module: SourceModule,
    check: StepCheck,
    literals: Literals,
    time: str,
    y: str = "y",
    order: Callable[[Procedure], Sequence[Parameter]] = lambda procedure: procedure.parameters,
) -> str:
    """Return what an integrator is given in its test, in the order in which a language has parameters.

    `time` is what a run is given as the time at which it begins, with the place of the number in it.
    """
    integrator, begin = integrator_of(module, check.name), literals.real(check.time)
    given = {"y": y, "p": "p"}
    if integrator.adaptive:
        tolerances = dict.fromkeys(("rtol", "atol"), literals.real(TEST_TOLERANCE))
        end = literals.real(check.time + check.length)
        given |= {"t": time.format(begin), "t_end": end, **tolerances, "max_steps": literals.whole(TEST_STEPS)}
    else:
        given |= {"t": begin, "h": literals.real(check.length)}
    return ", ".join(given[one.name] for one in order(integrator.procedure))


def main_fields(module: SourceModule, literals: Literals) -> dict[str, str] | None:
    """Return what `main` is made of, by name; None where it is not exported."""
    found = run_of(module)
    if found is None:
        return None
    run, integrator = found
    return {
        "initial": ", ".join(map(literals.real, run.initial)),
        "t_end": literals.real(run.t_end),
        "intervals": literals.whole(run.intervals),
        "method": integrator.name,
        "rtol": literals.real(run.rtol),
        "steps": literals.whole(MOST_STEPS),
        "outcomes": "".join(f"        {text},\n" for text in outcome_texts()).rstrip(),
    }


def tables(rows: Sequence[Sequence[float]], literals: Literals, opening: str = "[") -> Iterator[str]:
    """Yield lists of numbers, the arguments of a call that stands four places in."""
    for values in rows:
        yield f"        {opening}"
        yield from number_lines(map(literals.real, values), "            ")
        yield "        ],"
