"""Turn checked values of parameters into the arrays that kernels take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.errors import StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.statement.expression import DOUBLE, real_array
from lagrange.statement.parameters import label_of, parameter_values, table_of
from lagrange.statement.statement import Statement, friction_names

Parameters = Mapping[Any, Any] | FloatArray | None
"""Type of the argument `parameters` of public functions: a dict of values that replace defaults, None for the defaults,
or an array of all values in the statement's order, (k,), or (k, batch) with one column for each state.
"""


def ordered(values: Mapping[Any, float], parameters: tuple[Any, ...]) -> FloatArray:
    """Return an array (k,) with `values[symbol]` for each symbol in `parameters`, in this order."""
    if tuple(values) == parameters:  # Hashing the symbols would take longer than the rest of this function.
        return np.array(list(values.values()), dtype=float)
    return np.array([values[symbol] for symbol in parameters], dtype=float)


def some_of(parameters: Parameters, states: Any) -> Parameters:
    """Return the parameters that belong to some states of a batch, those with the indices `states`.

    If `parameters` is an array (k, batch), these are its columns for these states. Otherwise all states share their
    parameters, which are returned unchanged.
    """
    if isinstance(parameters, np.ndarray) and parameters.ndim == 2:
        return np.ascontiguousarray(parameters[:, states])
    return parameters


def by_parameters(
    call: Callable[[FloatArray, tuple[FloatArray, FloatArray], FloatArray], FloatArray],
    t: float | FloatArray,
    state: tuple[FloatArray, FloatArray],
    parameters: FloatArray,
) -> FloatArray:
    """Return `call(t, (q, v), parameters)` for a batch of states, each of which has its own parameters.

    `t` is a number or (batch,), `state` is (q, v), each (n, batch), and `parameters` has shape (k, batch). All states
    with the same parameters are evaluated in one call, which gets these parameters as an array (k,).
    """
    q, v = state
    if q.shape[1:] != parameters.shape[1:]:
        raise StatementError(
            f"parameters has shape {parameters.shape}, but the batch of states has shape {q.shape[1:]}: give one value "
            f"for each parameter, ({len(parameters)},), or a column of values for each state."
        )
    times, results = np.broadcast_to(t, q.shape[1:]), np.empty(0)
    unique, which = np.unique(parameters, axis=1, return_inverse=True)
    for i, values in enumerate(unique.T if unique.shape[1] else np.ones((1, len(unique)))):
        columns = np.flatnonzero(which.reshape(-1) == i)
        part = call(times[columns], (q[:, columns], v[:, columns]), np.ascontiguousarray(values))
        results = results if i else np.empty((*part.shape[:-1], q.shape[1]))
        results[..., columns] = part
    return results


def with_zero_inputs(statement: Statement, parameters: Parameters) -> Parameters:
    """Return the parameters, with 0 for each input (a function of time without values) that has none.

    An array is returned unchanged, since it has all values.
    """
    if isinstance(parameters, np.ndarray) or not statement.inputs:
        return parameters
    stated = table_of(parameters, "parameters", "parameter to value")
    names = {label_of(key) for key in stated}
    return {**stated, **{symbol.name: 0.0 for symbol, _ in statement.inputs if symbol.name not in names}}


class ParameterValues:
    """Checks the parameter values that a user passes to a model, and completes them with the statement's defaults."""

    def __init__(self, statement: Statement) -> None:
        self._statement = statement

    def by_symbol(self, values: Mapping[Any, Any] | None) -> dict[Any, float]:
        """Return {symbol: value} for every parameter of the statement: from `values` if it is there, else the default.

        Keys of `values` are symbols or names. None means only defaults.
        """
        return dict(self._defaults) if values is None else self._overlaid(values)

    def array(self, values: Parameters) -> FloatArray:
        """Return the values of all parameters as an array (k,) in the statement's order.

        `values` may be a dict by symbol or name, or None for the defaults. An array, (k,) or (k, batch), is checked
        and returned unchanged.
        """
        if values is None:
            return self._default_array
        if isinstance(values, np.ndarray):
            return self._checked(values)
        if isinstance(values, Mapping) and not values:
            return self._default_array
        return ordered(self._overlaid(values), self._statement.parameters)

    def _overlaid(self, values: Mapping[Any, Any] | None) -> dict[Any, float]:
        stated = self._statement
        return parameter_values(values, stated.parameters, stated.defaults, friction_names(stated.contacts))

    @cached_property
    def _defaults(self) -> dict[Any, float]:
        return self._overlaid(None)

    @cached_property
    def _default_array(self) -> FloatArray:
        return ordered(self._defaults, self._statement.parameters)

    def _checked(self, values: FloatArray) -> FloatArray:
        plain = type(values) is np.ndarray and values.dtype is DOUBLE
        array = values if plain else real_array(values, "parameters")
        parameters = self._statement.parameters
        if array.ndim == 2 and len(array) == len(parameters):
            for column in np.unique(array, axis=1).T:
                self._checked(np.ascontiguousarray(column))
            return array
        if array.shape != (len(parameters),):
            raise StatementError(
                f"parameters has shape {array.shape}: give ({len(parameters)},), the values of "
                f"{listing(p.name for p in parameters)} in this order, or a dict."
            )
        numbers = array.tolist()
        if numbers and not (
            math.isfinite(sum(numbers)) and (min(numbers) >= 0.0 or all(numbers[i] >= 0.0 for i in self._positive))
        ):
            # An array must satisfy the same conditions as a dict. The dict raises the error.
            self._overlaid(dict(zip(parameters, numbers, strict=True)))
        return array

    @cached_property
    def _positive(self) -> list[int]:
        """Indices, in the order of the statement, of the parameters that must not be negative."""
        return [i for i, symbol in enumerate(self._statement.parameters) if symbol.is_nonnegative]
