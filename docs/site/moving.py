"""Moving pictures: a run as an SVG of some tens of kilobytes that a browser plays without a script.

Points, rods and springs are given at equally spaced times, between which the browser interpolates. The trail of a point
is a short piece of its path. With the setting for reduced motion the last state and the whole path are shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.show.figures.paths import spring, view_of
from lagrange.show.figures.style import COLOURS, DARK_COLOURS, colours
from lagrange.statement.statement import SPRING, Link
from lagrange.trajectory.measures.times_and_points import points_at
from lagrange.trajectory.solution import Solution

Points = NDArray[np.float64]
"""Places in the picture, (2, N): right and down, in its units."""

WIDTH, HEIGHT, MARGIN = 480.0, 300.0, 22.0
RATE = 25
"""Places a second; between them the browser goes in straight lines, within a unit of the path."""
FINER = 3
"""Points of a trail for each position of its point."""
SHORTEST, LONGEST = 5.0, 14.0
"""Seconds that a picture lasts. In between a second of the run is one of the clock."""
COIL = 14.0
"""The width of a spring."""
TRAIL = 0.9
"""Duration of a trail, in seconds."""

STYLE = """\
.rod{fill:none;stroke:#7b8794;stroke-width:2.5;stroke-linecap:round;stroke-linejoin:round}
.base{fill:#7b8794}
.path,.trail{fill:none}
.path{stroke-width:1;opacity:.2}
.trail{stroke-width:2.5;stroke-linecap:round;stroke-linejoin:round;opacity:.7}
.still{display:none}
@media (prefers-reduced-motion:reduce){.moving{display:none}.still{display:inline}}
"""


@dataclass(frozen=True)
class Clip:
    """The drawn data: positions of each point and of its finer path, the links, and the duration in seconds."""

    points: dict[str, Points]
    paths: dict[str, Points]
    links: Sequence[Link]
    seconds: float


def clip(solution: Solution) -> Clip:
    """Return the positions of all parts in the picture of a run."""
    first, last = float(solution.t[0]), float(solution.t[-1])
    seconds = float(np.clip(last - first, SHORTEST, LONGEST))
    count = round(seconds * RATE)
    times = np.linspace(first, last, count * FINER + 1)
    named = points_at(solution.model, times, solution.at(times), solution.parameters)
    if not named:
        raise ValueError(f"{solution.model.statement.name} has no positions to draw")
    view = view_of(named)
    seen = {name: view.of(point) for name, point in named.items()}
    everything = np.concatenate(list(seen.values()), axis=1)
    low, high = everything.min(axis=1), everything.max(axis=1)
    extent = np.maximum(high - low, 1e-9 * float(np.max(high - low)))
    scale = float(min((WIDTH - 2 * MARGIN) / extent[0], (HEIGHT - 2 * MARGIN) / extent[1]))
    middle = (low + high) / 2

    def placed(point: Points) -> Points:
        right, up = (point - middle[:, None]) * scale
        return np.array([WIDTH / 2 + right, HEIGHT / 2 - up])

    paths = {name: placed(point) for name, point in seen.items()}
    points = {name: path[:, ::FINER] for name, path in paths.items()}
    return Clip(points, paths, solution.model.statement.links, seconds)


def svg(solution: Solution) -> str:
    """Return the picture of a run as the text of an SVG file."""
    drawing = clip(solution)
    moving = [name for name, point in drawing.points.items() if np.ptp(point, axis=1).max() > 0.5]
    light, dark = (
        "".join(f".c{k}{{fill:{tone};stroke:{tone}}}" for k, tone in enumerate(colours(len(moving), few)))
        for few in (COLOURS, DARK_COLOURS)
    )
    style = f"{light}\n@media (prefers-color-scheme:dark){{{dark}}}\n{STYLE}"  # the last rule of a kind holds
    body = [trails(drawing, moving), links(drawing), bobs(drawing, moving)]
    title = solution.model.statement.name.replace("&", "&amp;").replace("<", "&lt;")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" '
        f'width="{WIDTH:g}" height="{HEIGHT:g}" role="img">\n<title>{title}</title>\n<style>{style}</style>\n'
        f"{''.join(body)}</svg>\n"
    )


def number(value: float) -> str:
    """Return a coordinate, rounded to a tenth of a unit, as a short text."""
    text = f"{value:.1f}"
    return text.removesuffix(".0") if text != "-0.0" else "0"


def position(point: Points, k: int) -> str:
    """Return the position with index k."""
    return f"{number(point[0, k])} {number(point[1, k])}"


def animated(attribute: str, values: Sequence[str], seconds: float) -> str:
    """Return the element that moves an attribute through values, over and over."""
    listed = ";".join(values)
    return f'<animate attributeName="{attribute}" values="{listed}" dur="{seconds:g}s" repeatCount="indefinite"/>'


def links(drawing: Clip) -> str:
    """Return the rods as one path, and each spring as a shape that is moved, turned and stretched."""
    springs = [elastic(drawing, link) for link in drawing.links if link.kind == SPRING]
    rods = [link for link in drawing.links if link.kind != SPRING]
    if not rods:
        return "".join(springs)
    count = next(iter(drawing.points.values())).shape[1]
    shapes = [
        "".join(f"M{position(drawing.points[rod.start], k)}L{position(drawing.points[rod.end], k)}" for rod in rods)
        for k in range(count)
    ]
    moving = f'<path class="rod moving" d="{shapes[0]}">{animated("d", shapes, drawing.seconds)}</path>\n'
    return "".join([moving, f'<path class="rod still" d="{shapes[-1]}"/>\n', *springs])


def elastic(drawing: Clip, link: Link) -> str:
    """Return a spring: a zigzag of unit length along the first axis, with its transformation at each time."""
    start, end = drawing.points[link.start], drawing.points[link.end]
    right, down = end - start
    angles = np.degrees(np.unwrap(np.arctan2(down, right)))
    moves = [
        ("translate", [position(start, k) for k in range(start.shape[1])]),
        ("rotate", [f"{angle:.1f}" for angle in angles]),
        ("scale", [f"{length:.1f} 1" for length in np.hypot(right, down)]),
    ]
    coil = spring(np.zeros(2), np.array([1.0, 0.0]), COIL)
    zigzag = "M" + "L".join(f"{x:.4g} {y:g}" for x, y in coil.T)
    shape = f'<path class="rod" vector-effect="non-scaling-stroke" d="{zigzag}"/>'
    moving = still = shape
    for kind, values in reversed(moves):
        still = f'<g transform="{kind}({values[-1]})">{still}</g>'
        moving = f"<g>{transformed(kind, values, drawing.seconds)}{moving}</g>"
    return f'<g class="moving">{moving}</g>\n<g class="still">{still}</g>\n'


def transformed(kind: str, values: Sequence[str], seconds: float) -> str:
    """Return the element that moves a group. A constant attribute has one value."""
    listed = ";".join(values if len(set(values)) > 1 else values[:1])
    timing = f'dur="{seconds:g}s" repeatCount="indefinite"'
    return f'<animateTransform attributeName="transform" type="{kind}" values="{listed}" {timing}/>'


def trails(drawing: Clip, moving: Sequence[str]) -> str:
    """Return the paths of points: a moving piece of each, and the whole path for reduced motion."""
    parts = []
    for k, name in enumerate(moving):
        path = drawing.paths[name]
        whole = "M" + "L".join(position(path, i) for i in range(path.shape[1]))
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(np.round(path, 1), axis=1)))])[::FINER]
        start_index = np.maximum(np.arange(len(lengths)) - round(TRAIL * RATE), 0)
        shown = lengths - lengths[start_index]
        dashes = [f"{number(piece)} {number(lengths[-1] + 9)}" for piece in shown]
        offsets = [number(-start) for start in lengths[start_index]]
        motion = animated("stroke-dasharray", dashes, drawing.seconds) + animated(
            "stroke-dashoffset", offsets, drawing.seconds
        )
        parts.append(f'<path class="c{k} path" d="{whole}"/>\n')
        parts.append(f'<path class="c{k} trail moving" d="{whole}">{motion}</path>\n')
    return "".join(parts)


def bobs(drawing: Clip, moving: Sequence[str]) -> str:
    """Return points: those that move as discs, the others as small squares."""
    parts = []
    for name, point in drawing.points.items():
        if name not in moving:
            right, down = point[:, 0]
            parts.append(
                f'<rect class="base" x="{number(right - 3)}" y="{number(down - 3)}" width="6" height="6" rx="1"/>\n'
            )
    for k, name in enumerate(moving):
        point = drawing.points[name]
        right = animated("cx", [number(value) for value in point[0]], drawing.seconds)
        down = animated("cy", [number(value) for value in point[1]], drawing.seconds)
        parts.append(f'<circle class="c{k} moving" r="7">{right}{down}</circle>\n')
        parts.append(f'<circle class="c{k} still" r="7" cx="{number(point[0, -1])}" cy="{number(point[1, -1])}"/>\n')
    return "".join(parts)
