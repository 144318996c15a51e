"""Print a program as Python without loops: on floats for one state, on NumPy rows for blocks of many states.

The text has an outer and an inner function, printed from procedures of `algorithm.kernel`, which LLVM also compiles.
The outer function takes the parameters and computes all values that depend only on them. It contains the inner
function, which evaluates the program at a state. Names are generated here and literals are exact, so no text of a user
is run. The source handles regular states only: if Python raises, or a pivot cannot be trusted, the caller evaluates the
program in another way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lagrange.algorithm.kernel.body import PreparedLayout, Style
from lagrange.algorithm.kernel.kernels import kernel_by_value, prepare
from lagrange.machine.kernel.interpreted import OPERATIONS
from lagrange.machine.python_source import RAISING, Printer
from lagrange.procedure import form
from lagrange.procedure.form import ANGLES, CONSTANT, FLAG, REAL, Procedure, Statement
from lagrange.procedure.spelling import ATOM
from lagrange.procedure.visit import FIELDS, operands, visits
from lagrange.program.program import SYSTEMS, Program

LARGEST_IN_PYTHON = 12
"""Size of the largest matrix whose elimination is printed as Python. Programs with larger ones are interpreted."""

STYLE = Style(largest=LARGEST_IN_PYTHON, substituted=1_000_000, systems=1, pivoting=False, early=False)
"""Form of the printed code for linear systems: all are written out, without pivoting. If a pivot is too small, the
program is interpreted instead.
"""

MOST_ADDED = 12
"""Largest number of results that printed code adds as `r0 + r1 + ...` to test whether all are finite. For more results
`sum` of a tuple is faster.
"""

UFUNCS: Mapping[str, str] = {
    **{op: function.__name__ for op, function in OPERATIONS.items() if isinstance(function, np.ufunc)},
    "select": "where",
}
"""Name of the NumPy function for each operation on rows, such as "multiply" for "mul"."""


def fits(program: Program) -> bool:
    """Return True if every linear system of a program is small enough to be printed as Python without loops."""
    return all(code.order <= LARGEST_IN_PYTHON for code in program.instructions if code.op in SYSTEMS)


class StraightLines:
    """Prints a program as straight-line Python: the text of an outer function of the parameters, `name(p)`.

    The outer function computes all values that depend only on parameters. It returns an inner function, which
    evaluates the program at states, or None if a pivot of a matrix that depends only on parameters is too small.
    """

    def __init__(self, program: Program) -> None:
        held = PreparedLayout.of([program], LARGEST_IN_PYTHON)
        self.program = program
        self.outer = _straight(prepare(held, "", in_place=True, style=STYLE))
        self.inner = _straight(kernel_by_value(program, held, program.outputs, style=STYLE))

    def scalar(self) -> str:
        """Return the source of an outer function `name(p)`, whose inner function takes t and a sequence y of floats.

        The inner function returns a tuple of floats, or None if a pivot of the mass matrix cannot be trusted.
        """
        return _Floats(self.inner).source(self)

    def checked(self, arrays: Mapping[str, int]) -> str:
        """Return the source of an outer function `name(p)`, whose inner function takes t and arrays and checks them.

        `arrays` maps the names of these arrays to their lengths. The inner function returns a new array with finite
        entries. It returns None in four cases: t is not a float; an argument is not a plain array of doubles of its
        length; a result is not finite; Python raises. All is printed as a single function, because a call of another
        function takes as long as three operations.
        """
        return _Checked(self.inner, arrays).source(self)

    def columns(self, *, half_angles: bool = False) -> tuple[str, int]:
        """Return the source of an outer function `name_columns(p)`, whose inner function evaluates m states at once.

        The inner function takes (t, y, out, b). `t` has m times, and `y` a row of m numbers for each input. The k
        results are written to `out` (k, m); `b` are rows of work memory. It returns False if a pivot is too small for
        some state, else True. The second result of this method is the number of work rows. With `half_angles` sines
        and cosines are computed from the tangent of half the angle.
        """
        printer = _RowPrinter(self.inner, half_angles=half_angles)
        text = printer.source(self)
        return text, printer.most


def _straight(procedure: Procedure) -> Procedure:
    """Return a copy of a procedure without variables: each read of a variable becomes the value assigned last.

    The procedure must have no branches or loops. `False or x` becomes x.
    """
    known: dict[int, int] = {}
    false: list[int] = []
    body: list[Statement] = []

    def value(part: Any) -> Any:
        return tuple(map(value, part)) if isinstance(part, tuple) else known.get(part, part)

    for statement in procedure.body:
        match statement:
            case form.Declare(ref=variable, value=ref) | form.Set(variable=variable, value=ref):
                known[variable] = value(ref)
            case form.Get(ref=ref, variable=variable):
                known[ref] = known[variable]
            case form.Let(ref=ref, op="or", args=(first, second)) if value(first) in false:
                known[ref] = value(second)
            case _:
                if isinstance(statement, form.Let) and statement.data is False:
                    false.append(statement.ref)
                names = FIELDS[type(statement)].read
                body.append(statement._replace(**{name: value(getattr(statement, name)) for name in names}))
    return replace(procedure, body=tuple(body))


class _Floats(Printer):
    """Prints a Python function that evaluates a program at one state, inside an outer function of the parameters.

    The outer function computes all values that depend only on parameters, and returns the inner function.
    """

    operators = RAISING
    suffix, arguments = "", "t, y"
    failure = "None"
    """Python text of the value that the inner function returns for a state that it cannot evaluate."""

    def __init__(self, procedure: Procedure) -> None:
        super().__init__(procedure)
        self.once: list[str] = []
        """Lines of the outer function, which run once for each set of parameters."""
        self.fixed: dict[int, None] = {}
        """Ids of the values that depend only on parameters, as keys. The outer function computes these values."""

    def source(self, program: StraightLines) -> str:
        """Return the Python source of the outer function, which contains the inner function."""
        name, count = f"{program.program.name}{self.suffix}", program.program.parameters
        outer = _Floats(program.outer)
        for printer in (outer, self):
            printer.name_parameters()
            for statement in printer.procedure.body:
                printer.statement(statement)
        unpacking = [f"{listed('p', count)} = p"] if count else []
        inner = [f"def {name}({self.arguments}):", *("    " + line for line in self.unpacked()), *self.lines]
        lines = [*unpacking, *outer.once, *self.once, *inner, f"return {name}"]
        return "\n".join([f"def {name}(p):", *(f"    {line}" for line in lines), ""])

    def unpacked(self) -> list[str]:
        """Return the first lines of the inner function, such as `y0, y1, = y`, which unpack its array arguments."""
        return [f"{listed('y', self.states)} = y"] if self.states else []

    @property
    def states(self) -> int:
        """Length of a state: the number of the procedure's parameters, without the time and the prepared array."""
        return len(self.procedure.parameters) - 2

    def function_of(self, op: str) -> str:
        return op

    @visits(form.Load, form.Store, form.Read, form.Write)
    def memory(self, statement: form.Load | form.Store | form.Read | form.Write) -> None:
        """Print the read or write of an entry of the prepared array, a value that depends only on parameters.

        Each entry is printed as a variable. The outer function sets it, and the inner function reads it.
        """
        assert isinstance(statement, (form.Load, form.Store))
        slot = f"p{self.constants[statement.place]}"
        if isinstance(statement, form.Load):
            self.types[statement.ref], self.texts[statement.ref] = statement.kind, (ATOM, slot)
            self.fixed[statement.ref] = None
        else:
            self.once.append(f"{slot} = {self.text(statement.value)}")

    @visits(form.Let)
    def let(self, let: form.Let) -> None:
        """Print an operation: in the outer function if it depends only on parameters, else in the inner function."""
        fixed = all(arg in self.fixed for arg in let.args)
        if fixed:
            self.fixed[let.ref] = None
        if not fixed or let.op == CONSTANT:
            super().let(let)
        elif let.ref in self.uses:
            _, text = self.operation(let)
            self.types[let.ref] = let.kind
            self.once.append(f"{self.name(let.ref)} = {text}")

    def leave(self, values: Sequence[int]) -> None:
        *results, singular = values
        self.refuse(singular)
        self.give(results)

    def refuse(self, singular: int) -> None:
        """Print an early return, taken if a pivot is too small. `singular` is the id of the flag that says so.

        The inner function then returns the value `failure`. If the flag depends only on parameters, it is the outer
        function that returns, and its result is None.
        """
        if singular in self.fixed:
            if singular not in self.constants:
                self.once += [f"if {self.text(singular)}:", "    return None"]
        else:
            self.leave_if(self.condition(singular))

    def condition(self, flag: int) -> str:
        """Return the Python text of a condition that is true if the value with the id `flag` is true."""
        return self.text(flag)

    def leave_if(self, condition: str) -> None:
        """Print an early return of `failure` from the inner function, taken if `condition`, a Python text, is true."""
        self.put(f"if {condition}:")
        self.put(f"    return {self.failure}")

    def give(self, results: Sequence[int]) -> None:
        """Print the return of all results as a tuple. `results` are the ids of their values."""
        self.put(f"return ({''.join(f'{self.text(ref)}, ' for ref in results).rstrip()})")


