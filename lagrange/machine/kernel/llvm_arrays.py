"""Fast calls of a kernel from Python: machine code reads the time and the arrays itself, and checks them.

A call through ctypes takes some 0.5 us, and checking its arguments in Python as much again; the kernel of a small
system takes a tenth of that. Here Python gets a built-in function in machine code, as extension modules define them: an
entry of `PyMethodDef` with the flag METH_FASTCALL, passed to `PyCFunction_NewEx`. Both are part of Python's stable
interface. The function reads the structures of NumPy's arrays (`PyArrayObject`: data, number of dimensions, dimensions,
strides, base, type of the entries) and of Python's floats. The layout of these structures is tested first.

    whole(t, y)        y (size,)
    parts(t, q, v)     q (size / 2,), v (size / 2,)

The two functions return a new array. They return None if an argument has another type or shape (a float and plain
arrays of doubles are expected), if the time or a result is not finite, or if the mass matrix is singular. The caller
then evaluates the kernel in the usual way, which reports the error. Python calls the functions with its lock held.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import FloatArray, QuickCalls
from lagrange.machine.llvm.address import address, by_layout
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module
from lagrange.statement.expression import DOUBLE

HEADER = object.__basicsize__
TYPE = HEADER - 8
"""Offset in bytes, from the address of a Python object, at which the pointer to its type is stored."""

DATA, DIMENSIONS, SHAPE, STRIDES, ENTRIES = HEADER, HEADER + 8, HEADER + 16, HEADER + 24, HEADER + 40
"""Offsets in bytes of fields of a NumPy array: data pointer, number of axes, pointers to shape, strides and dtype."""

VALUE = HEADER
"""Offset in bytes, from the address of a float object of Python or NumPy, at which its value is stored."""

FIELDS = (
    *("kernel", "prepared", "size", "results", "empty", "shape", "none", "array", "doubles", "float", "numpy_float"),
    *("call", "release", "retain"),
)
"""Fields of the record that a fast function reads: the kernel, the Python objects that it needs, and the functions of
Python's C interface that it calls. Each field is an address or a count.
"""

NUMBERS = ("size", "results")
"""Fields of `FIELDS` that are counts: length of the state, number of results. The other fields are addresses."""

METH_FASTCALL = 0x80


def _at(e: Emitter, base: str, offset: int, kind: str = "ptr") -> str:
    """Emit the load of a value of type `kind`, `offset` bytes after the address `base`, and return its operand."""
    return e.load(e.value(f"getelementptr i8, ptr {base}, i64 {offset}"), kind)


def _check(e: Emitter, condition: str, otherwise: str = "no") -> None:
    """Emit a branch to the block `otherwise`, taken if the result of the instruction `condition` is false."""
    following = e.fresh("checked")
    e.do(f"br i1 {e.value(condition)}, label %{following}, label %{otherwise}")
    e.label(following)


def _arguments(e: Emitter, fields: Mapping[str, str], parts: int) -> tuple[str, str]:
    """Emit the checks of a fast function's arguments, and return the operands of the time and of the state.

    The arguments are a time and the state in `parts` arrays. `fields` has the operands of `FIELDS`, by name.
    """
    _check(e, f"icmp eq i64 %count, {1 + parts}")
    length = e.value(f"udiv i64 {fields['size']}, {parts}")
    arrays = []
    for k in range(1, 1 + parts):
        array = _at(e, "%given", 8 * k)
        _check(e, f"icmp eq ptr {_at(e, array, TYPE)}, {fields['array']}")
        _check(e, f"icmp eq ptr {_at(e, array, ENTRIES)}, {fields['doubles']}")
        _check(e, f"icmp eq i32 {_at(e, array, DIMENSIONS, 'i32')}, 1")
        _check(e, f"icmp eq i64 {_at(e, _at(e, array, SHAPE), 0, 'i64')}, {length}")
        _check(e, f"icmp eq i64 {_at(e, _at(e, array, STRIDES), 0, 'i64')}, 8")
        arrays.append(_at(e, array, DATA))
        where = e.value(f"ptrtoint ptr {arrays[-1]} to i64")
        _check(e, f"icmp eq i64 {e.value(f'and i64 {where}, 7')}, 0")
    time = _at(e, "%given", 0)
    kind = _at(e, time, TYPE)
    python, numpy = (e.value(f"icmp eq ptr {kind}, {fields[field]}") for field in ("float", "numpy_float"))
    _check(e, f"or i1 {python}, {numpy}")
    t = _at(e, time, VALUE, "double")
    _check(e, f"fcmp oeq double {e.value(f'fsub double {t}, {t}')}, 0.0")
    state = arrays[0]
    if parts > 1:
        state = e.value(f"alloca double, i64 {fields['size']}, align 64")
        for k, array in enumerate(arrays):
            start = e.value(f"mul i64 {length}, {k}")
            with e.loop(0, length) as i:
                e.put(e.get(array, i), state, e.value(f"add i64 {start}, {i}"))
    return t, state


def _entry(name: str, parts: int) -> str:
    """Return the IR of the fast function `name`, which takes a time and the state in `parts` arrays of equal length.

    Python passes these objects as one C array, with their number, after an object that holds the record of `FIELDS`.
    """
    e = Emitter()
    record = _at(e, "%self", DATA)
    fields = {name: _at(e, record, 8 * k, "i64" if name in NUMBERS else "ptr") for k, name in enumerate(FIELDS)}
    t, state = _arguments(e, fields, parts)
    out = e.value(f"call ptr {fields['call']}(ptr {fields['empty']}, ptr {fields['shape']})")
    _check(e, f"icmp ne ptr {out}, null", "raised")
    data = _at(e, out, DATA)
    arguments = f"double {t}, ptr {state}, ptr {fields['prepared']}, ptr {data}"
    status = e.value(f"call i32 {fields['kernel']}({arguments})")
    _check(e, f"icmp eq i32 {status}, 0", "drop")
    # The sum of all results times zero is zero if all are finite.
    with e.carry(0, fields["results"], [("double", "0.0")]) as loop:
        product = e.value(f"fmul double {e.get(data, loop.index)}, 0.0")
        loop.following = [e.value(f"fadd double {loop.values[0]}, {product}")]
    _check(e, f"fcmp oeq double {loop.values[0]}, 0.0", "drop")
    e.do(f"ret ptr {out}")
    e.label("raised")
    e.do("ret ptr null")
    e.label("drop")
    e.do(f"call void {fields['release']}(ptr {out})")
    e.jump("no")
    e.label("no")
    e.do(f"call void {fields['retain']}(ptr {fields['none']})")
    e.do(f"ret ptr {fields['none']}")
    return e.function(f"define ptr @{name}(ptr %self, ptr %given, i64 %count)")


_PROBE = """
define i32 @probe(double %t, ptr %y, ptr %p, ptr %out) {
  store double %t, ptr %out
  %at = getelementptr double, ptr %out, i64 1
  %first = load double, ptr %y
  %at.last = getelementptr double, ptr %y, i64 3
  %last = load double, ptr %at.last
  %sum = fsub double %last, %first
  store double %sum, ptr %at
  ret i32 0
}
"""
"""Kernel that tests whether arrays are read correctly. It takes a state of four entries. Its results are the time, and
the last entry less the first.
"""

MOST_STATE = 4096
"""Largest length of a state for which there are fast functions: they join q and v on the stack."""


class _MethodEntry(ctypes.Structure):
    """Python's C structure `PyMethodDef`, which describes a built-in function."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("code", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("about", ctypes.c_char_p),
    )


