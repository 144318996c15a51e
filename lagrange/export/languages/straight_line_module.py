"""A module of Python with quantities for a library that traces functions, and with their test."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from lagrange.export.comments import commented
from lagrange.export.descriptions import TEST, statement_comment
from lagrange.export.languages.straight_line import LITERALS, Library, bracketed
from lagrange.export.module import Check, SourceModule
from lagrange.export.python_module import named_places
from lagrange.program.program import Program


def straight_line_module(
    module: SourceModule,
    library: Library,
    setting: str,
    functions: Callable[[Program, str], str],
    use: str,
    evaluated: str,
) -> str:
    """Return a module of functions without loops; run as a program, it tests itself.

    `setting` is a line behind the imports, `functions` prints those of a program under a name, `use` says how they are
    called, and `evaluated` is the text of `_evaluated(function, times, states)`, which calls the one with the status.
    """
    head, *helpers = library.text_before(*(one.program for one in module.quantities)).split("\n\n\n")
    lines = [
        *statement_comment(module, "#"),
        "",
        "import sys",
        "",
        *head.splitlines(),
        "",
        *([setting, ""] if setting else []),
        f"STATE = {len(module.state)}  # numbers in y: coordinates, then velocities",
        f"PARAMETERS = {len(module.parameters)}  # numbers in p",
        *named_places(module, "p"),
        *commented(" ".join(use.split()), "#"),
        *(line for text in helpers for line in ("", "", *text.splitlines())),
    ]
    for one in module.quantities:
        lines += ["", "", *commented(f"{one.about} Results: {', '.join(one.results)}.", "#")]
        lines += functions(one.program, one.name).splitlines()
    return "\n".join([*lines, "", "", *test(module, evaluated)]) + "\n"


COMPARED = '''\
def _compared(name, function, times, states, wanted, allowed):
    """Print the results that are not within what they may be off; return how many there are and how many are wrong."""
    found, singular = _evaluated(function, times, states)
    checked = failures = 0
    for k, row in enumerate(wanted):
        checked += len(row)
        if singular[k]:
            print(f"{name}, state {k}: a matrix is singular")
            failures += len(row)
            continue
        for i, value in enumerate(found[k]):
            if not abs(value - row[i]) <= allowed[k][i]:
                print(f"{name}, state {k}, result {i}: {value!r} instead of {row[i]!r}")
                failures += 1
    return checked, failures


def test():
    """Compare results with those of multiple precision; return 0 if all are right, else 1."""
    counts = ['''

RESULT = """\
    ]
    checked, failures = sum(one for one, _ in counts), sum(one for _, one in counts)
    print(f"{name}: {{checked - failures}} of {{checked}} results are right")
    return 0 if failures == 0 else 1


if __name__ == "__main__":
    sys.exit(test())"""


def test(module: SourceModule, evaluated: str) -> Iterator[str]:
    """Yield the test: a function that compares results with those of multiple precision."""
    yield from evaluated.splitlines()
    yield ""
    yield ""
    yield from commented(f"{TEST} Failures are printed. Exit status 0 if all are right, else 1.", "#")
    yield from COMPARED.splitlines()
    for check in module.checks:
        yield from _comparison(check)
    yield from RESULT.format(name=module.name).splitlines()


def _comparison(check: Check) -> Iterator[str]:
    yield "        _compared("
    yield f'            "{check.name}",'
    yield f"            {check.name}_checked,"
    yield from _row(check.times, 12)
    for rows in (check.states, check.results, check.allowed):
        yield "            ["
        for row in rows:
            yield from _row(row, 16)
        yield "            ],"
    yield "        ),"


def _row(values: Sequence[float], indent: int) -> list[str]:
    return [" " * indent + line for line in bracketed("[", list(map(LITERALS.real, values)), "],")]
