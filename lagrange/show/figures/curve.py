"""Curves from dense output, within a pixel; where they blow up, and the level that is subtracted from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from lagrange.show.between import known_alone
from lagrange.trajectory.paths.samples import divided
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

_NARROW = 1e-4
"""Values, and times, that differ by less than this part of the largest are drawn as differences from a number, which
is said: else their labels would have more than five digits alike."""


def base_of(values: FloatArray) -> float:
    """Return a round number that is subtracted from values which are almost alike, else 0."""
    size = float(np.max(np.abs(values), initial=0.0))
    extent = float(np.ptp(values)) if len(values) else 0.0
    if not LEVEL * size < extent < _NARROW * size:
        return 0.0
    return round(float(values[0]), -floor(log10(extent)))


def less(label: str, base: float) -> str:
    """Return a label of values from which a number was subtracted."""
    if base == 0:
        return label
    return f"{label} {'−' if base > 0 else '+'} {abs(base):.15g}"


def level(values: FloatArray) -> tuple[float, float] | None:
    """Return limits in which values that stay put up to round-off are a level line; None for others."""
    size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    if not len(values) or np.ptp(values) > LEVEL * size:
        return None
    middle, half = float(values[0]), 0.5 * size or 1.0
    return middle - half, middle + half


BLOWN_UP = (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.SINGULAR, Status.DIVERGED)
"""How runs end whose values may have grown without bound; any other run is drawn whole."""

SHARE = 0.9
"""The part of the time whose values a panel shows at least, with as much room again on either side."""

ROOM = 0.15
"""How far beyond a panel lines go on, in parts of its height."""

EDGE = 0.1
"""Room beside the least or largest value where a window has it, in parts of the range of the middle values."""

_SAMPLES = 2001


@dataclass(frozen=True)
class Window:
    """The values (low, high) that a panel shows of a run that leaves it, and the largest that it does not show."""

    low: float
    high: float
    largest: float

    @property
    def note(self) -> str:
        """What is said of the values beyond."""
        return f"shown: {SHARE:.0%} of the time; then up to {self.largest:.1e}"

    @property
    def bounds(self) -> tuple[float, float]:
        """The values up to which lines are drawn, a little beyond the panel."""
        room = ROOM * (self.high - self.low)
        return self.low - room, self.high + room


def window_of(solution: Solution, values: Rows) -> Window | None:
    """Return what a panel shows of the rows (r, K) of a run at times (K,); None where it shows all of them.

    That is the middle of the values, weighted by time, and as much again on either side. A run that did not end at a
    singularity is shown whole, and so is one whose values are all within these limits.
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
    low, high = np.quantile(finite, [(1 - SHARE) / 2, (1 + SHARE) / 2])
    room = float(high - low)
    everything = np.concatenate([finite, outputs[np.isfinite(outputs)]])
    if room <= 0 or (everything.min() >= low - room and everything.max() <= high + room):
        return None
    least, most = float(everything.min()), float(everything.max())
    edge = EDGE * room
    return Window(
        max(float(low) - room, least - edge), min(float(high) + room, most + edge), most if most > -least else least
    )


def row_of(values: Rows, k: int) -> Rows:
    """Return the values of one row alone, (1, K), or of one entry of all points (p, K)."""
    return lambda t: np.atleast_2d(values(t)[k])


def clipped(windows: Sequence[Window | None], rows: FloatArray) -> FloatArray:
    """Return rows (r, ..., K) with the bounds of the window of each for what is beyond them."""
    pairs = zip(windows, rows, strict=True)
    return np.array([row if window is None else np.clip(row, *window.bounds) for window, row in pairs])


def cut(windows: Sequence[Window | None], rows: FloatArray) -> FloatArray:
    """Return clipped rows (r, ..., K) with NaN where one is at its bounds, so that lines end there."""
    beyond = np.zeros(rows.shape[1:], dtype=bool)
    for window, row in zip(windows, rows, strict=True):
        if window is not None:
            beyond |= (row <= window.bounds[0]) | (row >= window.bounds[1])
    inner = beyond.copy()  # a line is drawn up to the first corner beyond
    inner[..., 1:] &= beyond[..., :-1]
    return np.where(inner, np.nan, rows)


