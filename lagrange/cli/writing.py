"""Commands that write files, `lagrange export`, `page`, `plot` and `animate`, and the list of export targets."""

from __future__ import annotations

import argparse
import re
import warnings
from pathlib import Path
from typing import Any

import lagrange as lg
from lagrange.cli.arguments import (
    DONE,
    PICTURES,
    Answer,
    CommandParser,
    add_initial,
    add_parameters,
    add_start,
    assignments,
    code_of,
    entries,
    given_number,
    load_scene,
    number,
    start,
)
from lagrange.errors import StatementError
from lagrange.show.animation import DEFAULT_FPS, named_kind
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import check_place, write_atomically


def add_export(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `export`, such as --target and --out."""
    command.add_argument("--target", required=True, metavar="NAME", help="such as c; `lagrange targets` lists them")
    command.add_argument("--out", required=True, metavar="DIR", help="folder for the files")
    command.add_argument(
        "--contents",
        metavar="LIST",
        help="names with commas, such as rhs,energy,jacobian,dop853,main; rhs,energy unless it is given",
    )
    add_parameters(command)


def export(request: argparse.Namespace) -> Answer:
    """Write the source files of a scene for a target, and print the commands of their self-test."""
    system = load_scene(request)
    contents = None if request.contents is None else [name.strip() for name in request.contents.split(",")]
    values: Any = assignments("--set", request.set)
    exported = system.export(request.target, request.out, contents, parameters=values or None)
    return Answer(
        DONE, str(exported), {"files": [str(path) for path in exported.files], "commands": list(exported.commands)}
    )


def targets(request: argparse.Namespace) -> Answer:
    """List the targets, each with a one-line description."""
    del request
    table = lg.targets()
    return Answer(DONE, str(table), dict(table))


def add_page(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `page`, such as --out and --slider."""
    command.add_argument("--out", required=True, metavar="FILE", help="the file to write, such as page.html")
    add_parameters(command)
    add_initial(command)
    command.add_argument(
        "--slider",
        metavar="NAME=LOW:HIGH",
        action="append",
        default=[],
        help="a slider to show first, with its bounds, such as l=0.5:2",
    )


def page(request: argparse.Namespace) -> Answer:
    """Write the web page of a scene."""
    values, initial = assignments("--set", request.set), assignments("--initial", request.initial)
    stated = entries("--slider", request.slider, "LOW:HIGH", "l=0.5:2").items()
    sliders = {name: tuple(number(f"--slider {name}", bound) for bound in bounds) for name, bounds in stated}
    path = load_scene(request).to_page(request.out, parameters=values, initial=initial, sliders=sliders)
    size = path.stat().st_size
    return Answer(
        DONE, f"wrote {path} ({size / 1000:.0f} kB): open it in a browser.", {"file": str(path), "bytes": size}
    )


def add_plot(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `plot`, such as --out and --what."""
    command.add_argument(
        "--out", metavar="FILE", help="picture to write: .png, .svg or .pdf (default: the name of the scene with .png)"
    )
    command.add_argument(
        "--what",
        metavar="LIST",
        help="names with commas: coordinates, velocities, phase, energies, drift, invariants, path, multipliers, "
        "violation, or a coordinate (default: what there is to see)",
    )
    command.add_argument("--style", choices=("light", "dark"), default="light", help="colours (default: light)")
    add_start(command)


def plot(request: argparse.Namespace) -> Answer:
    """Run a scene, write its picture, and print the path."""
    path = _file(request, ".png")
    if path.suffix.lower() not in PICTURES:
        raise StatementError(f"--out {request.out}: name a file that ends in .png, .svg or .pdf.")
    what = None if request.what is None else [name.strip() for name in request.what.split(",")]
    begun = start(request)
    solution = load_scene(request).run(**begun, progress=not request.json)
    kind = path.suffix.lower()[1:]
    figure = solution.plot(what, style=request.style)
    written = write_atomically(path, lambda file: figure.savefig(file, format=kind, dpi=FILE_DPI))
    text = f"{_remark(solution)}written to {written}"
    data = {"file": str(written), "status": solution.status.value, "message": solution.message}
    return Answer(code_of(solution), text, data)


def add_animate(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `animate`, such as --out and --fps."""
    command.add_argument(
        "--out",
        metavar="FILE",
        help="file to write: .html for a page with a player, .gif, or .mp4, which needs ffmpeg (default: the name of "
        "the scene with .html)",
    )
    command.add_argument("--speed", metavar="X", help="time of the run per time on the screen (default: 1 if it fits)")
    command.add_argument("--fps", metavar="N", help=f"frames per second, 1 to 60 (default: {DEFAULT_FPS:g})")
    command.add_argument("--size", metavar="WxH", help="width and height in pixels, such as 640x480")
    command.add_argument("--style", choices=("auto", "light", "dark"), default="auto", help="colours (default: auto)")
    command.add_argument("--trail", metavar="T", help="time that trails go back; 0 for none")
    add_start(command)


def animate(request: argparse.Namespace) -> Answer:
    """Run a scene, write its animation, and print the number of frames, the duration and the path of the file."""
    path = named_kind(_file(request, ".html"))
    options = {key: given_number(f"--{key}", getattr(request, key)) for key in ("speed", "trail")}
    fps, size = given_number("--fps", request.fps), _size(request.size)
    begun = start(request)
    solution = load_scene(request).run(**begun, progress=not request.json)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the notes in the output say the same
        animation = solution.animate(
            path,
            fps=fps,
            size=size,
            style=request.style,
            progress=not request.json,
            **options,
        )
    data = {
        "file": str(animation.path),
        "frames": len(animation.t),
        "seconds": animation.timing.seconds,
        "speed": animation.timing.speed,
        "notes": list(animation.notes),
        "status": solution.status.value,
        "message": solution.message,
    }
    return Answer(code_of(solution), _remark(solution) + repr(animation), data)


def _file(request: argparse.Namespace, ending: str) -> Path:
    """Return the path that --out names, or a path in the current folder: the scene's name with the suffix `ending`.

    Raises StatementError for an empty name, and for a path that cannot be written.
    """
    if request.out == "":
        raise StatementError(f"--out: the name of the file is empty. Give one, such as --out run{ending}.")
    path = Path(Path(request.scene).stem + ending if request.out is None else request.out)
    check_place(path)  # refuse a path that cannot be written before the run, which may take long
    return path


def _size(text: str | None) -> tuple[int, int] | None:
    """Return (width, height) in pixels from the text of an option, such as 640x480; None if the option is absent."""
    if text is None:
        return None
    match = re.fullmatch(r"([0-9]{1,6})[x×]([0-9]{1,6})", text.strip())
    if not match:
        raise StatementError(f"--size: {text[:80]!r} is not a size. Write width and height in pixels, such as 640x480.")
    return int(match[1]), int(match[2])


def _remark(solution: lg.Solution) -> str:
    """Return the message of a run that did not reach its end, as a line of text; empty for a complete run."""
    return "" if code_of(solution) == DONE else f"{solution.message}\n"
