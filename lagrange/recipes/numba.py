"""A quantity of a model for functions that Numba compiles: they call the machine code at its address."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.recipes.missing import missing

_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_FILL = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

_KEPT: dict[int, Any] = {}
"""Kernels by address. Functions of Numba's have the address as a number, and may outlive the model."""


@dataclass(frozen=True, eq=False)
class NumbaFunction:
    """A quantity as functions that Numba's compiled functions call; arrays are contiguous and of doubles.

    `prepare(p)` takes the parameters (k,) and returns what the others take, with everything that depends on parameters
    alone, and whether a matrix of these is singular. `function(t, y, prepared)` returns a new array, NaN throughout
    where a mass matrix is singular. `fill(t, y, prepared, out)` writes it to `out`, and returns whether one is
    singular; it allocates nothing.
    """

    prepare: Callable[[FloatArray], FloatArray]
    function: Callable[[float, FloatArray, FloatArray], FloatArray]
    fill: Callable[[float, FloatArray, FloatArray, FloatArray], bool]

    def __repr__(self) -> str:
        return "<NumbaFunction: prepare(p), function(t, y, prepared) and fill(t, y, prepared, out)>"


def numba_function(model: Model, quantity: str) -> NumbaFunction:
    """Return a quantity for Numba; see `Model.as_numba`."""
    kernel: Any = model.kernel(quantity)
    address = kernel.address
    try:
        import numba
    except ImportError as error:
        raise missing("as_numba", "pip install numba", error) from error
    _KEPT[address] = kernel
    prepare_code, fill_code = _PREPARE(kernel.prepare_address), _FILL(address)
    program, size = kernel.program, kernel.prepared_size
    states, count, shape, k = program.states, math.prod(program.shape), program.shape, program.parameters

    def prepare(p: Any) -> Any:
        if p.size != k:
            raise ValueError("the parameters have another number of entries than the model")
        prepared = np.zeros(size + 1)
        prepared[:k] = p
        prepared[size] = prepare_code(prepared.ctypes)
        return prepared

    def fill(t: Any, y: Any, prepared: Any, out: Any) -> Any:
        if y.size != states or prepared.size != size + 1 or out.size != count:
            raise ValueError("the state, the prepared parameters or the result have another size than the model")
        singular = fill_code(t, y.ctypes, prepared.ctypes, out.ctypes) != 0
        return singular or prepared[size] != 0.0

    vector, result = numba.float64[::1], numba.types.Array(numba.float64, len(shape), "C")
    made_fill = numba.njit(numba.boolean(numba.float64, vector, vector, result))(fill)

    def function(t: Any, y: Any, prepared: Any) -> Any:
        out = np.empty(shape)
        if made_fill(t, y, prepared, out):
            out[...] = np.nan
        return out

    made = numba.njit(result(numba.float64, vector, vector))(function)
    return NumbaFunction(numba.njit(vector(vector))(prepare), made, made_fill)
