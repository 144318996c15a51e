"""Paths of named points on paper: where they went, within a pixel, and how much of it is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lagrange.show.figures.blow_up import Window, clipped, cut, notes_of, row_of, window_of
from lagrange.show.figures.curve import Pixels, first_times, in_plane, lengths, outputs_alone
from lagrange.show.figures.space_view import View, view_of
from lagrange.statement.link import Link
from lagrange.trajectory.measures.points import fixed_points, points_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

SLENDER = 12
"""Paths that are so many times as long as they are wide are not drawn to scale: they would be a narrow strip."""

_LONGEST = 80.0
"""Sides of a panel that a line goes at most: three times as many would cover half of it."""

_DENSITY = 300_000
"""States of the density that is drawn of what was before."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of points on paper (p, 2, K) at times (K,), how they are seen, and the links between them.

    `space` are the same points as stated, (p, 2, K) or (p, 3, K), and `starts` where they began, (p, 2). `fixed` points
    are those that do not depend on coordinates or time. Of a long run the paths are the last part, and `before` are
    points (2, k) of the part before it.
    """

    times: FloatArray
    points: FloatArray
    space: FloatArray
    starts: FloatArray
    before: FloatArray
    names: tuple[str, ...]
    fixed: tuple[bool, ...]
    view: View
    links: tuple[Link, ...]
    note: str
    """What is said of points that leave the panel."""

    def of(self, name: str) -> FloatArray:
        """Return the path of a point, (2, K)."""
        return np.asarray(self.points[self.names.index(name)])

    def from_origin(self, origin: FloatArray) -> Paths:
        """Return the same paths, counted from another origin: (2,) on paper, or (3,) in space seen from a side."""
        space = self.space - origin[:, None] if self.view.spatial else self.space
        place = self.view.of(origin[:, None]) if self.view.spatial else origin[:, None]
        points, starts, before = self.points - place, self.starts - place[:, 0], self.before - place
        return replace(self, points=points, space=space, starts=starts, before=before)

    @cached_property
    def on_paper(self) -> FloatArray:
        """All places where points are, (2, N)."""
        return np.concatenate([*self.points, self.starts.T, self.before], axis=1)

    @cached_property
    def extents(self) -> FloatArray:
        """How far all paths extend to the right and up, (2,)."""
        low, high = limits(self.on_paper)
        return high - low

    @property
    def to_scale(self) -> bool:
        """Whether lengths are equal in both directions, which would make some paths a narrow strip."""
        low, high = sorted(self.extents.tolist())
        return bool(low > high / SLENDER or low <= 1e-9 * high)


def limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest of the finite points (d, K), (d,) each."""
    good = points[:, np.isfinite(points).all(axis=0)]
    return (good.min(axis=1), good.max(axis=1)) if good.shape[1] else (np.zeros(len(points)), np.zeros(len(points)))


def named_points(solution: Solution, t: FloatArray) -> dict[str, FloatArray]:
    """Return where the named points are at times (K,), (2, K) or (3, K) each; empty where none was stated."""
    return points_at(solution.model, t, solution.at(t), solution.parameters_at(t))


def common_view(solutions: tuple[Solution, ...]) -> View | None:
    """Return the view in which the paths of some runs are seen together; None where no point was stated."""
    runs = [placed_points(run, first_times(run.trajectory), _windows(run)) for run in solutions]
    found = {f"{name} {k}": points for k, run in enumerate(runs) for name, points in run.items()}
    return view_of(found) if found else None


def paths_of(solution: Solution, view: View, pixels: Pixels) -> Paths:
    """Return the paths of the named points of a run within a pixel, in a panel of some size.

    Of a run that goes on for longer than a line can show, the last part.
    """
    names = tuple(named_points(solution, solution.t[:1]))
    windows = _windows(solution)

    def placed(t: FloatArray) -> list[FloatArray]:
        return [*placed_points(solution, t, windows).values()]

    def seen(t: FloatArray) -> FloatArray:
        return np.array([view.of(point) for point in placed(t)])

    def seen_with_shadows(t: FloatArray) -> FloatArray:
        points = placed(t)
        flat = [point[:2] for point in points] if view.spatial else []
        return np.array([view.of(point) for point in [*points, *flat]])

    first = first_times(solution.trajectory)
    drawn, before = first, np.empty((2, 0))
    if not outputs_alone(solution.trajectory):
        drawn = _last_part(first, seen(first))
        if drawn[0] != first[0]:
            before = np.concatenate([*_moving(solution, seen(np.linspace(first[0], drawn[0], _DENSITY)))], axis=1)
        drawn = in_plane(seen_with_shadows, drawn, pixels, equal=False)[0]
    space = np.array([cut(windows, point) for point in placed(drawn)])
    fixed = fixed_points(solution.model.statement)
    return Paths(
        drawn,
        np.array([view.of(point) for point in space]),
        space,
        seen(solution.t[:1])[:, :, 0],
        before,
        names,
        tuple(fixed[name] for name in names),
        view,
        solution.model.statement.links,
        notes_of(windows),
    )


def placed_points(solution: Solution, t: FloatArray, windows: Sequence[Window | None]) -> dict[str, FloatArray]:
    """Return where the named points are, at the bounds of a panel where they are beyond these."""
    return {name: clipped(windows, point) for name, point in named_points(solution, t).items()}


def _windows(solution: Solution) -> list[Window | None]:
    """Return what is shown in each direction of a run whose points leave the panel; empty where no point was stated."""
    dimension = max(map(len, named_points(solution, solution.t[:1]).values()), default=0)

    def entries(t: FloatArray) -> FloatArray:
        return np.stack([*named_points(solution, t).values()], axis=1)

    return [window_of(solution, row_of(entries, k)) for k in range(dimension)]


def _moving(solution: Solution, points: FloatArray) -> list[FloatArray]:
    """Return of the points (p, 2, K), those that are not fixed."""
    fixed: Mapping[str, bool] = fixed_points(solution.model.statement)
    names = named_points(solution, solution.t[:1])
    return [point for name, point in zip(names, points, strict=True) if not fixed[name]]


def _last_part(t: FloatArray, points: FloatArray) -> FloatArray:
    """Return the last of the times, in which no point (p, 2, K) goes further than a line can show."""
    low, high = limits(np.concatenate([*points], axis=1))
    gone, size = lengths(points), float(np.max(high - low))
    if size <= 0 or gone[-1] <= _LONGEST * size:
        return t
    return t[np.searchsorted(gone, gone[-1] - _LONGEST * size) :]
