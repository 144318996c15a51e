"""The command `lagrange page`: a scene as a web page on which it moves."""

from __future__ import annotations

import argparse
from typing import Any

from lagrange.arguments import (
    DONE,
    Answer,
    add_command,
    add_initial,
    add_json,
    add_parameters,
    assignments,
    bounds,
    load_scene,
)


def add_page(commands: Any) -> None:
    """Add the command to the command line."""
    page_ = add_command(
        commands, "page", page, "write a web page on which a scene moves, one file that needs no network"
    )
    page_.add_argument("--out", required=True, metavar="FILE", help="the file to write, such as page.html")
    add_parameters(page_)
    add_initial(page_)
    page_.add_argument(
        "--slider",
        metavar="NAME=LOW:HIGH",
        action="append",
        default=[],
        help="a slider that stands first, with its bounds, such as l=0.5:2",
    )
    add_json(page_)


def page(request: argparse.Namespace) -> Answer:
    """Write the page of a scene."""
    values, initial = assignments("--set", request.set), assignments("--initial", request.initial)
    sliders = bounds("--slider", request.slider)
    path = load_scene(request.scene).to_page(request.out, parameters=values, initial=initial, sliders=sliders)
    size = path.stat().st_size
    return Answer(
        DONE, f"wrote {path} ({size / 1000:.0f} kB): open it in a browser.", {"file": str(path), "bytes": size}
    )
