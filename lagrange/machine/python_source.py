"""Print a procedure as Python source, and load it as a function on floats and integers, or on NumPy's arrays.

Names are generated here and literals are exact, so no text of a user is ever run. Undefined results are NaN or
infinite, as in machine code: operations that would raise in Python call a function of `interpreter.OPERATIONS`. `fma`
rounds the product and the sum separately.

For procedures with loops over long vectors, `arrays_loaded` prints each `each` loop as operations on whole arrays.
"""

from __future__ import annotations

import keyword
import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from lagrange.errors import LagrangeError
from lagrange.machine.backend import FloatArray, Kernel, Shared, SingularMassMatrix
from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, PARTIAL, REAL, Array, Kind, Procedure, Record
from lagrange.procedure.interpreter import OPERATIONS, Span
from lagrange.procedure.source_printer import SourcePrinter, results_of
from lagrange.procedure.spelling import ATOM, WORDS, Literals, Operator
from lagrange.procedure.spelling import OPERATORS as COMMON

OPERATORS: Mapping[str, Operator] = {
    **{op: operator for op, operator in COMMON.items() if op != "div"},
    **WORDS,
    "select": Operator(1, "{1} if {0} else {2}", (2, 2, 1)),
    "neg": Operator(8, "-{0}", (8,)),
    "abs": Operator(9, "abs({0})"),
    "real": Operator(9, "float({0})"),
    "whole": Operator(9, "int({0})"),
}
"""Python's operator for each operation that has one. Other operations are printed as function calls. Division is one of
these, because Python's operator raises an error for a zero divisor.
"""

RAISING: Mapping[str, Operator] = {**OPERATORS, "div": COMMON["div"]}
"""`OPERATORS` with Python's division, for code whose caller catches errors, and for numbers that are not Python's."""

LITERALS = Literals("inf", "nan", ("False", "True"))


def source(procedure: Procedure) -> str:
    """Return the Python source of a procedure and of all procedures that it calls, with callees first."""
    return "\n\n".join(_PythonPrinter(printed).function() for printed in (*procedure.callees, procedure))


def loaded(procedure: Procedure) -> Callable[..., Any]:
    """Return a procedure as a Python function of numbers and arrays, which returns None, a value or a tuple of values.

    An array argument may be a memory view (the fastest), another object with indices, or a `Span`, which is a part of
    such an object.
    """
    names: dict[str, Any] = {f"_{op}": function for op, function in OPERATIONS.items() if op not in OPERATORS}
    names |= {"_part": part_of, "_reals": _reals, "_wholes": _wholes, "_record": SimpleNamespace}
    names |= {"nan": math.nan, "inf": math.inf}
    made = defined(source(procedure), procedure.name, names)
    arrays = [isinstance(parameter.type, Array) for parameter in procedure.parameters]

    def run(*args: Any) -> Any:
        pairs = zip(args, arrays, strict=True)
        return made(*[Span(arg) if array and not isinstance(arg, AS_THEY_ARE) else arg for arg, array in pairs])

    return run