class _Checked(_Floats):
    """Prints a function of t and arrays for one state; it returns None for wrong arguments and non-finite results.

    `arrays` maps the names of the array arguments, such as y, to their lengths.
    """

    def __init__(self, procedure: Procedure, arrays: Mapping[str, int]) -> None:
        super().__init__(procedure)
        self.arrays, self.arguments = arrays, ", ".join(["t", *arrays])
        self.depth = 2

    def unpacked(self) -> list[str]:
        # If an input is also a result, it is enough to compare the size of its array: the entries of a matrix would be
        # lists, for which the sum of the results raises an error. Otherwise shapes are compared.
        *results, _ = operands(self.procedure.body[-1])
        returned = any(parameter.ref in results for parameter in self.procedure.parameters[1:-1])
        lines, names, first = [], [], 0
        for name, size in self.arrays.items():
            wrong = f"{name}.shape != ({size},)"
            if returned and len(self.arrays) == 1:
                wrong = f"{name}.size != {size}"
            lines += [f"if type({name}) is not ndarray or {name}.dtype is not double or {wrong}:", "    return None"]
            names += [f"    {listed('y', size, first)} = {name}.tolist()"] if size else []
            first += size
        lines += ["if not isinstance(t, float):", "    return None"]
        reads_time = self.procedure.parameters[0] not in self.unused
        return [*lines, *(["t = float(t)"] if reads_time else []), "try:", *names]

    def give(self, results: Sequence[int]) -> None:
        names = []
        for k, ref in enumerate(results):
            text = self.text(ref)
            # Printed code reads each result twice. So an expression is assigned to a variable first.
            if not text.isidentifier() and ref not in self.constants:
                self.put(f"r{k} = {text}")
                text = f"r{k}"
            names.append(text)
        arguments = ", ".join(names)
        if len(names) <= MOST_ADDED:
            self.leave_if(f"not isfinite({' + '.join([*names, 't'])})")
        else:
            self.put(f"r = ({arguments})")
            self.leave_if("not isfinite(sum(r) + t)")
            arguments = "*r"
        self.depth = 1
        for line in ("except NO_VALUE:", "    return None", "out = new()", f"pack(out, 0, {arguments})", "return out"):
            self.put(line)


