"""Choose the frame times of an animation, and record the states, positions and energies of a run at these times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import LagrangeError, StatementError
from lagrange.show.interpolated_states import known_alone, states_for_pictures
from lagrange.statement.expression import positive_number, real_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.measures.times_and_points import points_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

MOST_FRAMES = 3000  # Largest number of frames of an animation: 100 s at 30 frames per second, or some 20 MB as a GIF

LEAST_FPS, MOST_FPS = 1.0, 60.0
"""Least and largest number of frames per second. Fewer show no motion; more are not shown by common screens."""

SHORTEST_RUN = 1.0  # Duration in seconds below which a run is slowed down, unless a speed is given
_TINY = 1e-290  # Duration of a run below which its speed overflows a double


@dataclass(frozen=True, eq=False)
class Timing:
    """The times of the frames of an animation: `t` (K,) in the run, and the duration `interval` of a frame in seconds.

    The first frame is at the start of the run. `speed` is the time of the run per second on the screen. `notes` are
    sentences on settings that differ from the requested ones.
    """

    t: FloatArray
    interval: float
    speed: float
    notes: tuple[str, ...] = ()

    @property
    def fps(self) -> float:
        """Frames per second. It is adjusted so that the last frame is exactly at the end of the run."""
        return 1.0 / self.interval

    @property
    def seconds(self) -> float:
        """Duration of the motion on the screen, from the first frame to the last, in seconds."""
        return self.interval * (len(self.t) - 1)


def timing(span: tuple[float, float], fps: float, speed: float | None = None) -> Timing:
    """Return the frame times of a run from span[0] to span[1], which may be smaller, at about `fps` frames per second.

    `speed` is the time of the run per second on the screen; frames after `MOST_FRAMES` are left out. With None the run
    is shown in real time, one unit of time per second. If this takes less than 1 s or more than `MOST_FRAMES` frames, a
    round speed is chosen. Raises StatementError for an invalid `fps` or `speed`.
    """
    fps = real_number(fps, "fps")
    if not LEAST_FPS <= fps <= MOST_FPS:
        raise StatementError(
            f"fps = {fps:g}: give a number of frames per second from {LEAST_FPS:g} to {MOST_FPS:g}; screens "
            "show no more."
        )
    whole = abs(span[1] - span[0])
    remedy = "give a positive number; 1 is real time, 2 twice as fast"
    pace = _fitting(whole, fps) if speed is None else positive_number(speed, "speed", remedy)
    if whole == 0:
        return Timing(np.array([span[0]]), 1.0 / fps, pace)
    seconds = whole / pace
    frame_count = seconds * fps
    if speed is not None and frame_count < 1.0:
        raise StatementError(
            f"speed = {pace:g} shows the run in {seconds:.3g} s, shorter than one frame: give a speed of "
            f"{whole * fps:.3g} or less."
        )
    if frame_count < MOST_FRAMES:
        frames = max(1, round(frame_count))
        how = f"{pace:g} units" if pace > 1 else f"{pace:g} of a unit"
        note = f"The run lasts {whole:.6g} units of time: {how} are shown in a second. speed = 1 is real time."
        notes = () if speed is not None or pace == 1.0 else (note,)
        return Timing(np.linspace(span[0], span[1], frames + 1), seconds / frames, pace, notes)
    t: FloatArray = span[0] + math.copysign(pace / fps, span[1] - span[0]) * np.arange(float(MOST_FRAMES))
    fitting = _rounded_up(pace * frame_count / (MOST_FRAMES - 1))
    count = f"{frame_count + 1:,.0f}" if frame_count < 1e12 else f"{frame_count:.3g}"
    note = (
        f"The first {MOST_FRAMES:,} of {count} frames are shown, to t = {t[-1]:.6g}: more are too many. "
        f"speed = {fitting:g} shows the whole run."
    )
    return Timing(t, 1.0 / fps, pace, (note,))


def _fitting(duration: float, fps: float) -> float:
    """Return the default speed for a run of this `duration`, at `fps` frames per second.

    The speed is 1, which is real time, or a round number if the animation would be too short or too long.
    """
    longest = (MOST_FRAMES - 1) / fps
    if duration < _TINY or SHORTEST_RUN <= duration <= longest:
        return 1.0
    if duration > longest:
        return _rounded_up(duration / min(longest, 30.0))
    return 1.0 / _rounded_up(5.0 / duration)


def _rounded_up(value: float) -> float:
    """Return the least number not below `value` that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= value * (1 - 1e-12))


