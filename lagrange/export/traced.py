"""Python modules for libraries that trace what a function does: functions without loops, a module, and its test.

A library provides the spelling of every operation, and the text of two functions. `_factored(order, *lower)` returns
the factors of a symmetric matrix, and whether it is singular. `_solved(factors, *right)` returns the solution of a
linear system as a list.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from lagrange.algorithm.linear.symmetric import PIVOT, PREFERENCE
from lagrange.export.descriptions import TEXT_WIDTH, commented, distinct, named_places, statement_comment
from lagrange.export.module import SourceModule
from lagrange.export.programs import Script, marked, test_text
from lagrange.export.straight_line import Language, StraightLinePrinter
from lagrange.export.target import Target
from lagrange.machine.python_source import LITERALS as PYTHON_LITERALS
from lagrange.machine.python_source import RAISING
from lagrange.procedure.spelling import Operator
from lagrange.program.program import Program, ProgramBlock

OPERATORS: Mapping[str, Operator] = {
    op: RAISING[op] for op in ("neg", "add", "sub", "mul", "div", "fma", "less", "less_equal", "equal")
}
"""Operations that Python's operators express, in every library."""

LITERALS = replace(PYTHON_LITERALS, infinity='float("inf")', nan='float("nan")')

ELIMINATION = f'''
PIVOT = {PIVOT!r}  # a matrix is singular where a pivot is at most this part of its row's largest entry
PREFERENCE = {PREFERENCE!r}  # constraints are preferred as pivots to inertias, which may be rounding alone


def _is_zero(x):
    return isinstance(x, float) and x == 0.0


def _open_units(n, a):
    """Return units that make the diagonal one in size, and the largest entry of rows without a diagonal entry."""
    units = [None] * n
    for i in range(n):
        if not _is_zero(a[i][i]):
            inertia = abs(a[i][i])
            units[i] = 1.0 / _sqrt(_where(inertia > 0.0, inertia, 1.0))
    for i in reversed(range(n)):
        if units[i] is None:
            size = 0.0
            for x, unit in zip(a[i], units):
                size = size if unit is None or _is_zero(x) else _most(size, abs(x) * unit)
            units[i] = None if _is_zero(size) else 1.0 / _where(size > 0.0, size, 1.0)
    return [1.0 if unit is None else unit for unit in units]


def _rows(n, lower):
    """Return the rows of the matrix in units that make its diagonal one if it is positive, and the units.

    These are NaN where an entry is not finite: such a matrix is not singular, and the solution is NaN.
    """
    a = [[lower[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)] for j in range(n)] for i in range(n)]
    positive, finite = a[0][0] > 0.0, True
    for x in lower:
        finite = finite if _is_zero(x) else _both(finite, abs(x) <= {sys.float_info.max!r})
    for i in range(1, n):
        positive = _both(positive, a[i][i] > 0.0)
    if any(_is_zero(a[i][i]) for i in range(n)):
        units = _open_units(n, a)
    else:
        units = [_where(positive, 1.0 / _sqrt(_where(positive, a[i][i], 1.0)), 1.0) for i in range(n)]
    units = [_fixed(_where(finite, unit, float("nan"))) for unit in units]
    rows = [[0.0 if _is_zero(x) else units[i] * x * units[j] for j, x in enumerate(a[i])] for i in range(n)]
    return rows, units


def _eliminated(n, rows):
    """Return P A = L U with scaled row exchanges, and whether a pivot vanishes; entries known to be zero are left.

    Of two rows the determinant takes the place of the exchanges.
    """
    a, exchanges, largest = [list(row) for row in rows], [], []
    for row in a:
        size = 0.0
        for x in row:
            size = size if _is_zero(x) else _most(size, abs(x))
        largest.append(_fixed(size))
    if any(_is_zero(a[i][i]) for i in range(n)):
        largest = [_fixed(1.0 / PREFERENCE if _is_zero(a[i][i]) else 1.0) for i in range(n)]
    singular = False
    if n == 2:
        determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0]
        pivot = _most(abs(a[0][0]) * largest[1], abs(a[1][0]) * largest[0])
        singular = _either(abs(determinant) <= PIVOT * pivot, pivot <= PIVOT * largest[0] * largest[1])
        return (a, determinant), singular
    for j in range(n):
        for i in range(j + 1, n):
            if not _is_zero(a[i][j]):
                swap = abs(a[i][j]) * largest[j] > abs(a[j][j]) * largest[i]
                pairs = [_exchanged(swap, x, y) for x, y in zip(a[j], a[i])]
                a[j], a[i] = [x for x, _ in pairs], [y for _, y in pairs]
                largest[j], largest[i] = _exchanged(swap, largest[j], largest[i])
                exchanges.append((j, i, swap))
        vanishes = _either(abs(a[j][j]) <= PIVOT * largest[j], a[j][j] == 0.0)
        singular = _either(singular, vanishes)
        for i in range(j + 1, n):
            if not _is_zero(a[i][j]):
                a[i][j] = a[i][j] / a[j][j]
                for k in range(j + 1, n):
                    if not _is_zero(a[j][k]):
                        a[i][k] = a[i][k] - a[i][j] * a[j][k]
    return (a, exchanges), singular


def _exchanged(swap, x, y):
    return (x, y) if _is_zero(x) and _is_zero(y) else (_where(swap, y, x), _where(swap, x, y))


def _substituted(eliminated, right):
    """Return the solution of an eliminated system."""
    (a, exchanges), b = eliminated, list(right)
    if len(b) == 2:
        determinant = exchanges
        return [(a[1][1] * b[0] - a[0][1] * b[1]) / determinant, (a[0][0] * b[1] - a[1][0] * b[0]) / determinant]
    for j, i, swap in exchanges:
        b[j], b[i] = _exchanged(swap, b[j], b[i])
    for i in range(len(b)):
        for k in range(i):
            if not _is_zero(a[i][k]):
                b[i] = b[i] - a[i][k] * b[k]
    for i in reversed(range(len(b))):
        for k in range(i + 1, len(b)):
            if not _is_zero(a[i][k]):
                b[i] = b[i] - a[i][k] * b[k]
        b[i] = b[i] / a[i][i]
    return b
'''
"""Text of an elimination with row exchanges, instead of loops, which a library cannot trace. It calls `_where`,
`_both`, `_either`, `_most`, `_sqrt` and `_fixed`. The latter keeps a factor out of derivatives to which it does not
contribute."""


