"""The recording of a run for moving pictures: states, positions and energies at the frames and between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import LagrangeError, StatementError
from lagrange.show.animation.timing import Timing
from lagrange.show.states_between_outputs import known_alone, states_for_pictures
from lagrange.show.units import energy_letter
from lagrange.statement.statement import Statement
from lagrange.trajectory.measures.sampling import points_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

MOST_SAMPLES = 12_000
"""Largest number of times at which a run is evaluated, unless there are more frames: 12,000 take some 50 ms."""

MOST_DETAIL = 16
"""Largest number of samples for each frame: a path turns by a few degrees between two of them."""

_GAP = 2.5
"""If V and E, drawn from zero, extend the range of the energies by more than this factor, they are drawn from the least
V."""

JUMP = 1e-9
"""Change of a state at an event, relative to the states, above which the event has reset it."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A run at S = (K - 1) detail + 1 times `t`: the times of K frames, and detail - 1 times between two frames.

    - `states` are (2n, S).
    - `points` are the named points, (2, S) or (3, S) each; the dict may be empty.
    - `energies` are T, V and E by name, (S,) each; T and V only if both were stated. The dict may be empty.
    - `change` (S,) is the change of E relative to its size, and `kept` is true if E is conserved.
    - `jumps` are the indices of the samples after which an event sets states or parameters.
    """

    statement: Statement
    t: FloatArray
    states: FloatArray
    points: Mapping[str, FloatArray]
    energies: Mapping[str, FloatArray]
    change: FloatArray
    kept: bool
    jumps: NDArray[np.intp]
    detail: int
    energy_letter: str = "E"
    energy_size: float = 0.0
    """Largest magnitude of the terms that are added to the energies. Changes smaller than its rounding noise are drawn
    as a level line."""

    @property
    def zero(self) -> float:
        """Energy that is subtracted from V and E for drawing: 0, or the least V.

        It is the least V if curves that start from 0 would look like straight lines.
        """
        if len(self.energies) < 2:
            return 0.0
        rows, least = np.array([*self.energies.values()]), float(self.energies["V"].min())
        shifted = rows - [[0.0], [least], [least]]
        return least if np.ptp(rows) > _GAP * np.ptp(shifted) else 0.0

    @property
    def frames(self) -> slice:
        """Slice that selects the samples of the frames."""
        return slice(None, None, self.detail)


def recording_of(solution: Solution, timing: Timing) -> Recording:
    """Return the recording of a run, from its states at the frames and between them.

    Raises StatementError where a named point has no position, and for a run from a file with too few states.
    """
    frames = timing.t
    detail = 1
    while len(frames) > 1 and detail < MOST_DETAIL and 2 * detail * len(frames) <= MOST_SAMPLES:
        detail *= 2
    positions = np.arange((len(frames) - 1) * detail + 1) / detail
    t = np.interp(positions, np.arange(len(frames)), frames)
    t[::detail] = frames
    states = states_for_pictures(solution, t)
    points = points_at(solution.model, t, states, solution.parameters_at(t))
    for name, point in points.items():
        lost = np.flatnonzero(~np.isfinite(point).all(axis=0))
        if len(lost):
            raise StatementError(
                f"{name} has no finite position at t = {t[lost[0]]:.6g}, so that it cannot be drawn: end the run "
                "before that time, or state another position."
            )
    if not points and not np.isfinite(states).all():
        raise StatementError(
            "the run has a state that is not a finite number, which cannot be drawn: run again to an earlier end."
        )
    energies = _energies(solution, t, states)
    size = solution.drift.scale if energies else 0.0
    change = (energies["E"] - energies["E"][0]) / (size or 1.0) if energies else np.empty(0)
    kept = bool(energies) and bool(solution.drift.conserved)
    jumps = _jumps(solution, t)
    letter = energy_letter(solution.model.equations)
    return Recording(solution.model.statement, t, states, points, energies, change, kept, jumps, detail, letter, size)


THINNING_ERROR = 1e-3
"""Tolerance of thinning: the largest distance between a curve and the straight lines through its samples, relative to
its extent. It is half a pixel."""


def thinned(recording: Recording) -> Recording:
    """Return the recording with fewer samples between its frames: the fewest with which every curve looks the same."""
    groups = [[row for point in recording.points.values() for row in point], [*recording.energies.values()]]
    groups += [[row] for row in recording.states[: len(recording.statement.names)]]
    rows = [(row, max(map(np.ptp, group), default=0.0)) for group in groups for row in group]
    detail = 1
    while detail < recording.detail and any(
        _deviation(row, recording.detail // detail) > THINNING_ERROR * size for row, size in rows
    ):
        detail *= 2
    every = recording.detail // detail
    return replace(
        recording,
        t=recording.t[::every],
        states=recording.states[:, ::every],
        points={name: point[:, ::every] for name, point in recording.points.items()},
        energies={name: row[::every] for name, row in recording.energies.items()},
        change=recording.change[::every],
        jumps=np.unique(recording.jumps // every),
        detail=detail,
    )


def _deviation(row: FloatArray, factor: int) -> float:
    """Return the largest distance of a row (S,) from straight lines through every `factor`-th of its samples."""
    coarse = row[::factor]
    share = np.arange(factor) / factor
    lines = coarse[:-1, None] * (1 - share) + coarse[1:, None] * share
    return float(np.abs(row[:-1].reshape(lines.shape) - lines).max(initial=0.0))


def _energies(solution: Solution, t: FloatArray, states: FloatArray) -> dict[str, FloatArray]:
    """Return the energies at the samples, by name; empty if one of them has no value at some sample."""
    if not solution.has_energy:
        return {}
    model, statement, parameters = solution.model, solution.model.statement, solution.parameters_at(t)
    energies: dict[str, FloatArray] = {}
    try:
        if statement.potential != 0:  # a Lagrangian has no parts, and without V the kinetic energy is all of it
            parts = {"T": statement.kinetic, "V": statement.potential}
            energies = {name: model.evaluate_expression(part, t, states, parameters) for name, part in parts.items()}
        energies["E"] = np.asarray(model.energy(*model.layout.split(states), t, parameters))
    except LagrangeError:
        return {}
    return energies if all(np.isfinite(row).all() for row in energies.values()) else {}


def _jumps(solution: Solution, t: FloatArray) -> NDArray[np.intp]:
    """Return the indices (k,) of the samples before a jump.

    At a jump an event sets states or parameters, before the next sample.
    """
    run = solution.trajectory
    times = [np.empty(0)] if run.history is None else [run.history.begins[1:]]
    if known_alone(run) is None:
        for at, before in zip(run.t_events, run.y_events, strict=True):
            moved = np.abs(solution.at(at).T - before) > JUMP * np.abs(before).max(initial=1.0)
            times.append(at[moved.any(axis=1)])
    forward = 1.0 if t[-1] >= t[0] else -1.0
    indices = np.unique(np.searchsorted(forward * t, forward * np.concatenate(times), side="left") - 1)
    return np.asarray(indices[(indices >= 0) & (indices < len(t) - 1)], dtype=np.intp)