class _RowPrinter(_Floats):
    """Prints a procedure as NumPy operations on rows, which are arrays with one number for each state.

    Each result has a row. Any other value is written to the row of an operand that is not read later, or to a free
    working row. So there are few working rows, which fit the cache. With `half_angles` sines and cosines are computed
    from the tangent of half the angle.
    """

    suffix, arguments, failure = "_columns", "t, y, out, b", "False"

    def __init__(self, procedure: Procedure, *, half_angles: bool) -> None:
        super().__init__(procedure)
        self.half_angles, self.most, self.place = half_angles, 0, 0
        self.free: list[str] = []
        self.rows: dict[int, str] = {}
        """Name of the working row that holds each value, by the id of the value."""
        self.last = {ref: i for i, statement in enumerate(procedure.body) for ref in operands(statement)}
        """Index of the last statement that reads each value, by the id of the value."""
        *results, _ = operands(procedure.body[-1])
        self.outputs = {ref: k for k, ref in enumerate(results)}
        """Index of each result, by the id of its value. If several results have one value, it is the last index."""

    def unpacked(self) -> list[str]:
        arrays = (
            ("y", "y", self.states),
            ("o", "out", len(operands(self.procedure.body[-1])) - 1),
            ("b", "b", self.most),
        )
        return [f"{listed(letter, count)} = {name}" for letter, name, count in arrays if count]

    def statement(self, statement: Statement) -> None:
        """Print a statement, and mark the working rows that no later statement reads as free."""
        super().statement(statement)
        self.release(list(self.rows))
        self.place += 1

    def release(self, refs: Iterable[int]) -> None:
        """Mark the working rows of the values `refs` (ids) as free, except rows that a later statement reads."""
        self.free += [self.rows.pop(ref) for ref in refs if ref in self.rows and self.last[ref] <= self.place]

    def row(self, ref: int | None = None) -> str:
        """Return the name of the row for a value: its row among the results, or a free working row.

        `ref` is the id of the value. With None the caller gets a working row for its own use.
        """
        if ref in self.outputs:
            row = f"o{self.outputs[ref]}"
        elif self.free:
            row = self.free.pop()
        else:
            row, self.most = f"b{self.most}", self.most + 1
        if ref is not None:
            self.texts[ref] = ATOM, row
            if ref not in self.outputs:
                self.rows[ref] = row
        return row

    @visits(form.Let)
    def let(self, let: form.Let) -> None:
        """Print an operation as a NumPy call that writes its result to a row; a comparison makes a new array."""
        if all(arg in self.fixed for arg in let.args):
            super().let(let)
        elif let.ref in self.uses:
            texts = [self.text(arg) for arg in let.args]
            if let.kind is FLAG:
                self.texts[let.ref] = ATOM, f"c{let.ref}"
                self.put(f"c{let.ref} = np.{UFUNCS[let.op]}({', '.join(texts)})")
            elif let.op in ANGLES and self.half_angles:
                self.by_half_angle(let.args[0], **{let.op: let.ref})
            else:
                self.operation_on_rows(let, texts)

    def operation_on_rows(self, let: form.Let, texts: Sequence[str]) -> None:
        """Print an operation whose result is a row of numbers, not of truth values.

        `let` is the operation, and `texts` are its operands in Python, such as the names of rows.
        """
        a, *others = texts
        match let.op:
            case "fma" | "fnma":
                b, c = others
                self.release(ref for ref in let.args[:2] if ref != let.args[2])
                row = self.row(let.ref)
                self.put(f"np.multiply({a}, {b}, {row})")
                self.put(f"np.add({row}, {c}, {row})" if let.op == "fma" else f"np.subtract({c}, {row}, {row})")
            case "select":
                b, c = others
                row = self.row(let.ref)
                self.put(f"np.copyto({row}, {c})")
                self.put(f"np.copyto({row}, {b}, where={a})")
            case "real":
                self.put(f"np.copyto({self.row(let.ref)}, {a})")
            case op if op in UFUNCS:
                self.release(let.args)
                row = self.row(let.ref)
                # NumPy accepts `out=` with any number of operands.
                named = "out=" if op in ("min", "max") else ""
                square = op == "mul" and let.args[0] == let.args[1]
                self.put(f"np.square({a}, {row})" if square else f"np.{UFUNCS[op]}({', '.join(texts)}, {named}{row})")
            case op:
                self.put(f"{self.row(let.ref)}[:] = [{op}(value) for value in {a}.tolist()]")

    @visits(form.SineCosine)
    def pair(self, pair: form.SineCosine) -> None:
        """Print the sine and the cosine of an angle, as operations on rows."""
        if self.half_angles and pair.angle not in self.fixed:
            self.by_half_angle(pair.angle, sin=pair.sine, cos=pair.cosine)
            return
        # The sine must not overwrite the row of the angle, which the cosine reads next.
        last = self.last[pair.angle]
        self.last[pair.angle] = self.place + 1
        self.let(form.Let(pair.sine, REAL, "sin", (pair.angle,)))
        self.last[pair.angle] = last
        self.let(form.Let(pair.cosine, REAL, "cos", (pair.angle,)))

    def by_half_angle(self, angle: int, *, sin: int | None = None, cos: int | None = None) -> None:
        """Print sine and cosine of an angle x from t = tan(x/2): 2 t/(1 + t^2) and 2/(1 + t^2) - 1.

        `angle` is the id of x. `sin` and `cos` are the ids of the results, None for a result that is not needed.
        """
        text = self.text(angle)
        self.release([angle])
        second = self.row(cos)
        first = second if sin is None else self.row(sin)
        self.put(f"np.multiply(0.5, {text}, {first})")
        self.put(f"np.tan({first}, {first})")
        self.put(f"np.square({first}, {second})")
        self.put(f"np.add(1.0, {second}, {second})")
        self.put(f"np.divide(2.0, {second}, {second})")
        if sin is not None:
            self.put(f"np.multiply({first}, {second}, {first})")
        if cos is None:
            self.free.append(second)
        else:
            self.put(f"np.subtract({second}, 1.0, {second})")

    def condition(self, flag: int) -> str:
        return f"{self.text(flag)}.any()"

    def give(self, results: Sequence[int]) -> None:
        for k, ref in enumerate(results):
            if self.text(ref) != f"o{k}":
                self.put(f"o{k}[:] = {self.text(ref)}")
        self.put("return True")


def listed(letter: str, count: int, first: int = 0) -> str:
    """Return `count` numbered names as text, each followed by a comma, such as "y0, y1," for the letter y.

    The number of the first name is `first`.
    """
    return "".join(f"{letter}{i}, " for i in range(first, first + count)).rstrip()
