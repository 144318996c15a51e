"""Polylines that differ from a curve by less than a pixel: what every figure and animation draws of dense output.

A curve is a function of times, which is called for as many times as its picture needs. Steps are no help for that: one
Taylor step can hold whole swings, and a thousand steps can share a column of pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.show.between import known_alone
from lagrange.trajectory.paths.samples import divided
from lagrange.trajectory.trajectory import FloatArray, Trajectory

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
