"""Sample curves from the dense output, exact within a pixel, and choose the limits of axes, also for diverging runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.show.interpolated_states import known_alone
from lagrange.trajectory.measures.times_and_points import divided
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory


def around(values: FloatArray, scale: float = 0.0) -> tuple[float, float]:
    """Return the limits (low, high) of an axis around the finite values, with a margin.

    Values that differ only by rounding noise are in the middle of the axis, as a level line. The noise is relative to
    the largest value, or to `scale` if that is larger.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    size = max(abs(low), abs(high), scale)
    if high - low <= LEVEL_RANGE * size:
        middle, half = low / 2 + high / 2, 0.5 * size or 1.0
        return middle - half, middle + half
    room = AXIS_MARGIN * (high - low)
    return low - room, high + room


AXIS_MARGIN = 0.06  # Margin beside the values of an axis, as a fraction of their range

BLOWN_UP = (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.SINGULAR, Status.DIVERGED)
"""Statuses of runs whose values may have grown without bound; any other run is drawn whole."""

SHOWN_SHARE = 0.9
"""Fraction of the time for which a panel shows the values of a diverging run. The panel extends above and below these
values by their range."""

OVERSHOOT = 0.15  # Distance by which lines continue beyond a panel, as a fraction of its height

EDGE_MARGIN = 0.1
"""Margin between the extreme values of a diverging run and the edge of its panel, as a fraction of the range of the
values in the middle `SHOWN_SHARE` of the time."""

_SAMPLES = 2001


@dataclass(frozen=True)
class AxisWindow:
    """Limits `low` and `high` of a panel for a diverging run, some of whose values are outside of the limits.

    `largest` is the value with the largest magnitude in the run.
    """

    low: float
    high: float
    largest: float

    @property
    def note(self) -> str:
        """Note for the panel: the share of the time that it shows, and the largest value after that."""
        return f"shown: {SHOWN_SHARE:.0%} of the time; then up to {self.largest:.1e}"

    def clipped(self, rows: FloatArray) -> FloatArray:
        """Return `rows` of values, in which values far outside of the panel are moved to just outside of it."""
        room = OVERSHOOT * (self.high - self.low)
        return np.clip(rows, self.low - room, self.high + room)


def window_of(solution: Solution, values: Rows) -> AxisWindow | None:
    """Return the limits of a panel for a run whose values grow without bound, or None if the panel shows all values.

    `values(t)` returns the rows of values, (r, K), at times (K,). Two quantiles enclose the values for `SHOWN_SHARE`
    of the time. Each limit is a quantile, moved outwards by the distance of the two quantiles; it is nearer if no value
    is so far away. The result is None if the run did not end at a singularity, and if all values are within the limits.
    """
    if solution.status not in BLOWN_UP or len(solution.t) < 2:
        return None
    first, last = float(solution.t[0]), float(solution.t[-1])
    times, outputs = np.linspace(first, last, _SAMPLES), values(solution.t)
    if outputs_alone(solution.trajectory):
        order = np.argsort(solution.t)
        rows = np.array([np.interp(times, solution.t[order], row[order]) for row in outputs])
    else:
        rows = values(times)
    finite = rows[np.isfinite(rows)]
    if not len(finite):
        return None
    low, high = np.quantile(finite, [(1 - SHOWN_SHARE) / 2, (1 + SHOWN_SHARE) / 2])
    room = float(high - low)
    everything = np.concatenate([finite, outputs[np.isfinite(outputs)]])
    if room <= 0 or (everything.min() >= low - room and everything.max() <= high + room):
        return None
    least, most = float(everything.min()), float(everything.max())
    edge = EDGE_MARGIN * room
    return AxisWindow(
        max(float(low) - room, least - edge), min(float(high) + room, most + edge), most if most > -least else least
    )


