"""The animation as one HTML page with a player: no network, no library, drawn by the browser at its resolution.

A player that draws from numbers takes a hundredth of the space of pictures of every frame. It is sharp on every screen
and printer, and can show any frame at once.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.show.animation.canvas import (
    CLEAR,
    CURVE,
    FADES,
    FAINT,
    MARK,
    ROD,
    SHADOW,
    SPRING_WIDTH,
    THIN,
    TRAIL,
    WIRE,
    Pixels,
)
from lagrange.show.animation.sheet import FIXED, Sheet, Words, palette
from lagrange.show.figures.space import spring
from lagrange.show.figures.style import DARK, LIGHT, Style
from lagrange.show.files.template import as_json, filled
from lagrange.statement.statement import SPRING

CONTROLS = 46
"""Height in pixels of the controls under the picture."""

_HERE = Path(__file__).parent
_LARGEST = 32767


def page(sheet: Sheet, *, style: str, interval: float, title: str, notes: Sequence[str] = ()) -> str:
    """Return the page; `style` is light, dark, or auto, which follows the setting of the browser."""
    template = (_HERE / "player.html").read_text("utf-8")
    light, dark = (DARK, DARK) if style == "dark" else (LIGHT, LIGHT if style == "light" else DARK)
    darkened = f"@media (prefers-color-scheme: dark) {{ :root {{ {_colours(dark)} color-scheme: dark; }} }}"
    label = f"Animation of {title}, {sheet.clock_text(sheet.span[0])} to {sheet.clock_text(sheet.span[1])[4:]}"
    parts = {
        "TITLE": html.escape(title),
        "LABEL": html.escape(label),
        "LIGHT": _colours(light),
        "DARK": darkened if style == "auto" else "",
        "WIDTH": str(sheet.size[0]),
        "HEIGHT": str(sheet.size[1]),
        "NOTES": "".join(f"<p class='notes'>{html.escape(note)}</p>" for note in notes),
        "SHEET": as_json(_data(sheet, style, interval)),
        "SCRIPT": (_HERE / "player.js").read_text("utf-8").rstrip(),
    }
    return filled(template, parts)


def frame(text: str, sheet: Sheet, notes: Sequence[str] = ()) -> str:
    """Return the page inside an iframe for a notebook, so that neither affects the other."""
    height = sheet.size[1] + CONTROLS + 34 * len(notes)
    style = f"width:100%;max-width:{sheet.size[0]}px;height:{height}px;border:0;display:block"
    inside = text.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe title="animation" sandbox="allow-scripts" style="{style}" srcdoc="{inside}"></iframe>'


def still(pixels: Pixels, title: str) -> str:
    """Return a still picture as HTML, in place of a player."""
    data = base64.b64encode(png(pixels)).decode()
    return f'<img alt="{html.escape(title)}" src="data:image/png;base64,{data}">'


def png(pixels: Pixels) -> bytes:
    """Return pixels as a PNG."""
    from PIL.Image import fromarray

    file = io.BytesIO()
    fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def _colours(style: Style) -> str:
    return f"--paper: {style.paper}; --ink: {style.ink}; --quiet: {style.quiet}; --accent: {style.colours[0]};"


def _data(sheet: Sheet, style: str, interval: float) -> dict[str, Any]:
    count = len(sheet.tracks)
    rows = [*sheet.tracks.reshape(2 * count, sheet.samples), *(row for chart in sheet.charts for row in chart.rows)]
    numbers = np.array(rows).reshape(len(rows), sheet.samples)
    grain = max(float(np.abs(numbers).max(initial=0.0)), 1.0) / _LARGEST
    packed = np.rint(numbers / grain).astype("<i2").tobytes()
    unit = spring(np.zeros(2), np.array([1.0, 0.0]), 1.0)
    charts, begin = [], 2 * count
    for chart in sheet.charts:
        own = list(range(begin, begin + len(chart.rows)))
        begin += len(own)
        ends = {"first": round(chart.first, 2), "last": round(chart.last, 2)}
        charts.append({"rows": own, "colours": chart.colours, "box": [round(x, 2) for x in chart.box], **ends})
    widths = {
        "spring": SPRING_WIDTH,
        "rod": ROD,
        "trail": TRAIL,
        "mark": MARK,
        "shadow": SHADOW,
        "wire": WIRE,
        "thin": THIN,
        "curve": CURVE,
    }
    return {
        "style": style,
        "palettes": {one.name: palette(one, sheet.lines) for one in (LIGHT, DARK)},
        "size": sheet.size,
        "unit": sheet.unit,
        "detail": sheet.detail,
        "frames": sheet.frames,
        "interval": interval,
        "span": sheet.span,
        "decimals": sheet.decimals,
        "timeUnit": sheet.time_unit,
        "fades": FADES,
        "faint": FAINT,
        "newest": CLEAR,
        "widths": widths,
        "spring": [round(float(x), 4) for x in unit.T.ravel()],
        "strokes": [
            [[round(float(x), 2) for x in line.points.T.ravel()], line.colour, round(line.width, 2), line.opacity]
            for line in sheet.strokes
        ],
        "words": [_words(words) for words in sheet.words],
        "clock": _words(sheet.clock),
        "marks": [[mark.track, mark.colour, mark.kind == FIXED] for mark in sheet.marks],
        "joints": [[joint.start, joint.end, joint.kind == SPRING] for joint in sheet.joints],
        "trails": sheet.trails,
        "shadows": sheet.shadows,
        "tail": sheet.tail,
        "charts": charts,
        "grain": grain,
        "numbers": base64.b64encode(packed).decode(),
    }


def _words(words: Words) -> list[Any]:
    x, y, size = round(words.x, 2), round(words.y, 2), round(words.size, 2)
    return [words.text, x, y, size, words.anchor, words.colour, words.bold]