def limits_of(windows: Sequence[Window | None], drawn: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return the limits in which some curves are shown, each in its window or whole; None where all are whole."""
    if all(window is None for window in windows):
        return None
    ends = [value for window in windows if window is not None for value in (window.low, window.high)]
    whole = [row[np.isfinite(row)] for window, row in zip(windows, drawn, strict=True) if window is None]
    ends += [float(end(row)) for row in whole if len(row) for end in (np.min, np.max)]
    return min(ends), max(ends)


def notes_of(windows: Iterable[Window | None]) -> str:
    """Return what is said of the values beyond some windows: of the one with the largest."""
    found = [window for window in windows if window is not None]
    return max(found, key=lambda window: abs(window.largest)).note if found else ""


Rows = Callable[[FloatArray], FloatArray]
"""Times (K,) to r values at each, (r, K)."""

Points = Callable[[FloatArray], FloatArray]
"""Times (K,) to p points of the plane at each, (p, 2, K)."""

TOLERANCE = 0.3
"""Pixels from a chord to the curve behind which a chord is halved. Halving leaves about a quarter of it: the largest
distance that was measured over all scenes and 1,000 periods is 0.3."""

MOST = 2**18
"""Samples of a curve, over its rows. Chords that are not within the tolerance then stay, which was seen for round-off
alone and behind 10,000 periods, where each column of pixels has the smallest and the largest of 100 samples."""

_MOST_VALUES = 2**24
"""Samples times rows: 128 MB."""

_EACH_STEP, _FEWEST, _MOST_FIRST = 12, 500, 120_000
"""Samples of a step to begin with, and the least and the most of them: a step of order 30 holds three periods."""

MOST_ROUNDS = 60
"""Rounds of halving, more than lead from any interval to the least."""

_SHARE = 0.47
"""Where an interval is halved, which is not in the middle: there a curve with a turning point meets its chord."""

_LEAST = 1e-9
"""An interval below this part of the span is not halved: there is a jump in it."""

LEVEL = 1e-9
"""Values that differ by less than this part of the largest are drawn as a level line: the rest is round-off."""

_COLUMNS = 2
"""Columns to a pixel, of each of which a line has the first, the last, the smallest and the largest value."""


@dataclass(frozen=True)
class Pixels:
    """The width and the height of a panel in pixels, for a figure with so many dots to an inch."""

    width: float
    height: float


def first_times(run: Trajectory) -> FloatArray:
    """Return times to begin with, (K,) from the first output to the last, all outputs and those between steps.

    Of very many outputs it has some, at irregular distances, so that no oscillation keeps in step with them.
    """
    t = run.t
    if len(t) > MOST:
        places = np.arange(0.0, len(t) - 1, len(t) / MOST)
        jitter = np.modf(np.arange(len(places)) * 0.6180339887498949)[0] * len(t) / MOST
        chosen = np.minimum(places + jitter, len(t) - 1).astype(int)
        return np.asarray(t[np.unique(np.concatenate([[0], chosen, [len(t) - 1]]))])
    if outputs_alone(run):
        return t
    wanted = min(max(_FEWEST, _EACH_STEP * run.steps), _MOST_FIRST)
    return divided(t, -(-wanted // max(len(t) - 1, 1)))


def outputs_alone(run: Trajectory) -> bool:
    """Return whether there are no states between the outputs: they came from a file."""
    return known_alone(run) is not None


def over_time(
    values: Rows, t: FloatArray, pixels: Pixels, *, together: bool = True, rounds: int = MOST_ROUNDS
) -> list[FloatArray]:
    """Return a line for each row of values, corners (2, K) with time first, within a pixel of the exact curve.

    It is drawn from the first of the times (K,) to the last, rising or falling, in a panel that the values fill; rows
    that are not drawn `together` have a scale each. Where several oscillations share a column of pixels the line has
    their exact minimum and maximum. Chords are halved in so many `rounds`: few for what is round-off at the end.
    """
    found = values(t)
    height = _extents(found, axis=(0, 1) if together else 1)
    span = abs(float(t[-1] - t[0])) if len(t) else 0.0
    scale = np.stack(np.broadcast_arrays(_pixels_in(pixels.width, span), _pixels_in(pixels.height, height)), axis=-1)
    times, states = _refined(values, t, found, _over, np.broadcast_to(scale, (len(found), 2)), rounds)
    return [thinned(times, row, pixels) for row in states]


def in_plane(points: Points, t: FloatArray, pixels: Pixels, *, equal: bool = True) -> tuple[FloatArray, FloatArray]:
    """Return times (K,) and points of the plane (p, 2, K), whose polylines are within a pixel of the exact paths.

    They are drawn in one panel that they fill, with lengths that are `equal` in both directions unless told otherwise.
    """
    found = points(t)
    scale = _pixels_in(np.array([pixels.width, pixels.height]), _extents(found, axis=(0, 2)))
    if equal:
        scale = np.full(2, np.min(scale))
    shape = (len(found), 2)
    flat = _refined(
        lambda times: points(times).reshape(2 * len(found), len(times)),
        t,
        found.reshape(2 * len(found), len(t)),
        lambda _, v: v.reshape(*shape, v.shape[-1]),
        np.broadcast_to(scale, shape),
    )
    return flat[0], flat[1].reshape(*shape, -1)


def lengths(points: FloatArray) -> FloatArray:
    """Return how far the polyline of points (p, 2, K) has gone at each corner, (K,), that of the longest one."""
    steps = np.nan_to_num(np.hypot(*np.moveaxis(np.diff(points, axis=2), 1, 0)))
    gone = np.concatenate([np.zeros((len(points), 1)), np.cumsum(steps, axis=1)], axis=1)
    longest: FloatArray = gone[np.argmax(gone[:, -1])] if len(gone) else np.zeros(points.shape[2])
    return longest


def _extents(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Return from the smallest to the largest of the finite values along axes, 0 where they are level."""
    finite = np.isfinite(values)
    low = np.min(values, axis=axis, initial=np.inf, where=finite)
    high = np.max(values, axis=axis, initial=-np.inf, where=finite)
    return np.where(high - low > LEVEL * np.maximum(np.abs(low), np.abs(high)), high - low, 0.0)


def _pixels_in(pixels: float | FloatArray, extent: float | FloatArray) -> FloatArray:
    """Return pixels to a unit; 0 where nothing extends."""
    some = np.asarray(extent) > 0
    return np.where(some, pixels / np.where(some, extent, 1.0), 0.0)


def _over(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (r, K) as points (r, 2, K) over time."""
    return np.stack([np.broadcast_to(t, values.shape), values], axis=1)


def _refined(
    values: Rows,
    t: FloatArray,
    found: FloatArray,
    placed: Callable[[FloatArray, FloatArray], FloatArray],
    scale: FloatArray,
    rounds: int = MOST_ROUNDS,
) -> tuple[FloatArray, FloatArray]:
    """Return times and values with intervals halved until every chord is within the tolerance of the curve.

    `placed` takes times (K,) and values (r, K) to points (p, 2, K), and `scale` (p, 2) those to pixels. What stands
    next to a chord that is too far off, or to a turn whose end is missed, is looked at again.
    """
    most = min(MOST, _MOST_VALUES // max(len(found), 1))
    least = _LEAST * abs(float(t[-1] - t[0])) if len(t) else 0.0
    looked_at = np.abs(np.diff(t)) > least
    for _ in range(rounds):
        if not looked_at.any() or len(t) + np.count_nonzero(looked_at) > most:
            break
        at = np.flatnonzero(looked_at)
        middle = t[at] + _SHARE * (t[at + 1] - t[at])
        new = values(middle)
        begin, end = placed(t[at], found[:, at]), placed(t[at + 1], found[:, at + 1])
        far = _distance(placed(middle, new), begin, end, scale) > TOLERANCE
        again = np.zeros(len(looked_at), dtype=bool)
        again[at] = far
        t, found = np.insert(t, at + 1, middle), np.insert(found, at + 1, new, axis=1)
        near = with_neighbours(np.repeat(again, 1 + looked_at))
        looked_at = (near | _beside_turns(t, placed(t, found) * scale[:, :, None])) & (np.abs(np.diff(t)) > least)
    return t, found


def _beside_turns(t: FloatArray, pixels: FloatArray) -> NDArray[np.bool_]:
    """Return which intervals of times (K,), (K - 1,), are beside a turn whose end is missed by more than the tolerance.

    A turn is a place where points (p, 2, K) go back, to the right or upwards, and its end is that of the parabola
    through three of them. The distance from a chord does not tell: where many oscillations share a column of pixels the
    curve is as good as upright, and lies on its chord, however far it goes on behind it.
    """
    beside = np.zeros(max(len(t) - 1, 0), dtype=bool)
    with np.errstate(all="ignore"):
        before, after = np.diff(t)[:-1], np.diff(t)[1:]
        slopes = np.diff(pixels) / np.diff(t)
        first, second = slopes[:, :, :-1], slopes[:, :, 1:]
        middle = (first * after + second * before) / (before + after)
        behind = np.abs(middle**2 * (before + after) / (4 * (second - first)))
        missed = np.any((first * second <= 0) & (behind > TOLERANCE), axis=(0, 1))
    beside[:-1] |= missed
    beside[1:] |= missed
    return beside


def with_neighbours(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return flags (K,) that are set at the neighbours of those that are set too."""
    wider = flags.copy()
    wider[1:] |= flags[:-1]
    wider[:-1] |= flags[1:]
    return wider


def _distance(middle: FloatArray, begin: FloatArray, end: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the largest distance in pixels from points (p, 2, K) to chords between two others, (K,); not finite: 0."""
    with np.errstate(all="ignore"):
        chord, away = (end - begin) * scale[:, :, None], (middle - begin) * scale[:, :, None]
        square = np.sum(chord**2, axis=1)
        share = np.clip(np.sum(chord * away, axis=1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
        distance = np.hypot(*np.moveaxis(away - share[:, None] * chord, 1, 0))
    return np.asarray(np.max(np.where(np.isfinite(distance), distance, 0.0), axis=0, initial=0.0))


def thinned(t: FloatArray, row: FloatArray, pixels: Pixels) -> FloatArray:
    """Return values (N,) at times (N,) as a line (2, K), in each column first, last, smallest and largest.

    It covers the same pixels as the line through all of them: U. Jugel et al., M4: a visualization-oriented time
    series data aggregation, VLDB Endowment 7 (2014) 797.
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
    places = np.unique(np.concatenate(kept))
    return np.stack([t[places], row[places]])
