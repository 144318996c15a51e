"""Print a program as straight-line NumPy on rows of numbers, one for each of many states.

Each operation writes into a row that is free, an operand that it is the last to read before all others, and a result
into its place: so few rows are worked with, a block of columns stays in the cache, and little is moved.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lagrange.machine.kernel.arithmetic import OPERATIONS
from lagrange.machine.kernel.python_text import (
    FLAG_OPERATIONS,
    GIVEN,
    Entries,
    FloatPrinter,
    listed,
    products_of,
    rows_of,
)
from lagrange.procedure.linear.ldl import RESIDUAL, least_pivot
from lagrange.procedure.spelling import ATOM
from lagrange.program.program import Instruction, Program

UFUNCS = {op: function.__name__ for op, function in OPERATIONS.items() if isinstance(function, np.ufunc)}
"""What NumPy calls operations on rows."""

ANGULAR = ("sin", "cos")


def column_source(program: Program, *, half_angles: bool = False) -> tuple[str, int]:
    """Return `def name_columns(p)`, which returns a function of (t, y, out, b) that fills out (k, m), and its rows.

    `t` has m times, `y` a row of m numbers for each input, and `b` as many rows to work with as are said. The function
    returns False where a pivot cannot be trusted in some column, else True. With `half_angles` sines and cosines are
    made of the tangent of half the angle.
    """
    printer = _Rows(program, half_angles)
    return printer.text(), printer.most


class _Rows(FloatPrinter):
    """Prints operations on rows, each into one that is free; what needs parameters alone are floats."""

    def __init__(self, program: Program, half_angles: bool) -> None:
        super().__init__(program)
        self.half_angles, self.angles = half_angles, _angles(program)
        """The sine and the cosine that are wanted of an angle, by its place."""
        self.most = 0
        self.free: list[int] = []
        self.rows = {"t", *(f"y{i}" for i in range(program.states))}
        """The names of rows; all others are of floats."""
        self.slots: dict[int, list[str]] = {}
        """The rows to work with that a result holds."""
        self.last = _last_uses(program)
        self.passed: dict[int, list[int]] = {}
        """The results that are read for the last time by an instruction."""
        self.outputs = {ref: k for k, ref in enumerate(program.outputs)}
        """The output that a result is, by instruction: the last of several."""
        for ref, at in enumerate(self.last):
            self.passed.setdefault(at, []).append(ref)

    def text(self) -> str:
        program, name = self.program, f"{self.program.name}_columns"
        self.constants()
        self.names(self.places("parameter"), "p")
        self.lines = [f"def {name}(p):"]
        if program.parameters:
            self.write(f"{listed('p', program.parameters)} = p")
        self.run(range(program.hoisted))
        head, self.lines, self.depth = self.lines, [], 2
        self.names(self.places("state"), "y")
        for i in self.places("time"):
            self.texts[i] = ATOM, "t"
        for i in range(program.hoisted, len(program.instructions)):
            self.wide(i, program.instructions[i])
            self.release_read(i)
        for k, ref in enumerate(program.outputs):
            if self.text_of(ref) != f"o{k}":
                self.write(f"o{k}[:] = {self.text_of(ref)}")
        self.write("return True")
        body, self.lines, self.depth = self.lines, head, 1
        self.write(f"def {name}(t, y, out, b):")
        given = ("y", "y", program.states), ("o", "out", len(program.outputs)), ("b", "b", self.most)
        self.lines += [f"        {listed(letter, count)} = {name}" for letter, name, count in given if count]
        return "\n".join([*self.lines, *body, f"    return {name}", ""])

    def row(self) -> str:
        """Return a row to work with."""
        if not self.free:
            self.free.append(self.most)
            self.rows.add(f"b{self.most}")
            self.most += 1
        return f"b{self.free.pop()}"

    def release(self, rows: Iterable[str]) -> None:
        self.free += [int(row[1:]) for row in rows]

    def release_read(self, i: int) -> None:
        """Free the rows of the results that instruction i is the last to read."""
        for ref in self.passed.pop(i, ()):
            self.release(self.slots.pop(ref, []))

    def row_of(self, i: int) -> str:
        """Return a row for the result of an instruction, that of an output if it is one."""
        if i not in self.outputs:
            return self.row()
        self.rows.add(f"o{self.outputs[i]}")
        return f"o{self.outputs[i]}"

    def wide(self, i: int, one: Instruction) -> None:
        if one.op in GIVEN:
            return
        if one.op == "factor":
            self.factor_rows(i, one)
        elif one.op == "solve":
            self.solve_rows(i, one)
        elif one.op == "component":
            self.texts[i] = ATOM, self.vectors[one.args[0]][one.place]
        elif one.op in FLAG_OPERATIONS:
            self.texts[i] = ATOM, self.named(f"c{i}", f"np.{UFUNCS[one.op]}({self.operands(one)})")
        elif one.op in ANGULAR and self.half_angles:
            self.by_half_angle(one.args[0])
        else:
            text = self.operands(one)
            if one.op in UFUNCS:
                self.release_read(i)
            row = self.row_of(i)
            if one.op in UFUNCS:
                # NumPy wants the row named where it takes any number of operands.
                named = "out=" if one.op in ("min", "max") else ""
                if one.op == "mul" and one.args[0] == one.args[1]:
                    self.write(f"np.square({self.text_of(one.args[0])}, {row})")
                else:
                    self.write(f"np.{UFUNCS[one.op]}({text}, {named}{row})")
            else:
                self.composed(one, row)
            self.slots[i], self.texts[i] = [row], (ATOM, row)

    def by_half_angle(self, angle: int) -> None:
        """Write the sine and the cosine of an angle x, once, from t = tan(x/2): 2 t/(1 + t^2) and 2/(1 + t^2) - 1."""
        wanted = self.angles.pop(angle, {})
        if not wanted:
            return
        rows = {op: self.row_of(i) for op, i in wanted.items()}
        spare = [self.row()] if "cos" not in rows else []
        second = rows.get("cos") or spare[0]
        first = rows.get("sin", second)
        self.write(f"np.multiply(0.5, {self.text_of(angle)}, {first})")
        self.write(f"np.tan({first}, {first})")
        self.write(f"np.square({first}, {second})")
        self.write(f"np.add(1.0, {second}, {second})")
        self.write(f"np.divide(2.0, {second}, {second})")
        if "sin" in rows:
            self.write(f"np.multiply({first}, {second}, {first})")
        if "cos" in rows:
            self.write(f"np.subtract({second}, 1.0, {second})")
        self.release(spare)
        for op, i in wanted.items():
            self.slots[i], self.texts[i] = [rows[op]], (ATOM, rows[op])

    def operands(self, one: Instruction) -> str:
        return ", ".join(self.text_of(arg) for arg in one.args)

    def composed(self, one: Instruction, row: str) -> None:
        """Write an operation that is no function of NumPy; its row is none of the operands."""
        if len(one.args) == 1:
            self.write(f"{row}[:] = [{one.op}(one) for one in {self.text_of(one.args[0])}.tolist()]")
            return
        a, b, c = (self.text_of(arg) for arg in one.args)
        if one.op == "select":
            self.write(f"np.copyto({row}, {c})")
            self.write(f"np.copyto({row}, {b}, where={a})")
        else:
            self.write(f"np.multiply({a}, {b}, {row})")
            self.write(f"np.add({row}, {c}, {row})")

    def less(self, start: str, products: list[tuple[str, str]]) -> str:
        """Return start - the sum of products: `start` itself, or a row of its own."""
        if not products:
            return start
        row = self.row()
        for k, (a, b) in enumerate(products):
            product = self.row() if k else row
            self.write(f"np.multiply({a}, {b}, {product})")
            self.write(f"np.subtract({start}, {product}, {row})")
            self.release([product] if k else [])
            start = row
        return row

    def divided(self, pivot: str) -> str:
        """Return one over a pivot."""
        if pivot not in self.rows:
            return f"(1.0 / {pivot})"
        row = self.row()
        self.write(f"np.divide(1.0, {pivot}, {row})")
        return row

    def factor_rows(self, place: int, one: Instruction) -> None:
        """Write L D L^T as `factor` does."""
        n, lower, scaled = one.order, Entries(), Entries()
        own: list[str] = []
        for j in range(n):
            for i in range(j, n):
                products, start = products_of(scaled, lower, i, j), self.entry(one, i, j)
                if start is not None or products:
                    scaled[i, j] = self.less("0.0" if start is None else self.text_of(start), products)
                    own += [scaled[i, j]] if products else []
            self.trust_rows(one, j, scaled, lower)
            lower[j, j] = self.divided(scaled.get((j, j), "0.0"))
            for i in range(j + 1, n):
                if (i, j) in scaled:
                    lower[i, j] = self.row()
                    self.write(f"np.multiply({scaled[i, j]}, {lower[j, j]}, {lower[i, j]})")
        self.release(own)
        self.slots[place] = [row for row in lower.values() if row in self.rows]
        self.vectors[place] = rows_of(lower, n)

    def trust_rows(self, one: Instruction, j: int, scaled: Entries, lower: Entries) -> None:
        """Leave where a pivot cannot be trusted; see `factor`."""
        row, spare = self.row(), self.row()
        pivot, size = scaled.get((j, j), "0.0"), self.entry(one, j, j)
        if j not in one.negative:
            diagonal = "0.0" if size is None else self.text_of(size)
            if diagonal not in self.rows:
                least = f"np.minimum.reduce({pivot})" if pivot in self.rows else pivot
                self.write(f"if not {least} > {least_pivot(one.negative)!r} * abs({diagonal}):")
                self.write("    return False")
                self.release([row, spare])
                return
            self.write(f"np.absolute({diagonal}, {row})")
        else:
            self.write(f"{row}[:] = 0.0")
            for a, b in products_of(scaled, lower, j, j):
                self.write(f"np.multiply({a}, {b}, {spare})")
                self.write(f"np.add({row}, np.absolute({spare}, {spare}), {row})")
            pivot = f"np.negative({pivot}, {spare})"
        self.write(f"np.multiply({row}, {least_pivot(one.negative)!r}, {row})")
        self.write(f"if not ({pivot} > {row}).all():")
        self.write("    return False")
        self.release([row, spare])

    def solve_rows(self, place: int, one: Instruction) -> None:
        """Write the solution of a system with a factored matrix."""
        n, rows, x = one.order, self.vectors[one.args[0]], [self.text_of(ref) for ref in one.args[1:]]
        own: dict[int, str] = {}
        target = {
            one.place: i
            for i, one in enumerate(self.program.instructions)
            if one.op == "component" and one.args[0] == place
        }
        for i in range(n):
            held = [(rows[i * (i + 1) // 2 + k], x[k]) for k in range(i) if rows[i * (i + 1) // 2 + k]]
            x[i] = self.less(x[i], held)
            if held:
                own[i] = x[i]
        for i in reversed(range(n)):
            row = self.row_of(target[i]) if i in target else own.get(i) or self.row()
            self.write(f"np.multiply({x[i]}, {rows[i * (i + 3) // 2]}, {row})")
            if i in own and own[i] != row:
                self.release([own[i]])
            held = [(rows[k * (k + 1) // 2 + i], x[k]) for k in range(i + 1, n) if rows[k * (k + 1) // 2 + i]]
            x[i] = row
            for a, b in held:
                spare = self.row()
                self.write(f"np.multiply({a}, {b}, {spare})")
                self.write(f"np.subtract({row}, {spare}, {row})")
                self.release([spare])
        self.vectors[place], self.slots[place] = x, x
        for start, products in self.held_rows(one, x):
            self.hold(start, products)

    def hold(self, start: str, products: list[tuple[str, str]]) -> None:
        """Leave where a row of a multiplier is not satisfied; see `solve`."""
        left, size, spare = (self.row() for _ in range(3))
        self.write(f"np.copyto({left}, {start})")
        self.write(f"np.absolute({left}, {size})")
        for a, b in products:
            self.write(f"np.multiply({a}, {b}, {spare})")
            self.write(f"np.subtract({left}, {spare}, {left})")
            self.write(f"np.add({size}, np.absolute({spare}, {spare}), {size})")
        self.write(f"np.multiply({size}, {RESIDUAL!r}, {size})")
        self.write(f"if not (np.absolute({left}, {left}) <= {size}).all():")
        self.write("    return False")
        self.release([left, size, spare])


def _angles(program: Program) -> dict[int, dict[str, int]]:
    """Return the sine and the cosine of each angle, those that are computed each time."""
    found: dict[int, dict[str, int]] = {}
    for i in range(program.hoisted, len(program.instructions)):
        one = program.instructions[i]
        if one.op in ANGULAR:
            found.setdefault(one.args[0], {})[one.op] = i
    return found


def _last_uses(program: Program) -> list[int]:
    """Return the instruction that reads each result last, behind them all for an output."""
    end = len(program.instructions)
    found = list(range(end))
    for i, one in enumerate(program.instructions):
        for arg in (*one.args, *_held_entries(program, one)):
            found[arg] = i
    for ref in program.outputs:
        found[ref] = end
    for i, one in reversed(list(enumerate(program.instructions))):
        if one.op == "component":
            found[one.args[0]] = max(found[one.args[0]], found[i])
    return found


def _held_entries(program: Program, one: Instruction) -> tuple[int, ...]:
    """Return the entries of the matrix that a solve with multipliers reads behind it."""
    if one.op != "solve":
        return ()
    factor = program.instructions[one.args[0]]
    return factor.args if factor.negative else ()
