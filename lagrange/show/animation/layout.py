"""Layout of the picture: the header, the scene of named points, the panels over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, log10
from typing import Any

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.show.animation.charts import (
    Area,
    Drawn,
    Panel,
    coordinate_panels,
    drawn,
    energy_panel,
    legend,
    legend_width,
)
from lagrange.show.animation.motion import Motion
from lagrange.show.animation.scene import Placed, Scene, height_for, scene_of
from lagrange.show.animation.sheet import FIRST, QUIET, Sheet, Words
from lagrange.show.animation.timing import Timing
from lagrange.show.notation.names import plain_text
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.number import real_number, whole_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

WIDTH, TALLEST = 640, 400
"""Default width of a picture, and greatest default height of its scene, in pixels."""

LEAST_SIZE, MOST_SIZE = 160, 2160
"""Least and largest side on request, in pixels: below, nothing is readable; above, a frame takes over 18 MB."""

SMALLEST = 0.85
"""Least scale factor of all sizes: letters below 8.5 pixels are hard to read."""

TAIL = 2.5
"""Default duration of a trail, in seconds on the screen."""

_CHART, _LABELS = 84.0, 30.0
"""Heights in pixels of a panel over time, and of the labels under the last one."""


_TALL, _LEAST = 1.7, 60.0
"""Ratio of height to width from which on a scene is beside the panels, and the least height of a scene."""


@dataclass(frozen=True)
class Plan:
    """The size of the picture, and the areas of the scene and of the panels over time."""

    size: tuple[int, int]
    scene: Area
    charts: Area


@dataclass(frozen=True)
class FrameOptions:
    """Requested size in pixels, None for one that fits the motion, and requested duration of trails."""

    size: tuple[int, int] | None
    trail: float | None


def frame_options(size: Any, trail: Any) -> FrameOptions:
    """Return the requested options. Raises StatementError for invalid ones."""
    if size is not None:
        if not isinstance(size, (tuple, list)) or len(size) != 2:
            raise StatementError(f"size = {shown(size)}: give width and height in pixels, such as size=(640, 480).")
        width, height = (whole_number(side, "a side of size", LEAST_SIZE, MOST_SIZE) for side in size)
        size = width, height
    if trail is not None and (trail := real_number(trail, "trail")) < 0:
        raise StatementError(f"trail = {trail:g}: give the time that trails go back, or 0 for none.")
    return FrameOptions(size, trail)


def sheet_of(statement: Statement, motion: Motion, timing: Timing, wanted: FrameOptions) -> Sheet:
    """Return the whole animation in pixels, with as many samples between frames as are visible."""
    scene = scene_of(motion.points, statement) if motion.points else None
    panels = _panels(statement, motion, scene)
    plan = _plan(scene, len(panels), wanted.size)
    placed = scene.placed(plan.scene, statement) if scene is not None else Placed.empty(len(motion.t))
    charts = _stacked(panels, motion.t, statement, plan.charts) if panels else []
    step = abs(float(motion.t[-1] - motion.t[0])) / max(1, len(motion.t) - 1)
    trail = TAIL * timing.speed if wanted.trail is None else wanted.trail
    time_unit = unit_of(statement, "t")
    u = plan.scene.unit
    whole = Sheet(
        size=plan.size,
        unit=u,
        detail=motion.detail,
        strokes=(*placed.strokes, *(line for chart in charts for line in chart.strokes)),
        words=(
            *_header(statement, timing, scene, plan),
            *placed.words,
            *(text for chart in charts for text in chart.words),
        ),
        clock=Words("", plan.size[0] - 14 * u, 22 * u, 13 * u, "end"),
        span=(float(motion.t[0]), float(motion.t[-1])),
        decimals=min(12, max(0, ceil(-log10(step * motion.detail)))) if step > 0 else 3,
        time_unit=f" {time_unit}" if time_unit else "",
        tracks=placed.tracks,
        marks=placed.marks,
        joints=placed.joints,
        trails=placed.trails if trail else (),
        shadows=placed.shadows,
        tail=round(min(trail / step, len(motion.t))) if step > 0 else 0,
        charts=tuple(chart.chart for chart in charts),
        lines=_lines(placed, panels),
    )
    return thinned(whole)


def _lines(placed: Placed, panels: list[Panel]) -> int:
    """Return the number of colours that distinguish lines."""
    own = [mark.colour for mark in placed.marks] + [colour for panel in panels for colour in panel.colours]
    return max(FIRST, *(colour + 1 for colour in own)) - FIRST


def _panels(statement: Statement, motion: Motion, scene: Scene | None) -> list[Panel]:
    """Return the panels over time: the energies, and the coordinates if no points are named."""
    energy = energy_panel(motion)
    own = [] if scene is not None else coordinate_panels(statement, motion)
    return own if energy is None else [*own, energy]


def _plan(scene: Scene | None, count: int, size: tuple[int, int] | None) -> Plan:
    """Return the areas of the scene and of `count` panels: on top of each other, or side by side for a tall scene."""
    width = size[0] if size else WIDTH
    u = max(SMALLEST, width / WIDTH)
    top = (56 if scene is not None and len(scene.moving) > 1 else 44) * u
    strip = (count * _CHART + _LABELS) * u if count else 8 * u
    beside = scene is not None and count > 0 and scene.ratio > _TALL
    below = 8 * u if beside else strip
    natural = 0.0 if scene is None else min(TALLEST * u, height_for(scene, width, u))
    height = size[1] if size else ceil((top + natural + below) / 2) * 2
    free = height - top - below if scene is not None else 0.0
    if height < top + below + (_LEAST * u if scene is not None else 0.0):
        least = ceil(top + below + _LEAST * u)
        raise StatementError(
            f"size = ({width}, {height}) leaves no room for the motion: give a height of {least} or more."
        )
    across = width if scene is None or not beside else max(0.34 * width, min(0.6 * width, free / scene.ratio))
    first = Area(0.0, top, across, free, u)
    if beside:
        return Plan((width, height), first, Area(across, top, width - across, height - top, u))
    return Plan((width, height), first, Area(0.0, top + free, width, height - top - free, u))


def _header(statement: Statement, timing: Timing, scene: Scene | None, plan: Plan) -> list[Words]:
    """Return the name, the speed if it is not real time, and the names of the moving points."""
    width, u = plan.size[0], plan.scene.unit
    words = [Words(plain_text(statement.name), 14 * u, 22 * u, 13 * u, bold=True)]
    if timing.speed != 1.0:
        words.append(Words(f"speed {timing.speed:g}×", width - 14 * u, 38 * u, 10 * u, "end", QUIET))
    if scene is None:
        words.append(Words("coordinates; no positions are stated", 14 * u, 37 * u, 10 * u, colour=QUIET))
    elif len(scene.moving) > 1 and legend_width(scene.names, u) < 0.85 * width:
        words += legend(scene.names, tuple(range(FIRST, FIRST + len(scene.names))), 14 * u, 42 * u, u)
    return words


def _stacked(panels: list[Panel], t: FloatArray, statement: Statement, area: Area) -> list[Drawn]:
    label = with_unit("t", unit_of(statement, "t"))
    each = (area.height - _LABELS * area.unit) / len(panels)
    found = []
    for k, panel in enumerate(panels):
        last = k == len(panels) - 1
        own = replace(area, top=area.top + k * each, height=each + (_LABELS * area.unit if last else 0.0))
        found.append(drawn(panel, t, own, time_label=label if last else ""))
    return found


def thinned(sheet: Sheet) -> Sheet:
    """Return the sheet with the fewest samples between its frames that keep every curve exact within half a pixel."""
    curves = [sheet.tracks[track] for track, _ in sheet.trails] + [chart.rows for chart in sheet.charts]
    detail = 1
    while detail < sheet.detail and any(_deviation(rows, sheet.detail // detail) > 0.5 for rows in curves):
        detail *= 2
    if detail == sheet.detail:
        return sheet
    kept = slice(None, None, sheet.detail // detail)
    charts = tuple(replace(chart, rows=chart.rows[:, kept]) for chart in sheet.charts)
    tail = ceil(sheet.tail * detail / sheet.detail)
    return replace(sheet, detail=detail, tracks=sheet.tracks[:, :, kept], charts=charts, tail=tail)


def _deviation(rows: FloatArray, factor: int) -> float:
    """Return the largest distance of rows from straight lines between every `factor`-th of their samples."""
    coarse = rows[:, ::factor]
    share = np.arange(factor) / factor
    lines = coarse[:, :-1, None] * (1 - share) + coarse[:, 1:, None] * share
    return float(np.abs(rows[:, :-1].reshape(lines.shape) - lines).max(initial=0.0))
