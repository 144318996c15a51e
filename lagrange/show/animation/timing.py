"""Timing of an animation: the speed, and for each frame its time in the run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lagrange.errors import StatementError
from lagrange.statement.expression import real_number
from lagrange.trajectory.trajectory import FloatArray

MOST_FRAMES = 3000
"""Largest number of frames of an animation: 100 s at 30 frames a second. As a GIF they take some 20 MB."""

LEAST_FPS, MOST_FPS = 1.0, 60.0
"""Least and largest number of frames per second: below, motion is invisible; above, no common screen shows them."""

SHORTEST_RUN = 1.0
"""Duration in seconds below which a run is slowed down, unless a speed is given."""

_TINY = 1e-290
"""Duration of a run below which its speed overflows a double."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Times of the frames in the run, (K,), and the duration of each frame on the screen, in seconds.

    The first frame is at the start of the run. `speed` is the time of the run per second on the screen; `notes` are
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
    """Return the timing of a run from span[0] to span[1], which may be earlier, at about `fps` frames per second.

    Without `speed` the run is shown in real time, one unit of time per second. If that takes less than 1 s or more than
    `MOST_FRAMES` frames, a round speed is chosen instead. With `speed`, frames after `MOST_FRAMES` are cut.
    """
    fps = real_number(fps, "fps")
    if not LEAST_FPS <= fps <= MOST_FPS:
        raise StatementError(
            f"fps = {fps:g}: give a number of frames per second from {LEAST_FPS:g} to {MOST_FPS:g}; screens "
            "show no more."
        )
    whole = abs(span[1] - span[0])
    if speed is None:
        pace = _fitting(whole, fps)
    elif (pace := real_number(speed, "speed")) <= 0:
        raise StatementError(f"speed = {pace:g}: give a positive number; 1 is real time, 2 twice as fast.")
    if whole == 0:
        return Timing(np.array([span[0]]), 1.0 / fps, pace)
    seconds = whole / pace
    frame_count = seconds * fps
    if speed is not None and frame_count < 1.0:
        raise StatementError(
            f"speed = {pace:g} shows the run in {seconds:.3g} s, which is less than a frame: give {whole * fps:.3g} or "
            "less."
        )
    if frame_count < MOST_FRAMES:
        frames = max(1, round(frame_count))
        how = f"{pace:g} units" if pace > 1 else f"{pace:g} of a unit"
        note = f"The run lasts {whole:.6g} units of time: {how} are shown in a second. speed = 1 is real time."
        notes = () if speed is not None or pace == 1.0 else (note,)
        return Timing(np.linspace(span[0], span[1], frames + 1), seconds / frames, pace, notes)
    return _cut(span, fps, pace)


def _cut(span: tuple[float, float], fps: float, speed: float) -> Timing:
    """Return the timing of a run with too many frames: its first `MOST_FRAMES` frames, and a note that says so."""
    direction = math.copysign(speed / fps, span[1] - span[0])
    t: FloatArray = span[0] + direction * np.arange(float(MOST_FRAMES))
    needed = abs(span[1] - span[0]) / speed * fps
    whole = _rounded_up(speed * needed / (MOST_FRAMES - 1))
    frames = f"{needed + 1:,.0f}" if needed < 1e12 else f"{needed:.3g}"
    note = (
        f"The first {MOST_FRAMES:,} of {frames} frames are shown, to t = {t[-1]:.6g}: more are too many. "
        f"speed = {whole:g} shows the whole run."
    )
    return Timing(t, 1.0 / fps, speed, (note,))


def _fitting(whole: float, fps: float) -> float:
    """Return the speed for a run of duration `whole`, at `fps` frames per second.

    It is 1, real time, or a round speed if the animation would be too short or too long otherwise.
    """
    longest = (MOST_FRAMES - 1) / fps
    if whole < _TINY or SHORTEST_RUN <= whole <= longest:
        return 1.0
    if whole > longest:
        return _rounded_up(whole / min(longest, 30.0))
    return 1.0 / _rounded_up(5.0 / whole)


def _rounded_up(value: float) -> float:
    """Return the least number not below `value` that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= value * (1 - 1e-12))
