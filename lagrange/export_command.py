"""The commands `lagrange export` and `lagrange targets`: a scene as source files for other solvers."""

from __future__ import annotations

import argparse
from typing import Any

import lagrange as lg
from lagrange.arguments import DONE, Answer, add_command, add_json, add_parameters, assignments, load_scene


def add_export(commands: Any) -> None:
    """Add the commands to the command line."""
    export_ = add_command(commands, "export", export, "write a scene as source files for other solvers")
    export_.add_argument("--target", required=True, metavar="NAME", help="such as c; `lagrange targets` lists them")
    export_.add_argument("--out", required=True, metavar="DIR", help="folder for the files")
    export_.add_argument(
        "--contents",
        metavar="LIST",
        help="names with commas, such as rhs,energy,jacobian,dop853,main; rhs,energy unless it is given",
    )
    add_parameters(export_)
    add_json(export_)
    add_json(add_command(commands, "targets", targets, "list the targets of export", takes_scene=False))


def export(request: argparse.Namespace) -> Answer:
    """Write a scene for a target, and say how its self-test is run."""
    system = load_scene(request.scene)
    contents = None if request.contents is None else [name.strip() for name in request.contents.split(",")]
    values: Any = assignments("--set", request.set)
    made = system.export(request.target, request.out, contents, parameters=values or None)
    return Answer(DONE, str(made), {"files": [str(path) for path in made.files], "commands": list(made.commands)})


def targets(request: argparse.Namespace) -> Answer:
    """List the targets, each with a line about it."""
    del request
    table = lg.targets()
    return Answer(DONE, str(table), dict(table))
