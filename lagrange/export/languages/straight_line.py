"""Print programs as Python functions without loops, for libraries that trace what a function does, with their test.

Names are made here and literals are exact, so nothing of a user's text is run. A library gives the spelling of every
operation, and the text of `_factored(order, *lower)` and `_solved(factors, *right)`, which return the factors of a
symmetric matrix, whether it is singular, and the solution of a linear system, a list.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagrange.errors import StatementError
from lagrange.export.comments import commented
from lagrange.export.descriptions import TEST, statement_comment
from lagrange.export.module import Check, SourceModule
from lagrange.export.python_module import named_places
from lagrange.machine.kernel.python_text import GIVEN, uses_of
from lagrange.machine.kernel.python_text import OPERATORS as PYTHON
from lagrange.machine.python_source import LITERALS as PYTHON_LITERALS
from lagrange.procedure.form import REAL
from lagrange.procedure.linear.pivoted import PIVOT
from lagrange.procedure.source_printer import LONGEST_VALUE
from lagrange.procedure.spelling import ATOM, Operator
from lagrange.program.program import Instruction, Program, ProgramBlock

OPERATORS: Mapping[str, Operator] = {
    op: PYTHON[op] for op in ("neg", "add", "sub", "mul", "div", "fma", "less", "less_equal", "equal")
}
"""The operations that are operators of Python, whatever the library."""

LITERALS = replace(PYTHON_LITERALS, infinity='float("inf")', nan='float("nan")')

WIDTH = 110
"""Largest length of a line, except for single operations on long operands."""

STRUCTURE = (*GIVEN, "factor", "solve", "component")
"""Operations other than functions of numbers: arguments, and linear systems."""

ELIMINATION = f'''
PIVOT = {PIVOT!r}  # a matrix is singular where a pivot is at most this part of its row's largest entry


def _is_zero(x):
    return isinstance(x, float) and x == 0.0


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
"""Elimination with row exchanges in place of loops that a library cannot trace. It needs `_where`, `_both`, `_either`,
`_most`, `_sqrt` and `_fixed`, which keeps a factor out of derivatives that it has no part in."""


@dataclass(frozen=True)
class Library:
    """A library of array functions: its name for users, its text for each operation, and helpers.

    `head` are the lines that a file begins with; `helpers` the text of functions that operations need; `systems` that
    of linear systems.
    """

    name: str
    head: str
    operations: Mapping[str, Operator]
    helpers: Mapping[str, str]
    systems: str

    def text_before(self, *programs: Program) -> str:
        """Return the text before the functions of some programs: imports and the helpers that they need."""
        used = dict.fromkeys(one.op for program in programs for one in program.instructions)
        parts = [self.head, *(self.helpers[op] for op in used if op in self.helpers)]
        return "\n\n\n".join([*parts, *([self.systems.strip()] if "factor" in used else [])])


class StraightLinePrinter:
    """Prints the instructions of a program, each value that is read more than once under a name."""

    def __init__(self, program: Program, library: Library) -> None:
        self.program, self.library = program, library
        self.lines: list[str] = []
        self.texts: dict[int, tuple[int, str]] = {}
        self.vectors: dict[int, str] = {}
        self.singular: list[str] = []
        """The names of conditions that say that a matrix is singular."""
        self.uses = uses_of(program)
        self._refuse()

    def _refuse(self) -> None:
        """Raise StatementError for mathematics that the library does not have, by name."""
        for one in self.program.instructions:
            if one.op not in STRUCTURE and one.op not in self.library.operations:
                raise StatementError(
                    f"{self.program.name} contains {one.op}, which {self.library.name} does not have: state the system "
                    "without it, or choose another target."
                )

    def body(self) -> list[str]:
        """Return the lines that compute every result and list them in `results`, without indentation."""
        given = {"parameter": "p", "state": "y"}
        for letter, count in (("y", self.program.states), ("p", self.program.parameters)):
            if count:
                names = [f"{letter}{i}" for i in range(count)]
                self.lines += bracketed("(", names, f"{',' * (count == 1)}) = {letter}")
        for i, one in enumerate(self.program.instructions):
            if one.op in given:
                self.texts[i] = ATOM, f"{given[one.op]}{one.place}"
            elif one.op == "time":
                self.texts[i] = ATOM, "t"
            elif one.op == "constant":
                self.texts[i] = LITERALS.spelled(REAL, one.value)
            elif one.op in ("factor", "solve", "component"):
                self.system(i, one)
            else:
                self.operation(i, one)
        return [*self.lines, *self.results()]

    def results(self) -> list[str]:
        """Return the lines that list the outputs."""
        return bracketed("results = [", [self.text(ref) for ref in self.program.outputs], "]")

    def status(self) -> str:
        """Return the condition that a mass matrix is singular."""
        found = "False"
        for k, name in enumerate(self.singular):
            found = f"_either({found}, {name})" if k else name
        return found

    def text(self, ref: int, least: int = 0) -> str:
        """Return a value as an operand, in parentheses where it binds less tightly than it must."""
        level, found = self.texts[ref]
        return found if level >= least else f"({found})"

    def system(self, i: int, one: Instruction) -> None:
        """Print the factors of a matrix, a solution, or an entry of one."""
        if one.op == "component":
            self.texts[i] = ATOM, f"{self.vectors[one.args[0]]}[{one.place}]"
        elif one.op == "factor":
            self.vectors[i], status = f"f{i}", f"singular{i}"
            entries = [str(one.order), *(self.text(ref) for ref in one.args)]
            self.lines += bracketed(f"f{i}, {status} = _factored(", entries, ")")
            self.singular.append(status)
        else:
            self.vectors[i] = f"s{i}"
            right = [self.vectors[one.args[0]], *(self.text(ref) for ref in one.args[1:])]
            self.lines += bracketed(f"s{i} = _solved(", right, ")")

    def operation(self, i: int, one: Instruction) -> None:
        """Print an operation, or keep it for the one place where it is read."""
        operator = self.library.operations[one.op]
        level, found = operator.binds, operator.applied(self.text, one.args)
        if one.op == "div" and all(self.program.instructions[arg].op == "constant" for arg in one.args):
            level, found = LITERALS.spelled(REAL, self.quotient(one))
        if self.uses[i] > 1 or len(found) >= LONGEST_VALUE:
            self.lines.append(f"x{i} = {found}")
            level, found = ATOM, f"x{i}"
        self.texts[i] = level, found

    def quotient(self, one: Instruction) -> float:
        """Return the quotient of two constants, which Python refuses to divide by zero."""
        over, under = (self.program.instructions[arg].value for arg in one.args)
        with np.errstate(all="ignore"):
            return float(np.divide(over, under))


def bracketed(before: str, items: Sequence[str], after: str) -> list[str]:
    """Return the lines of a list or a call, broken between its items, and inside of them, where it is long."""
    line = f"{before}{', '.join(items)}{after}"
    if len(line) <= WIDTH:
        return [line]
    inside = textwrap.wrap(", ".join(items), WIDTH - 4, break_long_words=False, break_on_hyphens=False)
    return [before, *(f"    {one}" for one in inside), after]


def described(program: Program) -> str:
    """Return a description of the results of a program, as a line of a docstring."""
    inputs = ", ".join(map(block, program.inputs))
    shape = f" as {list(program.shape)}" if len(program.shape) > 1 else ""
    return f"[{', '.join(map(block, program.results))}]{shape}, of y = [{inputs}] and p[{program.parameters}]"


def block(named: ProgramBlock) -> str:
    """Return a block of numbers, as its name with their count."""
    return f"{named.name}[{named.size}]"


def straight_line_module(
    module: SourceModule,
    library: Library,
    setting: str,
    functions: Callable[[Program, str], str],
    use: str,
    evaluated: str,
) -> str:
    """Return a module of functions without loops; run as a program, it tests itself.

    `setting` is a line after the imports. `functions` returns the functions of a program under a name, and `use`
    documents their call. `evaluated` is the text of `_evaluated(function, times, states)`, which calls the
    function with the status.
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