@dataclass(frozen=True)
class Library:
    """A library of array functions: its spellings, and the texts of its files.

    - `head` are the first lines of a file, and `setting` is a line that follows them in a module.
    - `systems` is the text of the functions for linear systems.
    - `functions` is the text of a program's two functions, with fields in braces: its name, and that with the suffix
      _checked, which also returns whether a mass matrix is singular. `results` are templates of a result that is a
      number, a vector or a matrix.
    - `use` explains in the docstring of a module how its functions are called; `alone` does so for a single function.
    - `evaluated` is the text of `evaluated(function, times, states)`, with which the test calls a function.
    """

    language: Language
    head: str
    systems: str
    functions: str
    results: tuple[str, str, str]
    use: str
    alone: str
    evaluated: str
    setting: str = ""

    def text_before(self, *programs: Program) -> str:
        """Return the text before the functions of the programs: imports and the helpers that the functions need."""
        used = dict.fromkeys(instruction.op for program in programs for instruction in program.instructions)
        parts = [self.head, *self.language.definitions(used), *([self.systems.strip()] if "factor" in used else [])]
        return "\n\n\n".join(parts)

    def source(self, program: Program, name: str, about: Sequence[str] = ()) -> str:
        """Return the text of a file with the functions of one program; `about` are lines of its docstring.

        Raises StatementError for an operation that the library does not have.
        """
        title = f"{name}(t, y, p) for {self.language.name}: {described(program)}."
        text = "\n".join([title, "", self.alone.format(name=name), *(("", *about) if about else ())])
        return f'"""{text}\n"""\n\n{self.text_before(program)}\n\n\n{self.printed(program, name, {})}'

    def module(self, module: SourceModule) -> str:
        """Return the text of a module with the functions of all quantities."""
        names = replace(module.names, state=(), parameters=(), entries=distinct(module.names.entries))
        head, *helpers = self.text_before(*(quantity.program for quantity in module.quantities)).split("\n\n\n")
        lines = [
            *statement_comment(module, "#"),
            "",
            *head.splitlines(),
            "",
            *([self.setting, ""] if self.setting else []),
            f"STATE = {len(module.state)}  # numbers in y: coordinates, then velocities",
            f"PARAMETERS = {len(module.parameters)}  # numbers in p",
            *named_places(module, "p"),
            *commented(" ".join(self.use.split()), "#"),
            *(line for text in helpers for line in ("", "", *text.splitlines())),
        ]
        for quantity in module.quantities:
            lines += ["", "", *commented(f"{quantity.about} Results: {', '.join(quantity.results)}.", "#")]
            lines += self.printed(quantity.program, quantity.name, names.of(quantity.program)).splitlines()
        return "\n".join([*lines, ""])

    def printed(self, program: Program, name: str, names: Mapping[int, str]) -> str:
        """Return the text of the two functions of a program. `names` maps an instruction to the name of its value."""
        lines, singular = function_body(program, self.language, names)
        return self.functions.format(
            name=name,
            described=described(program),
            body=textwrap.indent("\n".join(lines), "    "),
            singular=singular,
            states=program.states,
            parameters=program.parameters,
            results=self.results[len(program.shape)].format(program.shape),
        )

    @property
    def script(self) -> Script:
        """Return the templates of the self-test for this library."""
        evaluated = self.evaluated.replace("{", "{{").replace("}", "}}")
        return Script(
            comment=marked("#"),
            head=f"import sys\n\nimport {{file}} as model\n{evaluated}{COMPARED}",
            quantity="    failures += wrong(\n        {quoted},\n        model.{name}_checked,\n{tables}    )\n",
            table="        [\n{numbers},\n        ],\n",
            tail=TAIL,
            literals=LITERALS,
        )