class _Record(np.ndarray[Any, Any]):
    """The record of `FIELDS` that a fast function reads. `kept` refers to all objects whose addresses it contains."""

    kept: tuple[Any, ...]


def quick_calls(
    kernel: tuple[Module, int], prepared: FloatArray, size: int, shape: tuple[int, ...]
) -> QuickCalls | None:
    """Return functions that evaluate a kernel at one state and check their own arguments in machine code.

    `kernel` is the kernel's module and its address. `prepared` has the parameters and all values that depend on them
    alone. `size` is the length of a state, and `shape` is that of the result. The result is None for states longer
    than `MOST_STATE`, and if Python's objects do not have the expected layout.
    """
    return None if size > MOST_STATE or not _as_documented() else _made(kernel, prepared, size, shape)


def _made(kernel: tuple[Module, int], prepared: FloatArray, size: int, shape: tuple[int, ...]) -> QuickCalls:
    module, api, arguments = _module(), ctypes.pythonapi, (shape,)
    objects = (np.empty, arguments, None, np.ndarray, DOUBLE, float, np.float64)
    calls = (api.PyObject_CallObject, api.Py_DecRef, api.Py_IncRef)
    numbers = (kernel[1], address(prepared), size, math.prod(shape))
    entries = (*numbers, *map(id, objects), *(ctypes.cast(call, ctypes.c_void_p).value or 0 for call in calls))
    record: NDArray[Any] = np.array(entries, dtype=np.uint64)
    functions = []
    for name in ("whole", "parts"):
        method, keeper = _MethodEntry(name.encode(), module.address(name), METH_FASTCALL, None), record.view(_Record)
        keeper.kept = (method, module, kernel, prepared, *objects)
        functions.append(_new(ctypes.byref(method), keeper, None))
    return QuickCalls(*functions)


_new: Callable[..., Any] = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)(
    ("PyCFunction_NewEx", ctypes.pythonapi)
)


@lru_cache(maxsize=1)
def _module() -> Module:
    return Module(_entry("whole", 1) + _entry("parts", 2) + _PROBE)


@lru_cache(maxsize=1)
def _as_documented() -> bool:
    """Return True if fast functions read the floats and arrays of this Python correctly, and refuse other objects."""
    if not by_layout:
        return False
    whole, parts = _made((_module(), _module().address("probe")), np.zeros(1), 4, (2,))
    y, q = np.array([1.0, 2.0, 3.0, 5.5]), np.array([1.0, 2.0])
    odd = [np.zeros(3), np.zeros((4, 4)), np.zeros(8)[::2], np.zeros((4, 1)), np.zeros(()), y.astype(">f8"), y.tolist()]
    odd += [y.astype(np.float32), np.zeros(4, dtype=np.int64), y.view(np.matrix), None]
    right = [whole(0.25, y), whole(np.float64(0.25), y), parts(0.25, q, y[2:])]
    none = [whole(0.25, each) for each in odd]
    none += [whole(t, y) for t in (1, True, None, np.float32(1.0), float("nan"), float("inf"))]
    none += [whole(0.25, np.full(4, np.nan)), whole(0.25), parts(0.25, q, y), parts(0.25, q)]
    return all(each is not None and each.tolist() == [0.25, 4.5] for each in right) and none == [None] * len(none)
