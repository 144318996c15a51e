"""Calls of a kernel with Python objects as arguments: machine code reads time and arrays, and checks them itself.

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
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import FloatArray, QuickCalls
from lagrange.machine.llvm.address import address, by_layout
from lagrange.machine.llvm.engine import Module
from lagrange.statement.expression import DOUBLE

HEADER = object.__basicsize__
TYPE = HEADER - 8
"""Offset of an object's type from its address."""

DATA, DIMENSIONS, SHAPE, STRIDES, ENTRIES = HEADER, HEADER + 8, HEADER + 16, HEADER + 24, HEADER + 40
"""Offsets of the fields of an array from its address."""

VALUE = HEADER
"""Offset of the value of a float from its address, the same for Python's and NumPy's."""

FIELDS = (
    *("kernel", "prepared", "size", "results", "empty", "shape", "none", "array", "doubles", "float", "numpy_float"),
    *("call", "release", "retain"),
)
"""The record of a function, an address or count for each field: the kernel, the objects that it needs, and the
functions of Python's interface that it calls.
"""

METH_FASTCALL = 0x80


def _field(name: str, kind: str = "ptr") -> str:
    """Return the IR lines that load the field `name` of the structure to which `%record` points."""
    return f"""  %at.{name} = getelementptr i64, ptr %record, i64 {FIELDS.index(name)}
  %{name} = load {kind}, ptr %at.{name}"""