class TracedTarget(Target):
    """A target whose files are a Python module for a library, and its test."""

    library: ClassVar[Library]
    contents = frozenset()
    shell = ("python {name}_{program}.py",)

    def file_name(self, module: SourceModule) -> str:
        """Return the name of the module's file without its suffix: it ends in the name of the library."""
        return f"{module.name}_{self.name}"

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the module and its test, by file name."""
        name, library = self.file_name(module), self.library
        return {f"{name}.py": library.module(module), f"{name}_test.py": test_text(module, library.script, file=name)}


def language(name: str, operations: Mapping[str, Operator], helpers: Mapping[str, str]) -> Language:
    """Return the table of spellings of a library; `operations` and `helpers` are the spellings of its functions."""
    return Language(
        name=name,
        operations=operations,
        literals=LITERALS,
        helpers=helpers,
        factor="{name}, {other} = _factored({order}, {entries})",
        solve="{name} = _solved({other}, {entries})",
    )


def function_body(program: Program, language: Language, names: Mapping[int, str]) -> tuple[list[str], str]:
    """Return the lines that compute the list `results`, and the text of the condition that a matrix is singular.

    The lines have no indentation. `names` maps an instruction's index to the name of a matrix entry.
    """
    printer = StraightLinePrinter(program, language, names)
    lines = []
    for letter, count in (("y", program.states), ("p", program.parameters)):
        if count:
            lines += bracketed("(", [f"{letter}{i}" for i in range(count)], f"{',' * (count == 1)}) = {letter}")
    for line in printer.values():
        before, opened, after = line.partition("(")
        lines += bracketed(before + opened, after[:-1].split(", "), ")") if line[0] in "fs" else [line]
    return [*lines, *bracketed("results = [", [printer.text(ref) for ref in program.outputs], "]")], printer.status()


def bracketed(before: str, items: Sequence[str], after: str) -> list[str]:
    """Return a list or a call as lines: `before`, such as "f(", the items, and `after`, such as ")".

    If one line would be too long, the items are on several indented lines.
    """
    line = f"{before}{', '.join(items)}{after}"
    if len(line) <= TEXT_WIDTH:
        return [line]
    inside = textwrap.wrap(", ".join(items), TEXT_WIDTH - 4, break_long_words=False, break_on_hyphens=False)
    return [before, *(f"    {line}" for line in inside), after]


def described(program: Program) -> str:
    """Return one line of a docstring that describes the results of a program."""
    inputs = ", ".join(map(block, program.inputs))
    shape = f" as {list(program.shape)}" if len(program.shape) > 1 else ""
    return f"[{', '.join(map(block, program.results))}]{shape}, of y = [{inputs}] and p[{program.parameters}]"


def block(named: ProgramBlock) -> str:
    """Return the description of a block of inputs or results: its name, and its size in brackets."""
    return f"{named.name}[{named.size}]"


COMPARED = '''


def wrong(name, function, times, states, expected, allowed):
    """Print the results that are not within what they may be off; return how many these are."""
    count = len(expected) // len(times)
    failures = 0
    rows = [states[{states} * k : {states} * (k + 1)] for k in range(len(times))]
    for k, (found, singular) in enumerate(evaluated(function, times, rows)):
        if singular:
            print(f"{{name}}, state {{k}}: a matrix is singular")
            failures += count
            continue
        for i, value in enumerate(found):
            j = count * k + i
            if not abs(value - expected[j]) <= allowed[j]:
                print(f"{{name}}, state {{k}}, result {{i}}: {{value!r}} instead of {{expected[j]!r}}")
                failures += 1
    return failures


def test():
    """Compare results with those of multiple precision; return 0 if all are right, else 1."""
    failures = 0
'''

TAIL = """\
    print(f"{module}: {{{count} - failures}} of {count} results are right")
    return 0 if failures == 0 else 1


if __name__ == "__main__":
    sys.exit(test())
"""
