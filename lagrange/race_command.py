"""The command `lagrange race`: error against time of integration methods, as a table, a picture and data."""

from __future__ import annotations

import argparse
from typing import Any

import lagrange as lg
from lagrange.arguments import (
    DONE,
    FAILED,
    Answer,
    add_command,
    add_json,
    add_start,
    folder,
    given_number,
    load_scene,
    number_list,
    start,
)
from lagrange.errors import listing


def add_race(commands: Any) -> None:
    """Add the command to the command line."""
    race_ = add_command(commands, "race", race, "measure error against time of integration methods on a scene")
    add_start(race_)
    race_.add_argument("--methods", metavar="A,B", help="methods, such as dop853,rk4 (default: a telling choice)")
    race_.add_argument("--tolerances", metavar="X,Y", help="tolerances of adaptive methods (default: 1e-3 to 1e-13)")
    race_.add_argument("--steps", metavar="H,K", help="steps of methods with equal steps (default: nine that fit)")
    race_.add_argument("--outputs", metavar="N", help="look at the errors at N times instead of the end")
    race_.add_argument("--relative", action="store_true", help="divide each entry's error by the entry's size")
    race_.add_argument("--digits", metavar="N", help="digits of the reference (default: 22)")
    race_.add_argument("--repeats", metavar="N", help="timed runs, of which the fastest counts (default: 5)")
    race_.add_argument("--max-wall", metavar="S", help="seconds after which a run is ended (default: 10)")
    race_.add_argument("--out", metavar="DIR", help="folder for table.csv and plot.png; made if need be")
    add_json(race_)


def race(request: argparse.Namespace) -> Answer:
    """Race methods on a scene, write the table and the picture, and return what was measured."""
    given: dict[str, Any] = {
        "methods": None if request.methods is None else [name.strip() for name in request.methods.split(",")],
        **{key: number_list(f"--{key}", getattr(request, key)) for key in ("tolerances", "steps")},
        **{key: given_number(f"--{key}", getattr(request, key)) for key in ("outputs", "digits", "repeats")},
        "max_wall": given_number("--max-wall", request.max_wall),
    }
    begun = start(request)
    system = load_scene(request.scene)
    target = folder(request.out) if request.out is not None else None
    wanted = {key: value for key, value in given.items() if value is not None}
    found = lg.race(system, **begun, relative=request.relative, **wanted)
    files = found.to_folder(target) if target is not None else []
    written = f"\nwritten to {target}: {listing(path.name for path in files)}" if target is not None else ""
    code = DONE if any(entry.complete for entry in found) else FAILED
    return Answer(code, repr(found) + written, {**found.to_dict(), "files": [str(path) for path in files]})
