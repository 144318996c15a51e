"""Animate a run: `solution.animate`, the HTML page with a player, and files in HTML, GIF, MP4 or PNG."""

from __future__ import annotations

import base64
import io
import os
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from lagrange.errors import StatementError, counted
from lagrange.page.document import (
    ENERGIES,
    PICTURES,
    RECORDED,
    as_json,
    colour_rules,
    description,
    hint,
    html,
    in_frame,
    joined,
    legend,
    phase_choices,
    short,
    template,
)
from lagrange.show.animation import DEFAULT_FPS, named_kind
from lagrange.show.animation.film import Film, Pixels, checked_options
from lagrange.show.animation.gif import has_ffmpeg, write_gif, write_mp4
from lagrange.show.animation.recording import Recording, Timing, recording_of, thinned, timing
from lagrange.show.figures.style import DARK, LIGHT
from lagrange.show.files.atomic_file import check_place, write_atomically
from lagrange.show.interpolated_states import known_alone
from lagrange.show.notation.text import plain_text
from lagrange.statement.display import progress_bar
from lagrange.statement.expression import flag, one_of, whole_number
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

BESIDES = 250
"""Height in pixels of a player without its moving picture: the name, the controls and the plots together."""

LEVELS = 2**13
"""Number of quantization levels between the least and the largest value of a recorded curve: one level is about an
eighth of a pixel."""

MOST_COORDINATES = 20
"""Largest number of coordinates that are recorded in addition to named points. More would double the page's size."""


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
    # Durations of trails by name, in seconds on the screen.
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
        "packed": " ".join(
            base64.b64encode(zlib.compress(part, 9)).decode()
            for part in (rules.encode(), scripts.encode(), packed(rows))
        ),
    }
    return html("player.html", parts, {"loader": short(template("loader.js"))}, scripts, trusted=False)


def _rows(record: Recording) -> list[FloatArray]:
    """Return the curves of the recording `record`, S samples each, in the order in which the page's scripts read them.

    The order is: coordinates of all points, entries of the state, those of the energies E, T and V that are recorded,
    and the relative change of E if E is recorded.
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
    """Return two numbers for the storage of a recorded curve `row` (S,): its least value, and the quantization step.

    Values are stored as multiples of this step above the least value.
    """
    low, high = float(row.min()), float(row.max())
    return low, float(f"{(high - low) / LEVELS:.6e}")


def packed(rows: Sequence[FloatArray]) -> bytes:
    """Return recorded curves of equal length as bytes that compress well, for the script that reads them on the page.

    The values of each curve in `rows` are rounded to whole multiples of a quantization step, and differenced twice.
    Each second difference has 16 bits. All low bytes come before all high bytes.
    """
    whole = np.zeros((len(rows), len(rows[0])), dtype=np.int64)
    for k, row in enumerate(rows):
        base, grain = _scale(row)
        whole[k] = np.rint((row - base) / grain) if grain > 0 else 0
    for _ in range(2):
        whole = np.diff(whole, axis=1, prepend=0)
    words = (whole & 0xFFFF).astype("<u2")
    return bytes((words & 0xFF).astype(np.uint8).tobytes() + (words >> 8).astype(np.uint8).tobytes())


LARGEST_SHOWN = 300_000
"""Longest player that a notebook stores, in characters. The notebook shows the first frame instead of a longer one."""

STYLES = ("auto", "light", "dark")


@dataclass(frozen=True, eq=False, repr=False)
class Animation:
    """Frames of a run of the system `name` at the times `t`, (K,), with `states` (2n, K) and named `points`.

    A point is (2, K) or (3, K). `recording` has the data between the frames, too, and `film` draws the frames. `style`
    is "auto", "light" or "dark". `notes` report settings that differ from the requested ones; `path` is the file that
    was written, or None.
    """

    name: str
    recording: Recording
    film: Film
    style: str = "auto"
    notes: tuple[str, ...] = ()
    path: Path | None = field(default=None)

    @property
    def timing(self) -> Timing:
        """Times of the frames, and the speed at which they are shown."""
        return self.film.timing

    @property
    def states(self) -> FloatArray:
        """States at the frames, (2n, K)."""
        return self.recording.states[:, self.recording.frames]

    @property
    def points(self) -> dict[str, FloatArray]:
        """Named points at the frames, (2, K) or (3, K) each."""
        return {name: point[:, self.recording.frames] for name, point in self.recording.points.items()}

    @property
    def t(self) -> FloatArray:
        """Times of the frames, (K,)."""
        return self.timing.t

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height in pixels that the player needs on a page."""
        width, height = self.film.size
        share = 0.7 if self.film.scene is None else self.film.plan.scene[3]  # Height of the picture / that of the frame
        return max(width, 480), round(share * height) + BESIDES

    def frame(self, number: int) -> Pixels:
        """Return a frame by its number as pixels, (height, width, 4): red, green, blue and 255."""
        return self.film.frame(whole_number(number, "the number of the frame", 0, len(self.t) - 1)).copy()

    def to_html(self) -> str:
        """Return one HTML page with the player. It needs no network and no installation."""
        return player_page(self.recording, self.film, self.style, self.notes)

    def save(self, path: str | os.PathLike[str], *, progress: bool = False) -> Animation:
        """Write a file whose suffix chooses its kind: .html, .gif, .mp4, or .png for the first frame.

        The file is written whole or not at all. Returns the animation with the path. If ffmpeg is not installed, an
        HTML file is written instead of an MP4 file, under the same name with .html, and a warning reports this.
        `progress` shows the part of the frames that is drawn. Raises StatementError for a path that cannot be written,
        RunError if the disk is full.
        """
        flag(progress, "progress")
        target, notes = _writable(path)
        span = float(self.t[0]), float(self.t[-1])
        with progress_bar(span, enabled=progress) as update:

            def tell(number: int) -> None:
                if update is not None:
                    update(float(self.t[number]))

            tell(0)
            written = write_atomically(target, partial(self._write, target.suffix.lower(), tell))
        for note in notes:
            warnings.warn(note, stacklevel=3)
        return replace(self, path=written, notes=(*self.notes, *notes))

    def _write(self, suffix: str, tell: Callable[[int], None], file: BinaryIO) -> None:
        interval = self.timing.interval
        if suffix == ".html":
            file.write(self.to_html().encode())
        elif suffix == ".gif":
            write_gif(file, self.film, interval, tell)
        elif suffix == ".mp4":
            write_mp4(file, self.film, interval, tell)
        else:
            file.write(png(self.film.frame(0)))

    def _repr_html_(self) -> str:
        page = player_page(self.recording, self.film, self.style, ())
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        if len(page) <= LARGEST_SHOWN:
            return in_frame(page, "animation", *self.frame_size) + notes
        text = f"The player has {len(page) // 1000:,} kB, too much for a notebook: .save('{self.name}.html') writes it."
        data = base64.b64encode(png(self.frame(0))).decode()
        still = f'<img alt="{escape(self.name)}" src="data:image/png;base64,{data}">'
        return f"{still}<p>{escape(text)}</p>{notes}"

    def __repr__(self) -> str:
        timing = self.timing
        speed = "in real time" if timing.speed == 1 else f"at {timing.speed:g} times real time"
        lines = [
            f"animation of {self.name}: {counted(len(self.t), 'frame')}, {timing.seconds:.3g} s {speed}, "
            f"t = {self.t[0]:.6g} to {self.t[-1]:.6g}",
            *self.notes,
            *([f"written to {self.path}"] if self.path else []),
        ]
        return "\n".join(lines)


