"""Numbers and calls in the test and the run of an exported file, as text of a language."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from lagrange.export.descriptions import integrator_of, outcome_texts, run_of
from lagrange.export.lines import number_lines
from lagrange.export.module import SourceModule, StepCheck
from lagrange.procedure.form import Parameter, Procedure
from lagrange.procedure.spelling import Literals

MOST_STEPS = 10_000_000
"""Largest number of steps between two rows of the table of `main`."""

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""Tolerances of an adaptive run in the test, and its largest number of steps."""


def macro(module: SourceModule, program: str) -> str:
    """Return the name of the macro that enables a program of a file, "test" or "main"."""
    return f"{module.name.upper()}_{program.upper()}"


def compiled(module: SourceModule, program: str, compiler: str, source: str) -> list[str]:
    """Return shell lines that compile and run a program that a macro enables; `source` ends the compiler's line."""
    name = f"{module.name}_{program}"
    return [f"{compiler} -D{macro(module, program)} -o {name} {source}", f"./{name}"]


def tested(module: SourceModule) -> list[str]:
    """Return the names of the functions that are tested."""
    return [*(one.name for one in module.checks), *(one.name for one in module.step_checks)]


def results_tested(module: SourceModule) -> int:
    """Return the number of results that the test compares."""
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
    """Return the arguments of an integrator in its test, in the order of parameters that a language has.

    `time` is a template with the start time of an adaptive run in place of "{}".
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
    """Return the fields of the template of `main` as text, by name, or None if `main` is not exported."""
    exported_run = run_of(module)
    if exported_run is None:
        return None
    run, integrator = exported_run
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
    """Yield lines with lists of numbers, the arguments of a call that is indented by four spaces."""
    for values in rows:
        yield f"        {opening}"
        yield from number_lines(map(literals.real, values), "            ")
        yield "        ],"