def defined(text: str, name: str, names: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the function `name` that the source `text` defines. `names` are the global names that the source uses."""
    known = dict(names)
    exec(compile(text, f"<{name}>", "exec"), known)
    made: Callable[..., Any] = known[name]
    return made


AS_THEY_ARE = (memoryview, Span)
"""Types of array arguments whose parts share their memory: passed on unchanged. Other arrays become a `Span`."""


def part_of(array: Any, start: int) -> Any:
    """Return the part of `array` from index `start` on. The part shares the memory of `array`."""
    return array[start:] if isinstance(array, memoryview) else array.part(start)


def _reals(count: int) -> memoryview:
    return memoryview(array("d", [math.nan]) * count)


def _wholes(count: int) -> memoryview:
    return memoryview(array("q", [0]) * count)


class _PythonPrinter(SourcePrinter):
    """Prints one procedure as the source of a Python function on numbers, and on arrays accessed by index."""

    operators = OPERATORS
    literals = LITERALS

    def head(self) -> list[str]:
        parameters = ", ".join(self.text(parameter.ref) for parameter in self.procedure.parameters)
        return [f"def {self.function_name(self.procedure)}({parameters}):", f'    """{self.procedure.about}"""']

    def legal(self, stem: str) -> str:
        return f"{stem.strip('_')}_" if keyword.iskeyword(stem) or stem.startswith("_") else stem

    def function_of(self, op: str) -> str:
        return f"_{op}"

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"{name} = {text}"

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text}"

    def element(self, array: int, index: int) -> str:
        return f"{self.text(array)}[{self.text(index)}]"

    def reserve(self, ref: int, array: Array) -> None:
        kind = "reals" if array.kind is REAL else "wholes"
        self.put(f"{self.name(ref)} = _{kind}({(array.size or 0) + array.room})")

    def reserve_record(self, ref: int, record: Record) -> None:
        zeros = ", ".join(f"{name}={'0.0' if kind is REAL else '0'}" for name, kind in record.fields)
        self.put(f"{self.name(ref)} = _record({zeros})")

    def part(self, part: form.Part) -> None:
        self.write(f"{self.name(part.ref)} = _part({self.text(part.array)}, {self.text(part.start)})")

    def call(self, call: form.Call) -> None:
        target = self.function_name(call.callee) if isinstance(call.callee, Procedure) else self.text(call.callee)
        made = f"{target}({', '.join(self.text(arg) for arg in call.args)})"
        kinds = results_of(self, call)
        names = ", ".join(self.named(ref, kind) for ref, kind in zip(call.refs, kinds, strict=True))
        self.write(f"{names} = {made}" if names else made)

    def named(self, ref: int, kind: Kind) -> str:
        """Return the name in Python of a result of a call, and record its `kind`. `ref` is the id of the result."""
        self.types[ref] = kind
        return self.name(ref)

    def leave(self, values: Sequence[int]) -> None:
        self.write(f"return {', '.join(self.text(value) for value in values)}".rstrip())

    def comment(self, text: str) -> str:
        return f"# {text}"

    def opening(self, kind: str, *texts: str) -> str:
        match kind, texts:
            case "for", (index, start, stop, step):
                bounds = f"{start}, {stop}" if start != "0" or step != "1" else stop
                return f"for {index} in range({bounds}{'' if step == '1' else f', {step}'}):"
            case _:
                return " ".join([{"forever": "while True"}.get(kind, kind), *texts]) + ":"

    def closing(self, kind: str) -> str:
        return ""

    def leaving_loop(self) -> str:
        return "break"

    def empty(self) -> str:
        return "pass"

    def partial_sums(self, ref: int) -> None:
        self.put(f"{self.name(ref)} = [0.0] * {PARTIAL}")

    def partial(self, ref: int, index: str) -> str:
        return f"{self.text(ref)}[{index}]"

    def modulo(self, index: str) -> str:
        return f"{index} % {PARTIAL}"


Printer = _PythonPrinter

AT_ONCE: Mapping[str, Callable[..., Any]] = {
    "select": np.where,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "div": np.divide,
    "min": np.minimum,
    "max": np.maximum,
    "magnitude": lambda a, b: np.maximum(abs(a), abs(b)),
    "sqrt": np.sqrt,
}
"""NumPy function for each operation that arrays need in another form than numbers, such as `np.where` for "select"."""

AS_WRITTEN = ("add", "sub", "mul", "neg", "abs", "fma", "fnma", "less", "less_equal", "equal")
"""Operations that are printed in the same way for arrays and numbers."""


@lru_cache(maxsize=64)
def arrays_loaded(procedure: Procedure) -> Callable[..., Any]:
    """Return a procedure as a Python function of numbers and one-dimensional NumPy arrays.

    Each `each` loop of the procedure becomes operations on whole arrays.
    """
    names: dict[str, Any] = {f"_{op}": function for op, function in OPERATIONS.items()}
    names |= {f"_all_{op}": function for op, function in AT_ONCE.items()}
    names |= {"_part": _part, "_reals": np.empty, "_largest": _largest, "nan": math.nan, "inf": math.inf}
    source = "\n\n".join(_ArrayPrinter(printed).function() for printed in (*procedure.callees, procedure))
    return defined(source, procedure.name, names)


def _part(array: Any, start: int) -> Any:
    return array[start:]


def _largest(values: Any) -> float:
    """Return the largest absolute value of an array: NaN if any entry is NaN, and 0 if the array is empty."""
    return float(np.max(np.abs(values), initial=0.0))


class _ArrayPrinter(Printer):
    """Prints a procedure as Python on NumPy arrays: an `each` loop becomes operations on all iterations at once.

    Inside an `each` loop a value is a number, or an array with an entry for each iteration.
    """

    each_of: form.Each | None = None
    count = ""
    stored: Mapping[int, None] = {}

    def each(self, each: form.Each) -> None:
        self.settle()
        self.each_of, self.count = each, self.text(each.iterations)
        self.stored = {statement.array: None for statement in each.body if isinstance(statement, form.Store)}
        for statement in each.body:
            self.statement(statement)
        for fold in each.folds:
            if fold.op != "magnitude":
                raise LagrangeError(f"{fold.op} has no form for all iterations at once.")
            self.types[fold.ref] = REAL
            self.write(f"{self.name(fold.ref)} = _largest({self.text(fold.value)})")
        self.deferred.clear()
        self.each_of = None

    def let(self, let: form.Let) -> None:
        if self.each_of is None or let.op == CONSTANT or let.op in AS_WRITTEN:
            super().let(let)
        elif let.op in AT_ONCE:
            self.made(let.ref, let.kind, ATOM, f"_all_{let.op}({', '.join(self.text(arg) for arg in let.args)})")
        else:
            raise LagrangeError(f"{let.op} has no form for all iterations at once.")

    def memory(self, statement: form.Load | form.Store | form.Read | form.Write) -> None:
        each = self.each_of
        if each is None or not isinstance(statement, (form.Load, form.Store)) or statement.place != each.place:
            super().memory(statement)
        elif isinstance(statement, form.Load):
            # A view, unlike a copy, would change with later stores to the same array.
            copied = ".copy()" if statement.array in self.stored else ""
            self.made(statement.ref, statement.kind, ATOM, f"{self.text(statement.array)}[:{self.count}]{copied}")
        else:
            self.write(f"{self.text(statement.array)}[:{self.count}] = {self.text(statement.value)}")


EMPTY = memoryview(array("d"))
"""Argument of a `PrintedCall` in place of an array or function that the caller has not set."""


class PrintedProcedure(Shared):
    """A procedure printed as a Python function. Its arguments are numbers, NumPy arrays, records and functions."""

    def __init__(self, procedure: Procedure) -> None:
        self.names = [parameter.name for parameter in procedure.parameters]
        self.function = loaded(procedure)

    def bound(self) -> PrintedCall:
        """Return an object that stores arguments of the procedure, and runs the procedure with them when called."""
        return PrintedCall(self)

    def __call__(self, *args: Any) -> Any:
        """Run the procedure with arguments in the order of its parameters; return None, a value or several values."""
        return self.function(*[arg.data if isinstance(arg, np.ndarray) else arg for arg in args])


class PrintedCall:
    """Stored arguments of a printed procedure. Calling the object runs the procedure with them."""

    is_final = True

    def __init__(self, code: PrintedProcedure) -> None:
        self.code = code
        self._arguments: dict[str, Any] = dict.fromkeys(code.names, EMPTY)

    def give(self, **arguments: Any) -> None:
        """Set arguments of the procedure by name. None means no array or no function; unknown names are ignored."""
        for name, value in arguments.items():
            if name in self._arguments:
                flat = value.reshape(-1).data if isinstance(value, np.ndarray) else value
                self._arguments[name] = EMPTY if flat is None else flat

    def __call__(self) -> Any:
        """Run the procedure with the stored arguments; return None, a value or a tuple of values."""
        with np.errstate(all="ignore"):
            return self.code.function(*self._arguments.values())

    def count(self, steps: int) -> bool:
        """Return False: printed code is never replaced by optimized code, as machine code is after many steps."""
        return False


@lru_cache(maxsize=64)
def called(procedure: Procedure) -> PrintedProcedure:
    """Return a procedure printed as a Python function, from a cache if it was printed before."""
    return PrintedProcedure(procedure)


def between_arrays(kernel: Kernel) -> Any:
    """Return a function f(t, y, parameters, out) by which printed procedures evaluate a kernel at one state.

    It writes the result to `out`. It returns True if the mass matrix is singular, else False.
    """
    states, count = kernel.program.states, kernel.program.parameters

    def evaluate(t: float, y: memoryview, numbers: memoryview, out: memoryview) -> bool:
        try:
            results: FloatArray = kernel(t, np.frombuffer(y, count=states), np.asarray(numbers[:count]))
        except SingularMassMatrix:
            return True
        out[: results.size] = np.ascontiguousarray(results).reshape(-1).data
        return False

    return evaluate
