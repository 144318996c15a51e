"""The programs beside an exported file: its self-test, and `main`, which runs the initial state.

The same code fills in both programs for all languages. A `Script` has their templates in one language.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from lagrange.export.descriptions import TEST, columns, commented, integrator_of, number_lines, outcome_texts, run_of
from lagrange.export.module import SourceModule, StepCheck
from lagrange.procedure.spelling import Literals

MOST_STEPS_PER_ROW = 10_000_000  # Largest number of steps between two rows of the table of `main`

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""Tolerances of an adaptive run in the test, and its largest number of steps."""


@dataclass(frozen=True)
class Script:
    """Templates of the self-test and of `main` in a language, with fields in braces.

    - `comment` returns a text as comment lines. `head` and `tail` are the text before and after all tests.
    - `quantity` is the test of a quantity, `integrator` the test of a step or run. Their {tables} are lists of
      numbers.
    - `table` is the template of one list. If `chunk` is not 0, a list is split into parts of at most `chunk` numbers.
    - `more` ends a line of numbers that continues on the next line.
    - `literals` spells numbers, and `quoted` spells a name as a string.
    - `time` writes the start time of a run, as an argument that the run changes.
    - `main` is the program `main`; it is empty in languages without integrators.
    """

    comment: Callable[[str], Sequence[str]]
    head: str
    quantity: str
    table: str
    tail: str
    literals: Literals
    integrator: str = ""
    time: str = "{0}"
    main: str = ""
    more: str = ""
    chunk: int = 0
    quoted: Callable[[str], str] = '"{}"'.format


def marked(mark: str) -> Callable[[str], Sequence[str]]:
    """Return a function that returns a text as comment lines, each after `mark`."""
    return lambda text: commented(text, mark)


def test_text(module: SourceModule, script: Script, **extra_fields: object) -> str:
    """Return the self-test: a program that compares results of the exported functions with expected ones.

    The expected results of quantities were computed in multiple precision. `extra_fields` are values for further
    fields of the templates in `script`.
    """
    fields = {**fields_of(module), **extra_fields}
    text = ["\n".join([*script.comment(f"Self-test of {module.name}. {TEST} Exit status 0 if all are right."), "", ""])]
    text.append(script.head.format(**fields))
    for check in module.checks:
        lists = dict(zip(("times", "states", "expected", "allowed"), check.flat, strict=True))
        sizes = {"results": len(check.results[0]), "samples": len(check.times)}
        text.append(script.quantity.format(**fields, **sizes, **_named(check.name, script, lists)))
    for step in module.step_checks:
        lists = {"state": step.state, "expected": step.result, "allowed": step.allowed}
        call = {"arguments": _arguments(module, step, script), "time": script.literals.real(step.time)}
        text.append(script.integrator.format(**fields, **call, **_named(step.name, script, lists)))
    return "".join([*text, script.tail.format(**fields)])


def fields_of(module: SourceModule) -> dict[str, object]:
    """Return the values of the fields that all templates share: names, lengths, and the number of tested results."""
    quantities = sum(len(check.results) * len(check.results[0]) for check in module.checks)
    return {
        "module": module.name,
        "states": len(module.state),
        "prepared": max(module.prepared, 1),
        "count": quantities + sum(len(check.result) for check in module.step_checks),
    }


def _named(name: str, script: Script, lists: Mapping[str, Sequence[float]]) -> dict[str, str]:
    return {"name": name, "quoted": script.quoted(name), "tables": "".join(_tables(script, lists))}


def _tables(script: Script, lists: Mapping[str, Sequence[float]]) -> Iterator[str]:
    """Yield the text of each list of numbers of a test; `lists` has the numbers by the name of the list."""
    for table, values in lists.items():
        for begin in range(0, len(values), script.chunk or len(values) or 1):
            part = values[begin : begin + script.chunk] if script.chunk else values
            numbers = number_lines(map(script.literals.real, part), " " * 12)
            yield script.table.format(
                table=table,
                numbers=f"{script.more}\n".join(numbers).removesuffix(","),
                first=begin + 1,
                last=begin + len(part),
                size=len(values),
            )


def _arguments(module: SourceModule, check: StepCheck, script: Script) -> str:
    """Return the text of the arguments with which a test calls an integrator."""
    integrator, literals = integrator_of(module, check.name), script.literals
    begin = literals.real(check.time)
    texts = {"y": "y", "p": "p"}
    if integrator.adaptive:
        tolerances = dict.fromkeys(("rtol", "atol"), literals.real(TEST_TOLERANCE))
        end = literals.real(check.time + check.length)
        texts |= {"t": script.time.format(begin), "t_end": end, **tolerances, "max_steps": literals.whole(TEST_STEPS)}
    else:
        texts |= {"t": begin, "h": literals.real(check.length)}
    return ", ".join(texts[parameter.name] for parameter in integrator.procedure.parameters)


def main_text(module: SourceModule, script: Script, **extra_fields: object) -> str:
    """Return the program `main`, which runs the initial state and prints a table of states over time.

    `extra_fields` are values for further fields of the template in `script`. The module must have a run.
    """
    exported = run_of(module)
    assert exported is not None
    run, integrator = exported
    literals = script.literals
    about = (
        f"Integrate the initial state of {module.name} and write a table with commas. Arguments: [t_end [intervals]]."
    )
    fields = {
        **fields_of(module),
        "initial": ", ".join(map(literals.real, run.initial)),
        "t_end": literals.real(run.t_end),
        "intervals": literals.whole(run.intervals),
        "method": integrator.name,
        "rtol": literals.real(run.rtol),
        "steps": literals.whole(MOST_STEPS_PER_ROW),
        "outcomes": "".join(f"    {text},\n" for text in outcome_texts()).rstrip(),
        "columns": columns(module),
        **extra_fields,
    }
    return "\n".join([*script.comment(about), "", script.main.format(**fields)])