MOST_SAMPLES = 12_000
"""Largest number of times at which a run is evaluated, unless there are more frames: 12,000 take some 50 ms."""

MOST_DETAIL = 16  # Largest number of samples for each frame: a path turns by a few degrees between two of them

_GAP = 2.5
"""Ratio of two ranges of the curves of T, V and E, above which the least V is subtracted from V and E for drawing: the
range without the subtraction, divided by the range with it."""

JUMP = 1e-9  # Change of the state at an event, relative to the state, above which the event has reset the state


@dataclass(frozen=True, eq=False)
class Recording:
    """A run at S sample times `t` (S,): at the K frames, and at `detail` - 1 times between neighbouring frames.

    - `states` are (2n, S).
    - `points` are the named points, (2, S) or (3, S) each; the dict may be empty.
    - `energies` are T, V and E by name, (S,) each; T and V only if both were stated. The dict may be empty.
    - `change` (S,) is the change of E relative to `energy_size`, and `kept` is true if E is conserved.
    - `jumps` are the indices of the samples after which an event sets states or parameters.
    - `energy_letter` is the printed letter of E.
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
    """Scale of the energies: the initial energy, or if that is close to zero the largest kinetic energy. Changes below
    the rounding noise of this scale are drawn as a level line."""

    @property
    def zero(self) -> float:
        """Energy that is subtracted from V and E for drawing: the least V, or 0.

        It is 0 unless the subtraction makes the common range of the curves much smaller. Without it such curves would
        look like straight lines.
        """
        if len(self.energies) < 2:
            return 0.0
        rows, least = np.array([*self.energies.values()]), float(self.energies["V"].min())
        shifted = rows - [[0.0], [least], [least]]
        return least if np.ptp(rows) > _GAP * np.ptp(shifted) else 0.0

    @property
    def frames(self) -> slice:
        """Slice that selects the samples at the frames from all samples of the recording."""
        return slice(None, None, self.detail)


def recording_of(solution: Solution, timing: Timing) -> Recording:
    """Return the recording of a run at the frames of `timing`, and at times between them.

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
    return Recording(
        statement=solution.model.statement,
        t=t,
        states=states,
        points=points,
        energies=energies,
        change=change,
        kept=bool(energies) and bool(solution.drift.conserved),
        jumps=_jumps(solution, t),
        detail=detail,
        energy_letter=solution.model.equations.structure.energy_letter,
        energy_size=size,
    )


THINNING_ERROR = 1e-3
"""Tolerance of thinning: the largest distance between a curve and the straight lines through the remaining samples,
relative to the extent of the curve. It is half a pixel."""


def thinned(recording: Recording) -> Recording:
    """Return the recording with the smallest number of samples between frames for which every curve looks the same."""
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
    """Return the largest distance of a row (S,) from the straight lines through every `factor`-th of its samples.

    It is the error of a curve that keeps only these samples.
    """
    coarse = row[::factor]
    share = np.arange(factor) / factor
    lines = coarse[:-1, None] * (1 - share) + coarse[1:, None] * share
    return float(np.abs(row[:-1].reshape(lines.shape) - lines).max(initial=0.0))


def _energies(solution: Solution, t: FloatArray, states: FloatArray) -> dict[str, FloatArray]:
    """Return the energies T, V and E at the samples, times t (S,) and states (2n, S), by name.

    The result is empty if one of them has no value at some sample. There is only E if no potential energy was stated.
    """
    if not solution.has_energy:
        return {}
    model, statement, parameters = solution.model, solution.model.statement, solution.parameters_at(t)
    energies: dict[str, FloatArray] = {}
    try:
        if statement.potential != 0:  # else T is the whole energy, or only L was stated
            parts = {"T": statement.kinetic, "V": statement.potential}
            energies = {name: model.evaluate_expression(part, t, states, parameters) for name, part in parts.items()}
        energies["E"] = np.asarray(model.energy(*model.layout.split(states), t, parameters))
    except LagrangeError:
        return {}
    return energies if all(np.isfinite(row).all() for row in energies.values()) else {}


def _jumps(solution: Solution, t: FloatArray) -> NDArray[np.intp]:
    """Return the indices (k,) of the samples after which a curve jumps, because an event sets states or parameters.

    `t` are the times of all samples.
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
