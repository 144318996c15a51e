"""A kernel printed as Python: on floats for one state, on NumPy rows for blocks of many states.

Python raises for operations such as sqrt(-1.0) or 1/0.0. In this case, and if a pivot of the mass matrix is too small,
the program is interpreted instead. The interpreter returns the correct infinities and NaNs, exchanges rows, and names
the states with a singular matrix.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray, Kernel, QuickCalls, SingularMassMatrix, nothing
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.straight_lines import LARGEST_IN_PYTHON, StraightLines, fits
from lagrange.machine.python_source import defined
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.program.program import SYSTEMS, Program
from lagrange.program.simplify import simplified
from lagrange.statement.expression import DOUBLE
from lagrange.statement.vocabulary.functions import ELEMENTARY

CACHED = 2**17
"""Size in doubles of the memory for a block of states that are evaluated at once: 1 MiB, which fits the second-level
cache of most processors.
"""

LEAST_COLUMNS, MOST_COLUMNS = 64, 16384
"""Smallest and largest number of states that are evaluated as one block."""

FEW_STATES = 16
"""Number of states below which it is faster to evaluate them one by one than by one call for all."""

PASSING_ROWS = 3
"""Number of rows that a block needs in the cache in addition to its working rows: an operation may read two rows of
inputs and write one of results.
"""

FUNCTIONS: dict[str, Any] = {
    **{elementary.name: elementary.of_float for elementary in ELEMENTARY.values()},
    "sqrt": math.sqrt,
    "atan2": math.atan2,
    **{name: OPERATIONS[name] for name in ("min", "max", "sign")},
    "power": math.pow,
    "abs": abs,
    "nan": math.nan,
    "inf": math.inf,
}
"""Python function for each operation that is printed as a call. Those of `math` raise if the result is not finite."""

NO_VALUE = (ZeroDivisionError, ValueError, OverflowError)
"""Errors that Python raises if an operation has no finite result, such as sqrt(-1.0)."""

NO_NUMBERS = (*NO_VALUE, TypeError)
"""`NO_VALUE`, and the error for an argument that has matrix rows in place of numbers."""

CHECKS: dict[str, Any] = {"ndarray": np.ndarray, "double": DOUBLE, "isfinite": math.isfinite, "NO_VALUE": NO_NUMBERS}
"""Global names of a printed function for one state, which it needs to check its arguments and results."""


@lru_cache(maxsize=1)
def tangents_are_fast() -> bool:
    """Return True if NumPy computes tangents by vector instructions of eight doubles, but not sines and cosines.

    A tangent then takes 1.5 ns and a sine 3 to 11 ns. On other processors all three take as long as in the C library.
    NumPy has such tangents on Linux only. Versions before 2.0 do not report their features.
    """
    if sys.platform != "linux" or not hasattr(np.lib, "introspect"):
        return False
    features = np.lib.introspect.opt_func_info(func_name="^tan$", signature="float64")
    kinds = [kind["current"] for signatures in features.values() for kind in signatures.values()]
    return any(kind.startswith(("AVX512", "X86_V4")) for kind in kinds)


SOURCE_NOTE = """\
# y = {inputs}, p = model.parameter_array(): the parameters, in the statement's order. A result of None, or an error
# of math, sends a state to the interpreter.

import numpy as np
from math import atan2, inf, nan, pow as power, sqrt
from math import {functions}
from numpy import sign

# One state: {name}(p)(t, y), with sequences of floats, returns a tuple of floats. A call of a model checks its
# arrays, runs these lines, and makes an array of the results.
"""

COLUMNS_NOTE = "\n\n# Many states: rows y and out, (columns,) each, and {buffers} rows b to work with.\n"


def kernel_in_python(program: Program) -> Kernel:
    """Return the kernel of a program, printed as Python. Programs with a large linear system are interpreted."""
    return PythonKernel(program) if fits(program) else InterpretedKernel(program)


def printed(program: Program) -> str:
    """Return the Python source that `PythonKernel` runs: a function for one state, and one for many states.

    Raises StatementError if a linear system is too large to be printed.
    """
    if not fits(program):
        orders = max(instruction.order for instruction in program.instructions if instruction.op in SYSTEMS)
        raise StatementError(
            f"{program.name} solves a linear system of {orders} unknowns, and at most {LARGEST_IN_PYTHON} are printed "
            "as Python: call the model instead, or take model.interpreted(name).program."
        )
    inputs, lines = ", ".join(block.name for block in program.inputs), StraightLines(simplified(program))
    columns, buffers = lines.columns(half_angles=tangents_are_fast())
    note = SOURCE_NOTE.format(inputs=f"[{inputs}]", name=program.name, functions=", ".join(ELEMENTARY))
    return note + lines.scalar() + COLUMNS_NOTE.format(buffers=buffers) + columns


class _PrintedFunction:
    """The outer function of a printed program: a call with the parameters returns the function of the state.

    The call computes all values that depend only on parameters. It returns None if one of them has no finite value or
    a pivot is too small: the program is then interpreted. The last result is cached.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._known: tuple[bytes, Callable[..., Any] | None] | None = None

    def __call__(self, parameters: FloatArray) -> Callable[..., Any] | None:
        key, known = parameters.tobytes(), self._known
        if known is None or known[0] != key:
            try:
                made = self._function(parameters.tolist())
            except NO_VALUE:
                made = None
            known = self._known = key, made
        return known[1]