def times_in_sight(solution: Solution, values: Rows) -> tuple[FloatArray, str]:
    """Return the times (K,) at which a curve in a plane or in space is sampled first, and a note or "".

    `values(t)` returns the d coordinates of one or several points, (d, K) or (d, p, K). If a coordinate leaves the
    limits of the panel, the times end before that, and the note reports it.
    """
    t = first_times(solution.trajectory)
    rows = values(t)

    def row_of(k: int) -> Rows:
        return lambda t: np.atleast_2d(values(t)[k])

    windows = [window_of(solution, row_of(k)) for k in range(len(rows))]
    outside = np.zeros(len(t), dtype=bool)
    for window, row in zip(windows, rows, strict=True):
        if window is not None:
            outside |= ((row < window.low) | (row > window.high)).reshape(-1, len(t)).any(axis=0)
    end = int(np.argmax(outside))
    note = max(filter(None, windows), key=lambda window: abs(window.largest)).note if end > 1 else ""
    return t[:end] if end > 1 else t, note


def limits_of(windows: Sequence[AxisWindow | None], drawn: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return the limits of a panel for several curves, or None if the panel shows all curves completely.

    `windows` has the limits for each curve, None for a curve that is shown completely. `drawn` has the values of each
    curve.
    """
    if all(window is None for window in windows):
        return None
    ends = [value for window in windows if window is not None for value in (window.low, window.high)]
    whole = [row[np.isfinite(row)] for window, row in zip(windows, drawn, strict=True) if window is None]
    ends += [float(end(row)) for row in whole if len(row) for end in (np.min, np.max)]
    return min(ends), max(ends)


Rows = Callable[[FloatArray], FloatArray]  # Function from times (K,) to r values at each, (r, K)

Points = Callable[[FloatArray], FloatArray]
"""Function from times (K,) to p points of the plane at each, (p, 2, K)."""

TOLERANCE = 0.3
"""Largest accepted distance, in pixels, of a curve from the chord between two samples. The interval of a worse chord is
divided in two, which divides the distance by about four. The largest remaining distance in all scenes, over 1,000
periods, is 0.3."""

MOST_SAMPLES = 2**18
"""Largest number of samples of a curve. Refinement stops there, even if a chord is still inexact. Only rounding noise
and runs of 10,000 periods reached it; then each column of pixels has the smallest and the largest of 100 samples."""

_MOST_VALUES = 2**25  # Largest number of coordinates of all samples: 256 MB

_EACH_STEP, _FEWEST, _MOST_FIRST = 12, 500, 120_000
"""Samples of a curve before refinement: the number for each step of the run, and the least and the largest number for
the whole curve. A step of order 30 can cover three periods of an oscillation."""

MOST_ROUNDS = 60
"""Largest number of times that intervals between samples are halved. The least length of an interval is reached after
fewer, so the limit only guards against an endless loop."""

_SHARE = 0.47
"""Point at which an interval is divided, as a fraction of its length. With 0.5 a curve that is point-symmetric about
the middle of its chord would seem to lie on the chord."""

_LEAST = 1e-9  # Intervals shorter than this fraction of the span are not divided: the values jump there

LEVEL_RANGE = 1e-9
"""Largest range of values, relative to the largest magnitude, that is drawn as a level line: it is rounding noise."""

_COLUMNS = 2  # Columns per pixel of width. In each column a line keeps its first, last, smallest and largest value


@dataclass(frozen=True)
class Pixels:
    """Width and height of a panel in pixels, for a figure with `dpi` dots per inch."""

    width: float
    height: float


def first_times(run: Trajectory) -> FloatArray:
    """Return the times (K,) at which the curves of a `run` are sampled first: all outputs, and times between them.

    Of very many outputs some are selected, at irregular distances. With equal distances an oscillation could look
    slower than it is.
    """
    t = run.t
    if len(t) > MOST_SAMPLES:
        positions = np.arange(0.0, len(t) - 1, len(t) / MOST_SAMPLES)
        jitter = np.modf(np.arange(len(positions)) * 0.6180339887498949)[0] * len(t) / MOST_SAMPLES
        chosen = np.minimum(positions + jitter, len(t) - 1).astype(int)
        return np.asarray(t[np.unique(np.concatenate([[0], chosen, [len(t) - 1]]))])
    if outputs_alone(run):
        return t
    count = min(max(_FEWEST, _EACH_STEP * run.steps), _MOST_FIRST)
    return divided(t, -(-count // max(len(t) - 1, 1)))


def outputs_alone(run: Trajectory) -> bool:
    """Return True if a run has states at its outputs only and no dense output, such as a run from a file."""
    return known_alone(run) is not None


def over_time(values: Rows, t: FloatArray, pixels: Pixels, *, rounds: int = MOST_ROUNDS) -> list[FloatArray]:
    """Return a line for each row of values, exact within a pixel. A line is (2, K): times, then values.

    `values(t)` returns the rows (r, K) at times (K,). A line begins at the first of the times `t` and ends at the last
    one, which may be smaller. All rows together fill a panel of the size `pixels`. Where several oscillations are in
    one column of pixels, the line has their exact minimum and maximum. Intervals are divided at most `rounds` times; a
    few times are enough for values that are rounding noise.
    """
    rows = values(t)
    span = abs(float(t[-1] - t[0])) if len(t) else 0.0
    scale = _scale(pixels, np.array([span, _extents(rows, axis=(0, 1))]), len(rows))
    times, points = _refined(lambda times: _over(times, values(times)), t, _over(t, rows), scale, rounds)
    return [thinned(times, row, pixels) for row in points[:, 1]]


def in_plane(points: Points, t: FloatArray, pixels: Pixels) -> tuple[FloatArray, FloatArray]:
    """Return times (N,) and points of the plane (p, 2, N), whose polylines are exact within a pixel.

    `points(t)` returns the points (p, 2, K) at times (K,). All points together fill a panel of the size `pixels`.
    `t` are the times at which the points are sampled first.
    """
    coordinates = points(t)
    return _refined(points, t, coordinates, _scale(pixels, _extents(coordinates, axis=(0, 2)), len(coordinates)))


def _extents(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Return the largest minus the smallest finite value along `axis`; 0 for values that differ only by rounding."""
    finite = np.isfinite(values)
    low = np.min(values, axis=axis, initial=np.inf, where=finite)
    high = np.max(values, axis=axis, initial=-np.inf, where=finite)
    return np.where(high - low > LEVEL_RANGE * np.maximum(np.abs(low), np.abs(high)), high - low, 0.0)


def _scale(pixels: Pixels, extents: FloatArray, count: int) -> FloatArray:
    """Return the pixels per unit to the right and up, (count, 2), for `count` curves with the common ranges `extents`.

    A direction in which the curves have no extent has 0 pixels per unit.
    """
    size = np.array([pixels.width, pixels.height])
    return np.broadcast_to(np.divide(size, extents, out=np.zeros(2), where=extents > 0), (count, 2))


def _over(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the curves `values` (r, K) over the times `t` (K,) as points of the plane (r, 2, K): time, then value."""
    return np.stack([np.broadcast_to(t, values.shape), values], axis=1)


def _refined(
    points: Points, t: FloatArray, samples: FloatArray, scale: FloatArray, rounds: int = MOST_ROUNDS
) -> tuple[FloatArray, FloatArray]:
    """Return times (N,) and points (p, 2, N) of p curves, dense enough that every chord is exact within a pixel.

    `points(t)` returns the points at times (K,); `samples` (p, 2, K) are the points at the initial times `t` (K,).
    `scale` (p, 2) is the number of pixels per unit. Each of at most `rounds` rounds divides the intervals next to an
    inexact chord, or next to an extremum that the samples miss.
    """
    most = min(MOST_SAMPLES, _MOST_VALUES // max(2 * len(samples), 1))
    least = _LEAST * abs(float(t[-1] - t[0])) if len(t) else 0.0
    inexact = np.abs(np.diff(t)) > least
    for _ in range(rounds):
        if not inexact.any() or len(t) + np.count_nonzero(inexact) > most:
            break
        at = np.flatnonzero(inexact)
        middle = t[at] + _SHARE * (t[at + 1] - t[at])
        new = points(middle)
        bent = np.zeros(len(inexact), dtype=bool)
        bent[at] = _distance(new, samples[:, :, at], samples[:, :, at + 1], scale) > TOLERANCE
        t, samples = np.insert(t, at + 1, middle), np.insert(samples, at + 1, new, axis=2)
        near = with_neighbours(np.repeat(bent, 1 + inexact))
        inexact = (near | _beside_turns(t, samples * scale[:, :, None])) & (np.abs(np.diff(t)) > least)
    return t, samples


def _beside_turns(t: FloatArray, pixels: FloatArray) -> NDArray[np.bool_]:
    """Return a flag for each interval of the times `t` (K,): True if it is next to an extremum that the samples miss.

    The flags are (K - 1,). `pixels` (p, 2, K) are samples of p curves, in pixels. Where a coordinate turns back, the
    extremum is estimated by the parabola through three samples. The samples miss it if it is more than `TOLERANCE`
    pixels from the middle sample. The distance of a curve from its chords is not a sufficient test. Where many
    oscillations are in one column of pixels, the curve is almost vertical. It then lies on its chords, even if it
    continues beyond them.
    """
    flags = np.zeros(max(len(t) - 1, 0), dtype=bool)
    with np.errstate(all="ignore"):
        before, after = np.diff(t)[:-1], np.diff(t)[1:]
        slopes = np.diff(pixels) / np.diff(t)
        first, second = slopes[:, :, :-1], slopes[:, :, 1:]
        middle = (first * after + second * before) / (before + after)
        deviations = np.abs(middle**2 * (before + after) / (4 * (second - first)))
        missed = np.any((first * second <= 0) & (deviations > TOLERANCE), axis=(0, 1))
    flags[:-1] |= missed
    flags[1:] |= missed
    return flags


def with_neighbours(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return flags (K,) that are True where one of `flags` (K,) or a neighbour of it is True."""
    wider = flags.copy()
    wider[1:] |= flags[:-1]
    wider[:-1] |= flags[1:]
    return wider


def _distance(middle: FloatArray, begin: FloatArray, end: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the distance (K,) in pixels of the points `middle` from the chord between the points `begin` and `end`.

    Each argument has the points of p curves, (p, 2, K). The distance is the largest one among the curves, and 0 if it
    has no value. `scale` (p, 2) is the number of pixels per unit.
    """
    with np.errstate(all="ignore"):
        chord, away = (end - begin) * scale[:, :, None], (middle - begin) * scale[:, :, None]
        square = np.sum(chord**2, axis=1)
        share = np.clip(np.sum(chord * away, axis=1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
        distance = np.hypot(*np.moveaxis(away - share[:, None] * chord, 1, 0))
    return np.asarray(np.max(np.where(np.isfinite(distance), distance, 0.0), axis=0, initial=0.0))


def thinned(t: FloatArray, row: FloatArray, pixels: Pixels) -> FloatArray:
    """Return the values `row` (N,) at times `t` (N,) as a line (2, K) that covers the same pixels as all values.

    The line has the first, last, least and largest value in each column of pixels. Source: U. Jugel et al., M4: a
    visualization-oriented time series data aggregation, VLDB Endowment 7 (2014) 797.
    """
    columns = int(_COLUMNS * pixels.width)
    if len(t) <= 4 * columns:
        return np.stack([t, row])
    column = np.minimum((columns * ((t - t[0]) / (t[-1] - t[0]))).astype(int), columns - 1)
    edges = np.flatnonzero(np.diff(column))
    real = np.flatnonzero(np.isfinite(row))
    order = real[np.lexsort((row[real], column[real]))]
    parts = np.flatnonzero(np.diff(column[order]))
    extremes = [order[:1], order[parts], order[parts + 1], order[-1:]]
    kept = [np.array([0, len(t) - 1]), edges, edges + 1, *extremes, np.flatnonzero(~np.isfinite(row))]
    indices = np.unique(np.concatenate(kept))
    return np.stack([t[indices], row[indices]])
