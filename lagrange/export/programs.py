"""The programs beside an exported file: its self-test, and `main`, which runs the initial state.

The same code fills in both programs for all languages, from templates in the folder `templates`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from lagrange.algorithm.constants import Outcome
from lagrange.export.descriptions import OUTCOMES, TEST, columns, commented, number_lines, run_of
from lagrange.export.module import SourceModule, StepCheck
from lagrange.export.templates import templates
from lagrange.procedure.spelling import Literals

MOST_STEPS_PER_ROW = 10_000_000  # Largest number of steps between two rows of the table of `main`

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""Tolerances of an adaptive run in the test, and its largest number of steps."""


@dataclass(frozen=True)
class Script:
    """The self-test and the program `main` in a language.

    - `language` is the name of the file of its templates. `head` and `tail` are the text before and after all tests.
      `quantity` is the test of a quantity, `integrator` the test of a step or run. Their field `tables` has lists of
      numbers, and `table` is the template of one list. `main` is missing in languages without integrators.
    - `comment` returns a text as comment lines.
    - `literals` spells numbers, and `quoted` spells a name as a string.
    - `time` writes the start time of a run, as an argument that the run changes.
    - `more` ends a line of numbers that continues on the next line.
    - If `chunk` is not 0, a list is split into parts of at most `chunk` numbers.
    """

    language: str
    comment: Callable[[str], Sequence[str]]
    literals: Literals
    time: str = "{0}"
    more: str = ""
    chunk: int = 0
    quoted: Callable[[str], str] = '"{}"'.format

    def filled(self, template: str, fields: Mapping[str, object], **extra_fields: object) -> str:
        """Return the text of the template with this name in the language, with values for its fields."""
        return templates(self.language)[template].substitute(fields, **extra_fields)


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
    text.append(script.filled("head", fields))
    for check in module.checks:
        rows = {"states": check.states, "expected": check.results, "allowed": check.allowed}
        lists = {"times": check.times} | {name: tuple(chain(*values)) for name, values in rows.items()}
        sizes = {"results": len(check.results[0]), "samples": len(check.times)}
        text.append(script.filled("quantity", fields, **sizes, **_named(check.name, script, lists)))
    for step in module.step_checks:
        lists = {"state": step.state, "expected": step.result, "allowed": step.allowed}
        call = {"arguments": _arguments(module, step, script), "time": script.literals.real(step.time)}
        text.append(script.filled("integrator", fields, **call, **_named(step.name, script, lists)))
    return "".join([*text, script.filled("tail", fields)])


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
    """Return the fields of a test: its name, and the text of its lists of numbers, `lists` by name."""
    tables = ""
    for table, values in lists.items():
        for begin in range(0, len(values), script.chunk or len(values) or 1):
            part = values[begin : begin + script.chunk] if script.chunk else values
            numbers = number_lines(map(script.literals.real, part), " " * 12)
            fields = {"table": table, "first": begin + 1, "last": begin + len(part), "size": len(values)}
            tables += script.filled("table", fields, numbers=f"{script.more}\n".join(numbers).removesuffix(","))
    return {"name": name, "quoted": script.quoted(name), "tables": tables}


def _arguments(module: SourceModule, check: StepCheck, script: Script) -> str:
    """Return the text of the arguments with which a test calls an integrator."""
    integrator = next(candidate for candidate in module.integrators if candidate.name == check.name)
    literals = script.literals
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
    (run, integrator), literals = run_of(module), script.literals
    meanings = (OUTCOMES.get(code, "the run ended early") for code in Outcome)
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
        "outcomes": "".join(f'    "{meaning}",\n' for meaning in meanings).rstrip(),
        "columns": columns(module),
        **extra_fields,
    }
    return "\n".join([*script.comment(about), "", script.filled("main", fields)])
