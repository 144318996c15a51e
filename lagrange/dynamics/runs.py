"""Many runs of one model with the same options: starts as users give them, and progress."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.members.job import Job
from lagrange.members.keep import keep_of
from lagrange.statement.declare import initial_state
from lagrange.statement.event import Event
from lagrange.statement.number import real_array
from lagrange.trajectory.integrate import integrate
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.trajectory import Trajectory

Report = Callable[[float], None]
"""Progress callback: number of finished runs."""

MOST_STARTS = 1_000_000
"""Largest number of starts in a list or an array."""


@dataclass(frozen=True, eq=False)
class Runs:
    """A model with its parameters, (k,), and the options that all runs share."""

    model: Model
    parameters: FloatArray
    options: RunOptions

    def __call__(
        self, start: FloatArray, t0: float, t1: float, t_eval: FloatArray | None = None, events: Any = None
    ) -> Trajectory:
        """Run from a state (2n,) at t0 to t1. With `t_eval` (k,) only the states at these times are kept."""
        options, statement = self.options, self.model.statement
        values = dict(zip(statement.parameters, self.parameters.tolist(), strict=True))
        chosen = RunOptions(
            options.method,
            options.rtol,
            options.atol,
            options.step,
            t_eval,
            options.events if events is None else events,
            options.max_steps,
            parameters=values,
        )
        initial = dict(zip(statement.state_names, start.tolist(), strict=True))
        return integrate(self.model, (t0, t1), initial, chosen)[0]

    def job(
        self,
        t0: float,
        t1: float,
        keep: Any,
        events: tuple[Event, ...] = (),
        *,
        t_eval: FloatArray | None = None,
        varying: bool = False,
    ) -> Job:
        """Return many runs from t0 to t1, as an ensemble job; `keep` is as in `lagrange.ensemble`.

        With `varying` each run has its own parameters.
        """
        model, given = self.model, self.options
        options = replace(given, method=find(DEFAULT if given.method is None else given.method), events=events)
        problem = Problem(
            model=model,
            parameters=dict(zip(model.statement.parameters, self.parameters.tolist(), strict=True)),
            t0=t0,
            t1=t1,
            y0=np.zeros(model.layout.size),
            t_eval=t_eval,
            rtol=options.rtol,
            atol=options.atol,
            step=options.step,
            max_steps=options.step_limit,
            events=events,
        )
        return Job(problem, options, keep_of(keep, model, events), varying)


def starts_of(model: Model, given: Any, base: FloatArray) -> FloatArray:
    """Return starts as states (m, 2n), from a dict, a list of dicts, or an array (m, 2n) or (2n,).

    A dict overlays `base` (2n,). Raises StatementError with the number of the start.
    """
    size = model.layout.size
    if given is None:
        return base[None, :].copy()
    if isinstance(given, Mapping):
        given = [given]
    if isinstance(given, np.ndarray):
        return _of_array(model, given)
    if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
        raise StatementError(
            f"starts is {shown(given)}: give a list of dicts such as {{{model.statement.names[0]!r}: 1.0}}, or an "
            f"array (m, {size})."
        )
    listed: list[Any] = []
    for one in given:
        if len(listed) == MOST_STARTS:
            raise StatementError(f"starts has more than {MOST_STARTS} entries: give fewer.")
        listed.append(one)
    if not listed:
        raise StatementError("starts is empty: give at least one initial state, such as {}: the system's own.")
    if not any(isinstance(one, Mapping) for one in listed):
        return _of_array(model, real_array(listed, "starts"))
    return np.array([_of_dict(model, one, k, base) for k, one in enumerate(listed)])


def _of_dict(model: Model, given: Any, place: int, base: FloatArray) -> FloatArray:
    try:
        return np.array(initial_state(given, model.statement.coordinates, tuple(base.tolist())))
    except StatementError as error:
        raise StatementError(f"start {place}: {error}") from error


def _of_array(model: Model, given: FloatArray) -> FloatArray:
    array, size = real_array(given, "starts"), model.layout.size
    if array.ndim == 1 and array.shape == (size,):
        array = array[None, :]
    if array.ndim != 2 or array.shape[1] != size or not len(array):
        raise StatementError(
            f"starts has shape {array.shape}: give (m, {size}), a row [q, v] for each start, with "
            f"{' '.join(model.statement.state_names)}."
        )
    if not np.isfinite(array).all():
        raise StatementError("starts has entries that are not finite: give finite numbers.")
    return array.copy()


def initial_of(model: Model, overlay: Mapping[Any, Any] | None) -> FloatArray:
    """Return the initial state of a statement, overlaid with other entries, (2n,)."""
    statement = model.statement
    return np.array(initial_state({} if overlay is None else overlay, statement.coordinates, statement.initial))


def time_scale(model: Model, states: FloatArray, parameters: FloatArray, fallback: float) -> float:
    """Return the period 2 pi/|eigenvalue| of small motions about states (m, 2n), or `fallback` if all are zero.

    It is the geometric mean over the nonzero eigenvalues of a state, and the median over the states.
    """
    periods = []
    for state in states[:: max(1, len(states) // 16)]:
        try:
            jacobian = model.jacobian(0.0, state, parameters)
        except RunError:
            continue
        if np.isfinite(jacobian).all():
            sizes = np.abs(np.linalg.eigvals(jacobian))
            logs = np.log(sizes[sizes > 1e-6 * sizes.max(initial=0.0)])
            periods += [2 * math.pi * math.exp(-float(logs.mean()))] if len(logs) else []
    return float(np.median(periods)) if periods else fallback
