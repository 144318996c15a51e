"""Calls of a kernel with NumPy arrays as they are: machine code reads where their numbers stand, and checks them.

A call through Python's own means takes some 3 us, of which the kernel of a small system is a hundredth. Here the array
objects themselves are handed to machine code. It reads NumPy's C structure (`PyArrayObject`: data, number of
dimensions, dimensions, strides), which is part of NumPy's stable interface and tried before it is relied on.

    i32 one_array(ptr call, double t, ptr y, ptr out)            y (size,)
    i32 two_arrays(ptr call, double t, ptr q, ptr v, ptr out)    q (size / 2,), v (size / 2,)

`call` is a record {kernel, prepared parameters, size, results}. The result is 0 if all went well. It is another number
where an array has another shape or is not contiguous, where the time or a result is not finite, or where the mass
matrix is singular: the caller then takes the way that finds out and tells.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, QuickCalls
from lagrange.machine.llvm.address import address, by_layout
from lagrange.machine.llvm.engine import Module

HEADER = object.__basicsize__
DATA, DIMENSIONS, SHAPE, STRIDES = HEADER, HEADER + 8, HEADER + 16, HEADER + 24
"""Offsets of the fields of an array from its address."""

REFUSED, NOT_FINITE = 2, 3

_CHECKED = f"""
define internal ptr @numbers(ptr %array, i64 %size) alwaysinline {{
  %at.count = getelementptr i8, ptr %array, i64 {DIMENSIONS}
  %count = load i32, ptr %at.count
  %flat = icmp eq i32 %count, 1
  br i1 %flat, label %one, label %no
one:
  %at.shape = getelementptr i8, ptr %array, i64 {SHAPE}
  %shape = load ptr, ptr %at.shape
  %length = load i64, ptr %shape
  %fits = icmp eq i64 %length, %size
  %at.strides = getelementptr i8, ptr %array, i64 {STRIDES}
  %strides = load ptr, ptr %at.strides
  %stride = load i64, ptr %strides
  %dense = icmp eq i64 %stride, 8
  %at.data = getelementptr i8, ptr %array, i64 {DATA}
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

define internal i32 @run(ptr %call, double %t, ptr %y, ptr %out) alwaysinline {{
  %kernel = load ptr, ptr %call
  %at.p = getelementptr i8, ptr %call, i64 8
  %p = load ptr, ptr %at.p
  %at.results = getelementptr i8, ptr %call, i64 24
  %results = load i64, ptr %at.results
  %at.data = getelementptr i8, ptr %out, i64 {DATA}
  %data = load ptr, ptr %at.data
  %status = call i32 %kernel(double %t, ptr %y, ptr %p, ptr %data)
  %well = icmp eq i32 %status, 0
  br i1 %well, label %turn, label %end
turn:
  %i = phi i64 [ 0, %0 ], [ %next, %turn ]
  %total = phi double [ %t, %0 ], [ %sum, %turn ]
  %at = getelementptr double, ptr %data, i64 %i
  %x = load double, ptr %at
  %nothing = fmul double %x, 0.0
  %sum = fadd double %total, %nothing
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, %results
  br i1 %more, label %turn, label %judge
judge:
  %rest = fsub double %sum, %sum
  %finite = fcmp oeq double %rest, 0.0
  %verdict = select i1 %finite, i32 0, i32 {NOT_FINITE}
  ret i32 %verdict
end:
  ret i32 %status
}}

define i32 @one_array(ptr %call, double %t, ptr %array, ptr %out) {{
  %at.size = getelementptr i8, ptr %call, i64 16
  %size = load i64, ptr %at.size
  %y = call ptr @numbers(ptr %array, i64 %size)
  %good = icmp ne ptr %y, null
  br i1 %good, label %go, label %no
go:
  %status = call i32 @run(ptr %call, double %t, ptr %y, ptr %out)
  ret i32 %status
no:
  ret i32 {REFUSED}
}}

define i32 @two_arrays(ptr %call, double %t, ptr %first, ptr %second, ptr %out) {{
  %at.size = getelementptr i8, ptr %call, i64 16
  %size = load i64, ptr %at.size
  %half = lshr i64 %size, 1
  %q = call ptr @numbers(ptr %first, i64 %half)
  %v = call ptr @numbers(ptr %second, i64 %half)
  %good.q = icmp ne ptr %q, null
  %good.v = icmp ne ptr %v, null
  %good = and i1 %good.q, %good.v
  br i1 %good, label %go, label %no
go:
  %y = alloca double, i64 %size, align 64
  %bytes = shl i64 %half, 3
  %rest = getelementptr double, ptr %y, i64 %half
  call void @llvm.memcpy.p0.p0.i64(ptr %y, ptr %q, i64 %bytes, i1 false)
  call void @llvm.memcpy.p0.p0.i64(ptr %rest, ptr %v, i64 %bytes, i1 false)
  %status = call i32 @run(ptr %call, double %t, ptr %y, ptr %out)
  ret i32 %status
no:
  ret i32 {REFUSED}
}}

declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
"""

MOST_STATE = 4096
"""Most inputs that a call of two arrays joins on the stack."""


class _Call(ctypes.Structure):
    _fields_ = (
        ("kernel", ctypes.c_void_p),
        ("prepared", ctypes.c_void_p),
        ("size", ctypes.c_int64),
        ("results", ctypes.c_int64),
    )


def quick_calls(kernel: int, prepared: FloatArray, size: int, shape: tuple[int, ...]) -> QuickCalls | None:
    """Return the quick calls of a scalar kernel at an address, or None where arrays are laid out in another way."""
    functions = _functions()
    if functions is None or size > MOST_STATE:
        return None
    one, two = functions
    results = int(np.prod(shape))
    record = _Call(kernel, address(prepared), size, results)
    place, empty, kept = ctypes.addressof(record), np.empty, (record, prepared)

    def whole(t: float, y: FloatArray, _: Any = kept) -> FloatArray | None:
        out = empty(shape)
        return None if one(place, t, y, out) else out

    def parts(t: float, q: FloatArray, v: FloatArray, _: Any = kept) -> FloatArray | None:
        out = empty(shape)
        return None if two(place, t, q, v, out) else out

    return QuickCalls(whole, parts)


@lru_cache(maxsize=1)
def _module() -> Module:
    return Module(_CHECKED)


@lru_cache(maxsize=1)
def _functions() -> tuple[Any, Any] | None:
    if not by_layout:
        return None
    module = _module()
    array = ctypes.py_object
    one = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, array, array)
    two = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, array, array, array)
    found = one(module.address("one_array")), two(module.address("two_arrays"))
    return found if _as_documented(found[0]) else None


def _as_documented(one: Any) -> bool:
    """Return whether shapes and strides are read correctly: arrays that do not fit must be refused."""
    record = _Call(0, 0, 3, 3)
    odd = [np.zeros(2), np.zeros((3, 3)), np.zeros(6)[::2], np.zeros((3, 1)), np.zeros(())]
    return all(one(ctypes.addressof(record), 0.0, each, np.zeros(3)) == REFUSED for each in odd)
