"""Print a program as straight-line Python on floats.

Names are made here and literals are exact, so nothing of a user's text is run. The source is for states at which all
goes well: where Python would raise, or a pivot cannot be trusted, the caller evaluates the program in another way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from lagrange.machine.python_source import LITERALS
from lagrange.machine.python_source import OPERATORS as TOTAL
from lagrange.procedure.form import REAL
from lagrange.procedure.linear.ldl import RESIDUAL, least_pivot
from lagrange.procedure.source_printer import LONGEST_VALUE
from lagrange.procedure.spelling import ATOM, Operator
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.program.program import Instruction, Program

WRITTEN_OUT = 12
"""Largest matrix whose factors L D L^T are written out."""

OPERATORS: Mapping[str, Operator] = {**TOTAL, "div": COMMON["div"]}
"""Operators of Python, a division among them, which may raise here. The other operations are functions."""

SUM, PRODUCT = OPERATORS["add"].binds, OPERATORS["mul"].binds

FLAG_OPERATIONS = ("less", "less_equal", "equal", "and", "or", "not")
GIVEN = ("time", "state", "parameter", "constant")


def fits(program: Program) -> bool:
    """Return whether every linear system of a program is small enough to be written out."""
    return all(one.order <= WRITTEN_OUT for one in program.instructions if one.op in ("factor", "solve"))


def scalar_source(program: Program) -> str:
    """Return `def name(p)`, which computes what needs parameters alone and returns a function of (t, y).

    That takes a number and the inputs, all in one sequence of floats, and returns a tuple of floats, or None where a
    pivot of the mass matrix cannot be trusted.
    """
    return FloatPrinter(program).text()


def checked_source(program: Program, given: Mapping[str, int]) -> str:
    """Return `def name(p)` as `scalar_source` does, for a function of t and of arrays with so many entries each.

    It returns a new array with finite entries, or None: where an argument is no float or no plain array of doubles of
    that length, where a result is not finite, and where Python raises. It is one function, since each call of another
    takes as long as three operations. The size tells enough where inputs are results: the rows of a matrix are lists,
    which cannot be added to t.
    """
    return FloatPrinter(program, given).text()


MOST_ADDED = 12
"""Up to so many results are added one by one in less time than a tuple of them takes."""

Entries = dict[tuple[int, int], str]
"""The names of a lower triangle by (row, column); what is missing is zero."""


def products_of(scaled: Entries, lower: Entries, i: int, j: int) -> list[tuple[str, str]]:
    """Return the factors of what is subtracted from entry (i, j)."""
    return [(scaled[i, k], lower[j, k]) for k in range(j) if (i, k) in scaled and (j, k) in lower]


def rows_of(lower: Entries, n: int) -> list[str]:
    """Return L by rows with 1/d on its diagonal, empty for zero."""
    return [lower.get((i, j), "") for i in range(n) for j in range(i + 1)]


class FloatPrinter:
    """Prints the instructions of a program one after the other; see `scalar_source`."""

    def __init__(self, program: Program, arrays: Mapping[str, int] | None = None) -> None:
        self.program, self.arrays = program, arrays
        self.lines: list[str] = []
        self.inner = 0
        """The line before which the inner function begins."""
        self.depth = 1
        self.texts: dict[int, tuple[int, str]] = {}
        self.vectors: dict[int, list[str]] = {}
        self.uses = uses_of(program)

    def write(self, line: str) -> None:
        """Print a line."""
        self.lines.append("    " * self.depth + line)

    def text_of(self, ref: int, least: int = 0) -> str:
        """Return a value as an operand, in parentheses where it binds less tightly than it must."""
        level, found = self.texts[ref]
        return found if level >= least else f"({found})"

    def names(self, places: Iterable[int], letter: str) -> None:
        """Load the values of instructions that read an input."""
        for i in places:
            self.texts[i] = ATOM, f"{letter}{self.program.instructions[i].place}"

    def places(self, op: str) -> list[int]:
        """Return the instructions with an operation."""
        return [i for i, one in enumerate(self.program.instructions) if one.op == op]

    def constants(self) -> None:
        """Load the constants."""
        for i in self.places("constant"):
            self.texts[i] = LITERALS.spelled(REAL, self.program.instructions[i].value)

    def entry(self, factor: Instruction, i: int, j: int) -> int | None:
        """Return the value of an entry of a matrix, None where it is zero."""
        ref = factor.args[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)]
        one = self.program.instructions[ref]
        return None if one.op == "constant" and one.value == 0.0 else ref

    def text(self) -> str:
        """Return the source."""
        program = self.program
        self.constants()
        self.names(self.places("parameter"), "p")
        self.names(self.places("state"), "y")
        for i in self.places("time"):
            self.texts[i] = ATOM, "t"
        self.lines = [f"def {program.name}(p):"]
        if program.parameters:
            self.write(f"{listed('p', program.parameters)} = p")
        self.run(range(program.hoisted))
        self.inner = len(self.lines)
        body = range(program.hoisted, len(program.instructions))
        if self.arrays is None:
            self.write(f"def {program.name}(t, y):")
            self.depth = 2
            if program.states:
                self.write(f"{listed('y', program.states)} = y")
            self.run(body)
            self.write(f"return ({''.join(f'{self.text_of(ref)}, ' for ref in program.outputs).rstrip()})")
        else:
            self.checked(self.arrays, body)
        self.depth = 1
        self.write(f"return {program.name}")
        return "\n".join([*self.lines, ""])

    def results(self) -> list[str]:
        """Return the outputs, each a name or a number: they are read twice, and what is computed may raise."""
        found = []
        for k, ref in enumerate(self.program.outputs):
            text = self.text_of(ref)
            plain = text.isidentifier() or self.program.instructions[ref].op in GIVEN
            found.append(text if plain else self.named(f"r{k}", text))
        return found

    def checked(self, arrays: Mapping[str, int], body: Iterable[int]) -> None:
        """Write the function of t and arrays around a body; see `checked_source`."""
        first, unpacked = 0, []
        self.write(f"def {self.program.name}(t, {', '.join(arrays)}):")
        self.depth = 2
        given = any(self.program.instructions[ref].op == "state" for ref in self.program.outputs)
        for name, size in arrays.items():
            other = f"{name}.size != {size}" if given and len(arrays) == 1 else f"{name}.shape != ({size},)"
            self.leave_if(f"type({name}) is not ndarray or {name}.dtype is not double or {other}")
            if size:
                unpacked.append(f"{listed('y', size, first)} = {name}.tolist()")
            first += size
        self.leave_if("not isinstance(t, float)")
        for line in [*(["t = float(t)"] if self.places("time") else []), "try:"]:
            self.write(line)
        self.depth = 3
        for line in unpacked:
            self.write(line)
        self.run(body)
        self.made(self.results())

    def leave_if(self, condition: str) -> None:
        """Return None on a condition."""
        self.write(f"if {condition}:")
        self.write("    return None")

    def made(self, found: list[str]) -> None:
        """Return an array of the results if they are finite."""
        results = ", ".join(found)
        if len(found) <= MOST_ADDED:
            self.leave_if(f"not isfinite({' + '.join([*found, 't'])})")
        else:
            self.write(f"r = ({results})")
            self.leave_if("not isfinite(sum(r) + t)")
            results = "*r"
        self.depth = 2
        self.write("except NO_VALUE:")
        self.write("    return None")
        self.write("out = new()")
        self.write(f"pack(out, 0, {results})")
        self.write("return out")

    def run(self, refs: Iterable[int]) -> None:
        """Print some instructions, each after those that it reads."""
        hoisted = self.program.hoisted
        for i in refs:
            one = self.program.instructions[i]
            if one.op in GIVEN:
                continue
            if one.op == "factor":
                self.factor(i, one)
            elif one.op == "solve":
                self.solve(i, one)
            elif one.op == "component":
                self.texts[i] = ATOM, self.vectors[one.args[0]][one.place]
            else:
                level, found = self.spelled(one)
                keep = self.uses[i] != 1 or len(found) >= LONGEST_VALUE or (i < hoisted)
                self.texts[i] = (ATOM, self.named(f"x{i}", found)) if keep else (level, found)

    def spelled(self, one: Instruction) -> tuple[int, str]:
        """Return an operation as text, and how tightly it binds."""
        operator = OPERATORS.get(one.op)
        if operator is None:
            return ATOM, f"{one.op}({', '.join(map(self.text_of, one.args))})"
        return operator.binds, operator.applied(self.text_of, one.args)

    def named(self, name: str, text: str) -> str:
        """Name a value, and return the name."""
        self.write(f"{name} = {text}")
        return name

    def write_once(self, line: str) -> None:
        """Print a line that needs parameters alone, before the inner function."""
        self.lines.insert(self.inner, f"    {line}")
        self.inner += 1

    def is_fixed(self, ref: int | None) -> bool:
        """Return whether a value that is read by the inner function needs parameters alone; a zero, None, does."""
        return (
            ref is None or ref < self.program.hoisted or self.program.instructions[ref].op in ("constant", "parameter")
        )

    def is_name_or_number(self, ref: int) -> bool:
        """Return whether a value is read again at no cost."""
        return self.texts[ref][0] == ATOM or self.program.instructions[ref].op in GIVEN

    def factor(self, place: int, one: Instruction) -> None:
        """Write L D L^T of a matrix: its entries below the diagonal, and 1/d, and leave where a pivot vanishes."""
        n, lower, scaled = one.order, Entries(), Entries()
        for j in range(n):
            for i in range(j, n):
                products = [f"{a} * {b}" for a, b in products_of(scaled, lower, i, j)]
                start = self.entry(one, i, j)
                if start is not None and not products and self.is_name_or_number(start):
                    scaled[i, j] = self.text_of(start, ATOM)
                elif start is not None or products:
                    first = "" if start is None else self.text_of(start, SUM)
                    text = first + "".join(f" - {each}" for each in products)
                    scaled[i, j] = self.named(f"m{place}_{i}_{j}", text.strip())
            lower[j, j] = f"d{place}_{j}"
            self.trust(place, one, j, scaled, lower)
            for i in range(j + 1, n):
                if (i, j) in scaled:
                    lower[i, j] = self.named(f"l{place}_{i}_{j}", f"{scaled[i, j]} * {lower[j, j]}")
        self.vectors[place] = rows_of(lower, n)

    def trust(self, place: int, one: Instruction, j: int, scaled: Entries, lower: Entries) -> None:
        """Leave where a pivot cannot be trusted, and write 1/d; what needs parameters alone is computed once."""
        pivot, size, pairs = scaled.get((j, j), "0.0"), self.entry(one, j, j), products_of(scaled, lower, j, j)
        write, divided = self.write, f"{lower[j, j]} = 1.0 / {pivot}"
        if j not in one.negative:
            least = f"{least_pivot(one.negative)!r} * abs({'0.0' if size is None else self.text_of(size)})"
            if place >= self.program.hoisted and self.is_fixed(size):
                self.write_once(f"e{place}_{j} = {least}")
                least = f"e{place}_{j}"
                write = self.write if pairs else self.write_once
        else:
            pivot, total = f"-{pivot}", " + ".join(f"abs({a} * {b})" for a, b in pairs) or "0.0"
            least = f"{least_pivot(one.negative)!r} * ({total})"
        write(f"if not {pivot} > {least}:")
        write("    return None")
        write(divided)

    def solve(self, place: int, one: Instruction) -> None:
        """Write the solution of a system with a factored matrix."""
        n, rows = one.order, self.vectors[one.args[0]]
        x = [self.text_of(ref, SUM) for ref in one.args[1:]]
        for i in range(n):
            terms = [f"{rows[i * (i + 1) // 2 + k]} * {x[k]}" for k in range(i) if rows[i * (i + 1) // 2 + k]]
            if terms or not x[i].isidentifier():
                x[i] = self.named(f"b{place}_{i}", " - ".join([x[i], *terms]))
        for i in reversed(range(n)):
            held = [k for k in range(i + 1, n) if rows[k * (k + 1) // 2 + i]]
            terms = [f"{rows[k * (k + 1) // 2 + i]} * {x[k]}" for k in held]
            x[i] = self.named(f"s{place}_{i}", " - ".join([f"{x[i]} * {rows[i * (i + 3) // 2]}", *terms]))
        self.vectors[place] = x
        for start, products in self.held_rows(one, x):
            terms = [f"{a} * {b}" for a, b in products]
            left, size = " - ".join([start, *terms]), " + ".join(f"abs({term})" for term in (start, *terms))
            self.write(f"if not abs({left}) <= {RESIDUAL!r} * ({size}):")
            self.write("    return None")

    def held_rows(self, one: Instruction, x: Sequence[str]) -> list[tuple[str, list[tuple[str, str]]]]:
        """Return for each multiplier of a solve its right-hand side, and the products in its row of the matrix."""
        factor, found = self.program.instructions[one.args[0]], []
        for i in factor.negative:
            there = [(self.entry(factor, i, j), x[j]) for j in range(one.order)]
            products = [(self.text_of(ref, PRODUCT), value) for ref, value in there if ref is not None]
            found.append((self.text_of(one.args[1 + i], SUM), products))
        return found


def listed(letter: str, count: int, first: int = 0) -> str:
    """Return the names of so many numbered values, to unpack them into."""
    return "".join(f"{letter}{i}, " for i in range(first, first + count)).rstrip()


def uses_of(program: Program) -> list[int]:
    """Return a lower bound of how often each result is used in the text."""
    found = [0] * len(program.instructions)
    for one in program.instructions:
        for arg in one.args:
            found[arg] += 1 if one.op not in ("factor", "solve", "select") else 2
    for ref in program.outputs:
        found[ref] += 1
    return found
