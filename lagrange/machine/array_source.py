"""Print a procedure as Python source on NumPy's arrays, where each `each` loop becomes operations on whole arrays.

For procedures with loops over long vectors. Statements outside of an `each` are printed as in `python_source`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lagrange.errors import LagrangeError
from lagrange.machine.python_source import Printer, defined
from lagrange.procedure.form import CONSTANT, REAL, Each, Let, Load, Procedure, Read, Store, Write
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.procedure.spelling import ATOM

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
"""NumPy functions for operations that Python writes differently for arrays and numbers."""

AS_WRITTEN = ("add", "sub", "mul", "neg", "abs", "fma", "fnma", "less", "less_equal", "equal")
"""Operations that Python writes alike for arrays and numbers."""


def arrays_source(procedure: Procedure) -> str:
    """Return Python source of a procedure and its transitive callees: one function each, callees first."""
    return "\n\n".join(_ArrayPrinter(one).function() for one in (*procedure.callees, procedure))


def arrays_loaded(procedure: Procedure) -> Callable[..., Any]:
    """Return a procedure as a Python function of numbers and one-dimensional NumPy arrays."""
    names: dict[str, Any] = {f"_{op}": function for op, function in OPERATIONS.items()}
    names |= {f"_all_{op}": function for op, function in AT_ONCE.items()}
    names |= {"_part": _part, "_reals": np.empty, "_largest": _largest, "nan": math.nan, "inf": math.inf}
    return defined(arrays_source(procedure), procedure.name, names)


def _part(array: Any, start: int) -> Any:
    return array[start:]


def _largest(values: Any) -> float:
    """Return the largest |value|: NaN if any value is, and 0 for no values."""
    return float(np.max(np.abs(values), initial=0.0))


class _ArrayPrinter(Printer):
    """Prints one procedure. Inside an `each` a value is a number, or an array with an entry for each iteration."""

    each_of: Each | None = None
    count = ""
    stored: Mapping[int, None] = {}

    def each(self, each: Each) -> None:
        self.settle()
        self.each_of, self.count = each, self.text(each.iterations)
        self.stored = {one.array: None for one in each.body if isinstance(one, Store)}
        for statement in each.body:
            self.statement(statement)
        for fold in each.folds:
            if fold.op != "magnitude":
                raise LagrangeError(f"{fold.op} has no form for all iterations at once.")
            self.types[fold.ref] = REAL
            self.write(f"{self.name(fold.ref)} = _largest({self.text(fold.value)})")
        self.waiting.clear()
        self.each_of = None

    def let(self, let: Let) -> None:
        if self.each_of is None or let.op == CONSTANT or let.op in AS_WRITTEN:
            super().let(let)
        elif let.op in AT_ONCE:
            self.made(let.ref, let.kind, ATOM, f"_all_{let.op}({', '.join(self.text(arg) for arg in let.args)})")
        else:
            raise LagrangeError(f"{let.op} has no form for all iterations at once.")

    def memory(self, statement: Load | Store | Read | Write) -> None:
        each = self.each_of
        if each is None or not isinstance(statement, (Load, Store)) or statement.place != each.place:
            super().memory(statement)
        elif isinstance(statement, Load):
            # A view would change with later stores to the same array.
            copied = ".copy()" if statement.array in self.stored else ""
            self.made(statement.ref, statement.kind, ATOM, f"{self.text(statement.array)}[:{self.count}]{copied}")
        else:
            self.write(f"{self.text(statement.array)}[:{self.count}] = {self.text(statement.value)}")