class PythonKernel:
    """A program printed as Python functions (implements `Kernel`). Threads may share it."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self._quick: tuple[bytes, QuickCalls | None] | None = None
        self._printed: dict[bool, tuple[_PrintedFunction, int]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return PythonKernel, (self.program,)

    @property
    def address(self) -> int:
        """Raise StatementError: only machine code has an address."""
        raise StatementError(
            f"{self.program.name} of this model is Python code, which has no address: take the machine code of the "
            f"llvm target, system.compile('llvm').kernel({self.program.name!r}).address."
        )

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result at time t, for a state y (2n,) or many states (2n, batch)."""
        if y.ndim > 1:
            return self._by_blocks(self._blocks(half_angles=False), t, [y], parameters)
        function = self._one_state(parameters)
        try:
            values = None if function is None else function(float(t), y.tolist())
        except NO_VALUE:
            values = None
        if values is None:
            return InterpretedKernel(self.program)(t, y, parameters)
        out = np.array(values)
        shape = self.program.shape
        return out if out.shape == shape else out.reshape(shape)

    def at_times(self, times: FloatArray, states: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the m results (m, N) at times (N,) and states (2n, N). Few states are evaluated one by one."""
        if len(times) < FEW_STATES and (function := self._one_state(parameters)) is not None:
            # If Python raises an error or returns None, one call below evaluates all states.
            with suppress(*NO_NUMBERS):
                values = [function(t, y) for t, y in zip(times.tolist(), states.T.tolist(), strict=True)]
                return np.array(values, dtype=float).reshape(len(times), -1).T
        return self(times, np.ascontiguousarray(states), parameters).reshape(-1, len(times))

    def quick(self, parameters: FloatArray) -> QuickCalls | None:
        """Return fast functions of one state, or None if the program must be interpreted for these parameters."""
        key, known = parameters.tobytes(), self._quick
        if known is None or known[0] != key:
            known = self._quick = key, self._calls_of(parameters)
        return known[1]

    def _calls_of(self, parameters: FloatArray) -> QuickCalls | None:
        """Return the fast functions that `quick` caches. The function of (t, q, v) is printed at its first call.

        The result is None if the program must be interpreted for these parameters.
        """
        values = parameters.copy()
        whole = self._whole(values)
        if whole is None:
            return None
        made: list[Callable[..., Any]] = []

        def parts(t: Any, q: Any, v: Any) -> FloatArray | None:
            if not made:
                made.append(self._parts(values) or nothing)
            result: FloatArray | None = made[0](t, q, v)
            return result

        return QuickCalls(whole, parts)

    @cached_property
    def _whole(self) -> _PrintedFunction:
        """The printed function that evaluates the program at a state y, given as one array."""
        return self._checked({"y": self.program.states})

    @cached_property
    def _parts(self) -> _PrintedFunction:
        """The printed function that evaluates the program at a state given as coordinates q and velocities v."""
        size = self.program.states
        return self._checked({"q": size // 2, "v": size - size // 2})

    def _checked(self, arrays: Mapping[str, int]) -> _PrintedFunction:
        """Return the printed function for one state that checks its arguments and results.

        `arrays` maps the names of its array arguments, such as y, to their lengths.
        """
        packed = struct.Struct(f"{len(self.program.outputs)}d").pack_into
        names = {**FUNCTIONS, **CHECKS, "pack": packed, "new": np.empty(self.program.shape).copy}
        return _PrintedFunction(defined(self._lines.checked(arrays), self.program.name, names))

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return results for many states, `inputs` (size, batch) each. Sines may be rounded otherwise than for one."""
        return self._by_blocks(self._blocks(half_angles=tangents_are_fast()), t, inputs, parameters)

    def _by_blocks(
        self,
        blocks: tuple[_PrintedFunction, int],
        t: float | FloatArray,
        inputs: Sequence[FloatArray],
        parameters: FloatArray,
    ) -> FloatArray:
        program, count = self.program, inputs[0].shape[1]
        rows = [row for block in inputs for row in block]
        out = np.empty((len(program.outputs), count))
        prepared, buffers = blocks
        run = prepared(parameters)
        length = min(max(CACHED // (buffers + PASSING_ROWS), LEAST_COLUMNS), MOST_COLUMNS, max(count, 1))
        work, times = np.empty((buffers, length)), np.broadcast_to(np.asarray(t, dtype=float), (count,))
        with np.errstate(all="ignore"):
            for low in range(0, count, length):
                part = slice(low, min(low + length, count))
                block, part_times = [row[part] for row in rows], times[part]
                if run is None or not run(part_times, block, out[:, part], work[:, : len(part_times)]):
                    out[:, part] = self._by_interpreter(part_times, block, parameters, low)
        return out.reshape(*program.shape, count)

    def _by_interpreter(self, t: FloatArray, rows: Sequence[FloatArray], parameters: FloatArray, low: int) -> Any:
        try:
            results = InterpretedKernel(self.program).columns(t, [np.array(rows)], parameters)
        except SingularMassMatrix as error:
            raise SingularMassMatrix(None if error.column is None else low + error.column) from error
        return results.reshape(len(self.program.outputs), len(t))

    @cached_property
    def _lines(self) -> StraightLines:
        """The printer of the program as straight-line Python."""
        return StraightLines(simplified(self.program))

    @cached_property
    def _one_state(self) -> _PrintedFunction:
        return _PrintedFunction(defined(self._lines.scalar(), self.program.name, FUNCTIONS))

    def _blocks(self, *, half_angles: bool) -> tuple[_PrintedFunction, int]:
        """Return the printed function that evaluates a block of states, and the number of working rows that it needs.

        With `half_angles` sines and cosines are computed from the tangent of half the angle. Without it the operations
        are those of the function for one state. So dense output has the same digits for one step as for many.
        """
        if half_angles not in self._printed:
            text, buffers = self._lines.columns(half_angles=half_angles)
            function = defined(text, f"{self.program.name}_columns", {**FUNCTIONS, "np": np})
            self._printed[half_angles] = _PrintedFunction(function), buffers
        return self._printed[half_angles]