def animate(
    solution: Solution,
    path: str | os.PathLike[str] | None = None,
    *,
    fps: float | None = None,
    speed: float | None = None,
    size: Any = None,
    style: str = "auto",
    trail: float | None = None,
    progress: bool = False,
) -> Animation:
    """Return the animation of a run, and write it to `path` unless `path` is None.

    `fps` is the number of frames per second, and `speed` the time of the run per second on the screen. `size` is the
    width and height in pixels. `trail` is the duration of the trails behind moving points, in the time of the run. None
    means the default. `style` is "auto", "light" or "dark". With `progress` the part of the frames that is drawn is
    shown while the file is written. Raises StatementError for invalid arguments, and for a run without outputs.
    """
    one_of(style, STYLES, "style = {given}: give one of {known}.")
    options = checked_options(size, trail)
    if path is not None:
        _writable(path)
    if not len(solution.t):
        raise StatementError(
            "there is nothing to animate: the run ended before the first of its output times. Its message says why."
        )
    chosen = timing((float(solution.t[0]), float(solution.t[-1])), DEFAULT_FPS if fps is None else fps, speed)
    with np.errstate(all="ignore"):
        recording = recording_of(solution, chosen)
    film = Film(recording, chosen, DARK if style == "dark" else LIGHT, *options)
    missing = "No positions are stated: the coordinates are drawn over time. positions={...} states points to draw."
    notes = chosen.notes if recording.points else (missing, *chosen.notes)
    if known_alone(solution.trajectory) is not None:
        notes = ("The run is from a file: between the states that this has, the motion is interpolated.", *notes)
    animation = Animation(plain_text(recording.statement.name), recording, film, style, notes)
    return animation if path is None else animation.save(path, progress=progress)


def png(pixels: Pixels) -> bytes:
    """Return the content of a PNG file with the picture `pixels` (height, width, 4)."""
    from PIL.Image import fromarray

    file = io.BytesIO()
    fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def _writable(path: str | os.PathLike[str]) -> tuple[Path, tuple[str, ...]]:
    """Return the path to write, and the notes about it: one note if the path differs from the requested one, else none.

    Raises StatementError for an unknown suffix, and for a path that cannot be written.
    """
    requested = named_kind(path)
    check_place(requested)
    if requested.suffix.lower() != ".mp4" or has_ffmpeg():
        return requested, ()
    page = requested.with_suffix(".html")
    if page.exists():
        raise StatementError(
            f"{requested} needs the program ffmpeg, which is not installed. The page {page} would be written instead, "
            "but this file exists already: name a file that ends in .html or .gif."
        )
    return page, (
        f"ffmpeg is not installed, which {requested.name} needs: {page.name} is written instead, with a player.",
    )