_CHECKED = f"""
define internal ptr @numbers(ptr %record, ptr %given, i64 %size) alwaysinline {{
{_field("array")}
{_field("doubles")}
  %at.type = getelementptr i8, ptr %given, i64 {TYPE}
  %type = load ptr, ptr %at.type
  %plain = icmp eq ptr %type, %array
  br i1 %plain, label %arrays, label %no
arrays:
  %at.entries = getelementptr i8, ptr %given, i64 {ENTRIES}
  %entries = load ptr, ptr %at.entries
  %double = icmp eq ptr %entries, %doubles
  %at.count = getelementptr i8, ptr %given, i64 {DIMENSIONS}
  %count = load i32, ptr %at.count
  %row = icmp eq i32 %count, 1
  %flat = and i1 %row, %double
  br i1 %flat, label %one, label %no
one:
  %at.shape = getelementptr i8, ptr %given, i64 {SHAPE}
  %shape = load ptr, ptr %at.shape
  %length = load i64, ptr %shape
  %fits = icmp eq i64 %length, %size
  %at.strides = getelementptr i8, ptr %given, i64 {STRIDES}
  %strides = load ptr, ptr %at.strides
  %stride = load i64, ptr %strides
  %dense = icmp eq i64 %stride, 8
  %at.data = getelementptr i8, ptr %given, i64 {DATA}
  %data = load ptr, ptr %at.data
  %place = ptrtoint ptr %data to i64
  %odd = and i64 %place, 7
  %aligned = icmp eq i64 %odd, 0
  %both = and i1 %fits, %dense
  %all = and i1 %both, %aligned
  %found = select i1 %all, ptr %data, ptr null
  ret ptr %found
no:
  ret ptr null
}}

define internal double @time(ptr %record, ptr %given) alwaysinline {{
{_field("float")}
{_field("numpy_float")}
  %at.type = getelementptr i8, ptr %given, i64 {TYPE}
  %type = load ptr, ptr %at.type
  %python = icmp eq ptr %type, %float
  %numpy = icmp eq ptr %type, %numpy_float
  %known = or i1 %python, %numpy
  br i1 %known, label %read, label %no
read:
  %at.value = getelementptr i8, ptr %given, i64 {VALUE}
  %value = load double, ptr %at.value
  ret double %value
no:
  ret double 0x7FF8000000000000
}}

define internal ptr @refused(ptr %record) alwaysinline {{
{_field("none")}
{_field("retain")}
  call void %retain(ptr %none)
  ret ptr %none
}}

define internal ptr @run(ptr %record, double %t, ptr %y) alwaysinline {{
  %late = fsub double %t, %t
  %now = fcmp oeq double %late, 0.0
  br i1 %now, label %make, label %no
make:
{_field("kernel")}
{_field("prepared")}
{_field("results", "i64")}
{_field("empty")}
{_field("shape")}
{_field("call")}
{_field("release")}
  %out = call ptr %call(ptr %empty, ptr %shape)
  %made = icmp ne ptr %out, null
  br i1 %made, label %go, label %raised
raised:
  ret ptr null
go:
  %at.data = getelementptr i8, ptr %out, i64 {DATA}
  %data = load ptr, ptr %at.data
  %status = call i32 %kernel(double %t, ptr %y, ptr %prepared, ptr %data)
  %well = icmp eq i32 %status, 0
  br i1 %well, label %turn, label %drop
turn:
  %i = phi i64 [ 0, %go ], [ %next, %turn ]
  %total = phi double [ 0.0, %go ], [ %sum, %turn ]
  %at = getelementptr double, ptr %data, i64 %i
  %x = load double, ptr %at
  %nothing = fmul double %x, 0.0
  %sum = fadd double %total, %nothing
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, %results
  br i1 %more, label %turn, label %judge
judge:
  %finite = fcmp oeq double %sum, 0.0
  br i1 %finite, label %good, label %drop
good:
  ret ptr %out
drop:
  call void %release(ptr %out)
  br label %no
no:
  %nil = call ptr @refused(ptr %record)
  ret ptr %nil
}}

define ptr @whole(ptr %self, ptr %given, i64 %count) {{
  %at.record = getelementptr i8, ptr %self, i64 {DATA}
  %record = load ptr, ptr %at.record
  %two = icmp eq i64 %count, 2
  br i1 %two, label %look, label %no
look:
{_field("size", "i64")}
  %t.object = load ptr, ptr %given
  %at.y = getelementptr ptr, ptr %given, i64 1
  %y.object = load ptr, ptr %at.y
  %y = call ptr @numbers(ptr %record, ptr %y.object, i64 %size)
  %good = icmp ne ptr %y, null
  br i1 %good, label %go, label %no
go:
  %t = call double @time(ptr %record, ptr %t.object)
  %found = call ptr @run(ptr %record, double %t, ptr %y)
  ret ptr %found
no:
  %nil = call ptr @refused(ptr %record)
  ret ptr %nil
}}

define ptr @parts(ptr %self, ptr %given, i64 %count) {{
  %at.record = getelementptr i8, ptr %self, i64 {DATA}
  %record = load ptr, ptr %at.record
  %three = icmp eq i64 %count, 3
  br i1 %three, label %look, label %no
look:
{_field("size", "i64")}
  %half = lshr i64 %size, 1
  %t.object = load ptr, ptr %given
  %at.q = getelementptr ptr, ptr %given, i64 1
  %q.object = load ptr, ptr %at.q
  %at.v = getelementptr ptr, ptr %given, i64 2
  %v.object = load ptr, ptr %at.v
  %q = call ptr @numbers(ptr %record, ptr %q.object, i64 %half)
  %v = call ptr @numbers(ptr %record, ptr %v.object, i64 %half)
  %good.q = icmp ne ptr %q, null
  %good.v = icmp ne ptr %v, null
  %good = and i1 %good.q, %good.v
  br i1 %good, label %go, label %no
go:
  %t = call double @time(ptr %record, ptr %t.object)
  %y = alloca double, i64 %size, align 64
  %bytes = shl i64 %half, 3
  %rest = getelementptr double, ptr %y, i64 %half
  call void @llvm.memcpy.p0.p0.i64(ptr %y, ptr %q, i64 %bytes, i1 false)
  call void @llvm.memcpy.p0.p0.i64(ptr %rest, ptr %v, i64 %bytes, i1 false)
  %found = call ptr @run(ptr %record, double %t, ptr %y)
  ret ptr %found
no:
  %nil = call ptr @refused(ptr %record)
  ret ptr %nil
}}

define i32 @probe(double %t, ptr %y, ptr %p, ptr %out) {{
  store double %t, ptr %out
  %at = getelementptr double, ptr %out, i64 1
  %first = load double, ptr %y
  %at.last = getelementptr double, ptr %y, i64 3
  %last = load double, ptr %at.last
  %sum = fsub double %last, %first
  store double %sum, ptr %at
  ret i32 0
}}

declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
"""

MOST_STATE = 4096
"""Largest number of inputs for which a call joins q and v on the stack."""


class _MethodEntry(ctypes.Structure):
    """An entry of Python's C structure `PyMethodDef`."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("code", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("about", ctypes.c_char_p),
    )


class _Record(np.ndarray[Any, Any]):
    """Memory that a function in machine code reads, with references to all objects whose addresses it contains."""

    kept: tuple[Any, ...]


def quick_calls(
    kernel: tuple[Module, int], prepared: FloatArray, size: int, shape: tuple[int, ...]
) -> QuickCalls | None:
    """Return functions that evaluate a kernel at one state and check their own arguments in machine code.

    `kernel` is the kernel's module and its address. `prepared` has the parameters and all values that depend on them
    alone. `size` is the length of a state, and `shape` is that of the result. The functions are None for states
    longer than `MOST_STATE`, and if Python's objects do not have the expected layout.
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
    return Module(_CHECKED)


@lru_cache(maxsize=1)
def _as_documented() -> bool:
    """Return True if a trial call reads floats and arrays correctly and returns None for other objects."""
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
