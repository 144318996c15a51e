"""The command `lagrange ensemble`: many runs of a scene, from a grid of starts and parameters."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from pathlib import Path
from typing import Any

import lagrange as lg
from lagrange.arguments import (
    DONE,
    FAILED,
    Answer,
    add_command,
    add_json,
    add_start,
    load_scene,
    number,
    start,
)
from lagrange.errors import StatementError
from lagrange.run_command import add_method, method
from lagrange.show.files.atomic_file import check_place


def add_ensemble(commands: Any) -> None:
    """Add the command to the command line."""
    command = add_command(commands, "ensemble", ensemble, "run a scene from many starts, or with many parameters")
    command.add_argument(
        "--vary",
        metavar="NAME=LOW:HIGH:COUNT",
        action="append",
        default=[],
        help="equally spaced values of a coordinate, a velocity or a parameter, such as theta=-3:3:1000; given twice, "
        "all combinations",
    )
    command.add_argument(
        "--keep",
        metavar="LIST",
        default="end",
        help="names with commas: end, counts, drift, or max:NAME, min:NAME, mean:NAME of a coordinate or a velocity "
        "(default: end)",
    )
    command.add_argument("--out", metavar="PATH", help="folder for the results, such as runs.zarr, or a picture, .png")
    command.add_argument("--workers", metavar="N", help="threads (default: one for each core)")
    add_start(command)
    add_method(command)
    add_json(command)


def ensemble(request: argparse.Namespace) -> Answer:
    """Run a scene many times, and say how the runs ended."""
    system, begun, how = load_scene(request.scene), start(request), method(request)
    if not request.vary:
        raise StatementError("nothing varies: give --vary NAME=LOW:HIGH:COUNT, such as --vary theta=-3:3:100.")
    axes = dict(_axis(text) for text in request.vary)
    if len(axes) < len(request.vary):
        raise StatementError("--vary names something twice: give each name once.")
    out = None if request.out is None else Path(request.out)
    drawn = out is not None and out.suffix.lower() == ".png"
    if out is not None and drawn:
        check_place(out)  # before the runs, which may take long
    held = {**begun["initial"], **begun["parameters"]}
    if twice := next((name for name in axes if name in held), None):
        raise StatementError(f"{twice} varies, and has a value as well: give one of the two.")
    varied = lg.grid({**{name: [value] for name, value in held.items()}, **axes})
    end = system.statement.run.t_end if begun["t_end"] is None else begun["t_end"]
    runs = lg.ensemble(
        system,
        end,
        varied,
        keep=tuple(_kept(system, text.strip()) for text in request.keep.split(",")),
        workers=None if request.workers is None else int(number("--workers", request.workers)),
        store=None if out is None or drawn else out,
        progress=not request.json,
        **{key: value for key, value in how.items() if value is not None},
    )
    said = repr(runs)
    if out is not None:
        if drawn:
            runs.to_png(out)
        said += f"\n  written to {out}"
    counts = Counter(runs.status.tolist())
    ended = {one.value: counts[one] for one in lg.Status if counts[one]}
    data = {"members": len(runs), "shape": [n for n in varied.shape if n > 1], "status": ended, "wall": runs.wall}
    return Answer(DONE if set(ended) <= {"success", "event"} else FAILED, said, {**data, "form": runs.form})


def _axis(text: str) -> tuple[str, tuple[float, float, int]]:
    """Return the name and the values of an option such as theta=-3:3:100."""
    name, _, rest = text.partition("=")
    parts = rest.split(":")
    if not name.strip() or len(parts) != 3 or not re.fullmatch(r"[0-9]{1,12}", parts[2].strip()):
        raise StatementError(f"--vary {text[:80]}: write NAME=LOW:HIGH:COUNT, such as --vary theta=-3:3:100.")
    low, high = (number(f"--vary {name.strip()}", part.strip()) for part in parts[:2])
    return name.strip(), (low, high, int(parts[2]))


def _kept(system: Any, text: str) -> Any:
    """Return what is kept by a name, or by a pair such as max:theta."""
    how, colon, name = text.partition(":")
    if not colon:
        return text
    known = {}
    for q in system.coordinates:
        known[q.func.__name__] = q
        known[f"{q.func.__name__}_dot"] = q.diff(lg.t)
    if name not in known:
        raise StatementError(f"--keep {text[:80]}: {name[:80]!r} is no coordinate and no velocity of {system.name}.")
    return how, known[name]
