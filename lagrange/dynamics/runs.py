"""Run one model from many starts with the same options; read the user's starts; find the period of a driving."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.plain_form import PlainForm
from lagrange.statement.coordinate import t
from lagrange.statement.declare import initial_state
from lagrange.statement.expression import real_array
from lagrange.statement.given.function import with_values
from lagrange.statement.rotation import check_start
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.consistent import with_rates
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Trajectory

Report = Callable[[float], None]  # Progress callback: number of finished runs
MOST_STARTS = 1_000_000  # Largest number of starts in a list or an array


@dataclass(frozen=True, eq=False)
class Runs:
    """A model with the values of its parameters (k,) and the options of a run. A call runs the model from a state."""

    model: Model
    parameters: FloatArray
    options: RunOptions

    def __call__(
        self, start: FloatArray, t0: float, t1: float, t_eval: FloatArray | None = None, events: Any = None
    ) -> Trajectory:
        """Return the run from the state `start` (2n,) at t0 to t1.

        With `t_eval` (k,) only the states at these times are kept. `events` replace the events in `options`, unless
        None.
        """
        options, statement = self.options, self.model.statement
        values = dict(zip(statement.parameters, self.parameters.tolist(), strict=True))
        watched = options.events if events is None else events
        chosen = options._replace(t_eval=t_eval, events=watched, parameters=values)
        initial = dict(zip(statement.state_names, start.tolist(), strict=True))
        return trajectory_of(self.model, (t0, t1), initial, chosen)[0]


def starts_of(model: Model, starts: Any, base: FloatArray) -> FloatArray:
    """Return initial states (m, 2n) from the user's `starts`: an array, a dict, or a list of dicts or rows.

    A dict replaces entries of the state `base` (2n,). If `starts` is None, `base` is the only initial state. Raises
    StatementError for an invalid start; the message gives its index.
    """
    size = model.layout.size
    if starts is None:
        return base[None, :].copy()
    if isinstance(starts, Mapping):
        starts = [starts]
    if isinstance(starts, np.ndarray):
        return _of_array(model, starts)
    if isinstance(starts, (str, bytes)) or not isinstance(starts, Iterable):
        raise StatementError(
            f"starts is {shown(starts)}: give a list of dicts such as {{{model.statement.names[0]!r}: 1.0}}, or an "
            f"array (m, {size})."
        )
    listed: list[Any] = []
    for entry in starts:
        if len(listed) == MOST_STARTS:
            raise StatementError(f"starts has more than {MOST_STARTS} entries: give fewer.")
        listed.append(entry)
    if not listed:
        raise StatementError(
            "starts is empty: give at least one initial state, such as {} for the stated initial state."
        )
    if not any(isinstance(entry, Mapping) for entry in listed):
        return _of_array(model, real_array(listed, "starts"))
    states = []
    for k, entry in enumerate(listed):
        try:
            states.append(initial_state(entry, model.statement.coordinates, tuple(base.tolist())))
        except StatementError as error:
            raise StatementError(f"start {k}: {error}") from error
    return np.array(states)


def _of_array(model: Model, starts: FloatArray) -> FloatArray:
    array, size = real_array(starts, "starts"), model.layout.size
    if array.ndim == 1 and array.shape == (size,):
        array = array[None, :]
    if array.ndim != 2 or array.shape[1] != size or not len(array):
        raise StatementError(
            f"starts has shape {array.shape}: give (m, {size}), a row [q, v] for each start, with "
            f"{' '.join(model.statement.state_names)}."
        )
    if not np.isfinite(array).all():
        raise StatementError("starts has entries that are not finite: give finite numbers.")
    check_start(model.statement.coordinates, array.T)
    return array.copy()


def initial_of(model: Model, overlay: Mapping[Any, Any] | None) -> FloatArray:
    """Return the stated initial state (2n,), with the entries in `overlay` replaced."""
    statement = model.statement
    return np.array(initial_state({} if overlay is None else overlay, statement.coordinates, statement.initial))


def time_scale(model: Model, states: FloatArray, parameters: FloatArray, fallback: float) -> float:
    """Return a typical period of small oscillations about states (m, 2n), or `fallback` if all eigenvalues are zero.

    Each nonzero eigenvalue of the Jacobian at a state gives a period 2 pi/|eigenvalue|. The period of the state is
    their geometric mean. The result is the median over the states. `parameters` (k,) are the values of the parameters.
    """
    periods = []
    followed = with_rates(model, 0.0, states[:: max(1, len(states) // 16)].T, parameters)
    for state in followed.T[np.isfinite(followed).all(axis=0)]:
        try:
            jacobian = model.jacobian(0.0, state, parameters)
        except RunError:
            continue
        if np.isfinite(jacobian).all():
            sizes = np.abs(np.linalg.eigvals(jacobian))
            logs = np.log(sizes[sizes > 1e-6 * sizes.max(initial=0.0)])
            periods += [2 * math.pi * math.exp(-float(logs.mean()))] if len(logs) else []
    return float(np.median(periods)) if periods else fallback


MOST_MULTIPLE = 64
"""Largest numerator and denominator of the ratio of two driving frequencies. Frequencies with another ratio count as
having no common period."""


def depends_on_time(statement: Statement) -> bool:
    """Return True if the Lagrangian, a force, the dissipation or a constraint contains time."""
    return any(part.has(t) for part in _parts(statement))


def _parts(statement: Statement) -> list[Any]:
    explicit = with_values(statement)
    form = PlainForm(explicit)
    return [form.lagrangian, *form.forces, *(form.read(constraint.expression) for constraint in explicit.constraints)]


@lru_cache(maxsize=64)
def _rates(statement: Statement) -> tuple[Any, ...]:
    """Return the angular frequencies of all sines and cosines of time in a statement.

    Raises StatementError if time occurs outside of sines and cosines.
    """
    parts = _parts(statement)
    circular = {wave for part in parts for wave in part.atoms(sympy.sin, sympy.cos)}
    waves = sorted((wave for wave in circular if wave.args[0].has(t) and wave.args[0].diff(t, 2) == 0), key=str)
    silent = {wave: sympy.Dummy() for wave in waves}
    if not waves or any(part.xreplace(silent).has(t) for part in parts):
        raise StatementError(
            f"the period of the driving of {statement.name} was not found, because t appears outside of sines and "
            "cosines: give section=..., the period in the unit of time."
        )
    return tuple(dict.fromkeys(wave.args[0].diff(t) for wave in waves))


def driving_period(statement: Statement, values: Mapping[Any, float]) -> float:
    """Return the common period of all sines and cosines of time in a statement, for the `values` of its parameters.

    Raises StatementError if their angular frequencies have no common period.
    """
    constants = {symbol: sympy.Float(value, 17) for symbol, value in values.items()}
    frequencies = {abs(float(frequency.xreplace(constants))) for frequency in _rates(statement)}
    rates = sorted(rate for rate in frequencies if rate > 0)
    if not rates:
        raise StatementError(
            f"the driving of {statement.name} has the frequency zero: give section=..., the period in the unit of time."
        )
    ratios = [Fraction(rate / rates[0]).limit_denominator(MOST_MULTIPLE) for rate in rates]
    if any(
        abs(float(ratio) - rate / rates[0]) > 1e-9 * rate / rates[0] for ratio, rate in zip(ratios, rates, strict=True)
    ):
        raise StatementError(
            f"the driving of {statement.name} has the frequencies {listing(f'{rate:g}' for rate in rates)}, which have "
            "no common period: give section=..., the period in the unit of time."
        )
    whole = math.lcm(*(ratio.denominator for ratio in ratios))
    step = math.gcd(*(ratio.numerator * (whole // ratio.denominator) for ratio in ratios))
    return 2 * math.pi / (rates[0] * step / whole)
