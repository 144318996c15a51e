"""The player of a recording: one HTML page with recorded numbers and the scripts of every page, without a model."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import replace
from html import escape

import numpy as np

from lagrange.page.document import (
    PICTURES,
    RECORDED,
    as_json,
    colour_rules,
    hint,
    html,
    joined,
    legend,
    phase_choices,
    short,
    template,
)
from lagrange.page.script_data import ENERGIES, description
from lagrange.show.animation.film import Film
from lagrange.show.animation.recording import Recording, thinned
from lagrange.show.notation.symbols import plain_text
from lagrange.trajectory.trajectory import FloatArray

BESIDES = 250
"""Height in pixels of everything in a player except the picture: the name, the controls and the plots."""

LEVELS = 2**13
"""Number of quantization levels between the least and the largest value of a row: steps of an eighth of a pixel."""

MOST_COORDINATES = 20
"""Largest number of coordinates that are recorded beside named points: more would double the size of the page."""


def player_page(recording: Recording, film: Film, style: str, notes: Sequence[str]) -> str:
    """Return the HTML page of a recording; `film` sets the size of the picture, and `notes` are sentences below it.

    `style` is "light", "dark", or "auto", which follows the setting of the browser.
    """
    statement = recording.statement
    record = thinned(recording)
    if record.points and len(statement.names) > MOST_COORDINATES:
        record = replace(record, states=record.states[:0])
    rows = _rows(record)
    order = [name for name in ENERGIES if name in record.energies]
    data = description(statement, film.timing.speed, order, record.energy_letter)
    data |= {
        "states": data["states"][: len(record.states)],
        "energySize": record.energy_size,
        "zero": record.zero,
        "kept": record.kept,
        "decimals": film.decimals,
        "record": {
            "count": len(record.t),
            "detail": record.detail,
            "fps": film.timing.fps,
            "begin": float(record.t[0]),
            "end": float(record.t[-1]),
            "jumps": record.jumps.tolist(),
            "rows": [_scale(row) for row in rows],
        },
    }
    scripts = short(joined(*PICTURES, *RECORDED))
    width = f":root{{--width:{max(film.size[0], 640)}px}}\n"
    rules = short(colour_rules(statement) + width + template("page.css") + template("player.css"))
    # Trails by their seconds on the screen.
    trails = {"no": 0.0, "short": film.trail_seconds or 2.5, "long": 10.0, "whole": 1e9}
    chosen = "short" if film.trail_seconds else "no"
    choices = [
        f'<option value="{value:g}"{" selected" if name == chosen else ""}>{name} trail</option>'
        for name, value in trails.items()
    ]
    parts = {
        "look": "" if style == "auto" else f' data-style="{style}"',
        "style": rules,
        "title": escape(plain_text(statement.name)),
        "hint": hint(statement),
        "legend": legend(statement),
        "choices": phase_choices(statement),
        "hidden": "" if len(record.states) else " hidden",
        "trails": "".join(choices),
        "notes": "".join(f'<p class="note">{escape(note)}</p>\n' for note in notes),
        "data": as_json(data),
        "packed": " ".join(map(_text, (rules.encode(), scripts.encode(), packed(rows)))),
    }
    return html("player.html", parts, {"loader": short(template("loader.js"))}, scripts, trusted=False)


def frame_size(film: Film) -> tuple[int, int]:
    """Return the width and height in pixels of the player's frame in a notebook."""
    width, height = film.size
    return max(width, 480), round(film.scene_share * height) + BESIDES


def in_frame(page: str, title: str, width: int, height: int) -> str:
    """Return a page inside an iframe for a notebook, so that neither affects the other."""
    style = f"width:100%;max-width:{width}px;height:{height}px;border:0;display:block"
    inside = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe title="{title}" sandbox="allow-scripts" style="{style}" srcdoc="{inside}"></iframe>'


def _rows(record: Recording) -> list[FloatArray]:
    """Return the recorded rows, (S,) each: coordinates of all points, the state, energies, and relative change of E.

    Energies are E, T and V, as far as they are recorded; without energies there is no change of E.
    """
    names = [*record.statement.drawn]
    dimension = max((len(record.points[name]) for name in names), default=0)
    zero = np.zeros(len(record.t))
    points = [[*record.points[name], zero][:dimension] for name in names]
    energies = [record.energies[name] - (name != "T") * record.zero for name in ENERGIES if name in record.energies]
    return [
        *(row for point in points for row in point),
        *record.states,
        *energies,
        *([record.change] if energies else []),
    ]


def _scale(row: FloatArray) -> tuple[float, float]:
    """Return the least value of a row, and the step of the grid to which its values are rounded."""
    low, high = float(row.min()), float(row.max())
    return low, float(f"{(high - low) / LEVELS:.6e}")


def packed(rows: Sequence[FloatArray]) -> bytes:
    """Return rows of numbers, rounded to whole steps, as bytes: second differences of 16 bits.

    All low bytes come before all high bytes.
    """
    whole = np.zeros((len(rows), len(rows[0])), dtype=np.int64)
    for k, row in enumerate(rows):
        base, grain = _scale(row)
        whole[k] = np.rint((row - base) / grain) if grain > 0 else 0
    for _ in range(2):
        whole = np.diff(whole, axis=1, prepend=0)
    words = (whole & 0xFFFF).astype("<u2")
    return bytes((words & 0xFF).astype(np.uint8).tobytes() + (words >> 8).astype(np.uint8).tobytes())


def _text(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()
