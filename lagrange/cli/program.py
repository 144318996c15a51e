"""The program `lagrange`: table of commands, parser, output, the commands derive, check, scenes and new.

Neither SymPy nor NumPy is imported before the arguments are parsed, so that help appears at once.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import lagrange as lg
from lagrange.cli.arguments import (
    DONE,
    FAILED,
    INTERRUPTED,
    WRONG,
    Answer,
    CommandParser,
    Help,
    add_json,
    add_scene,
    folder,
    load_scene,
)
from lagrange.cli.interruption import SENTENCE, Signalled, complain, output
from lagrange.errors import LagrangeError, StatementError, capitalized
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.text import plain_text
from lagrange.statement.display import ABOVE, DETAILS, FORMATS, columns_of_output, fitted, text_table
from lagrange.statement.run_settings import DEFAULT_METHOD, DEFAULT_T_END
from lagrange.statement.scene.toml_document import Document

COMMANDS: Mapping[str, tuple[str, str]] = {
    "run": ("lagrange.cli.running", "compile a scene, run it and print how it went"),
    "plot": ("lagrange.cli.writing", "run a scene and write a picture of the run"),
    "animate": ("lagrange.cli.writing", "run a scene and write it as a picture that moves"),
    "derive": ("lagrange.cli.program", "print Lagrangian, momenta, equations of motion and accelerations"),
    "check": ("lagrange.cli.program", "compare everything compiled with numerical differentiation of T and V"),
    "race": ("lagrange.cli.running", "measure error against time of integration methods on a scene"),
    "grade": ("lagrange.cli.grade", "compare equations of motion in a file or folder with a scene's"),
    "export": ("lagrange.cli.writing", "write a scene as source files for other solvers"),
    "targets": ("lagrange.cli.writing", "list the targets of export"),
    "ensemble": ("lagrange.cli.running", "run a scene from many starts, or with many parameters"),
    "page": ("lagrange.cli.writing", "write a web page on which a scene moves, one file that needs no network"),
    "scenes": ("lagrange.cli.program", "list the library of scenes"),
    "new": ("lagrange.cli.program", "write a commented scene file to start from"),
}
"""Commands, by name, in the order of the help text: the module with the function of this name, and the line of help.
The module is imported only when the command is parsed."""

WITHOUT_SCENE, WITHOUT_JSON = ("targets", "scenes", "new"), ("derive", "new")
"""Commands without the argument SCENE, and commands without the option --json."""

STARTER = """\
# A scene: one mechanical system, stated by its energies. Run it with:  lagrange run {file}
# Expressions know + - * / **, sin cos tan cot sec csc asin acos atan atan2 exp log sqrt sinh cosh tanh asinh acosh
# atanh erf sinc heaviside abs sign min max mod, and pi.

name = "{name}"
about = "A pendulum with friction, to be changed into your system."
source = ""  # where it was published

# The generalized coordinates. theta_dot is the velocity of theta; t is time.
coordinates = ["theta"]

# L = T - V. Instead of the two, lagrangian = "..." may be given.
kinetic = "m*l**2*theta_dot**2/2"
potential = "-m*g*l*cos(theta)"

# Generalized forces, one expression per coordinate, and Rayleigh's dissipation function (force -dD/d(velocity)).
forces = {{ theta = "-c*theta_dot" }}
dissipation = 0

# Constraints, if there are any: expressions that stay zero, or equations, by name or in a list; those without a
# velocity hold coordinates. A pendulum in x and y would have  rod = "x**2 + y**2 == l**2"  in a table [constraints].
constraints = []

# What to draw, if anything: named points (x, y) or (x, y, z), and rods between them.
links = [["origin", "bob"]]

[positions]
bob = ["l*sin(theta)", "-l*cos(theta)"]

# Every other name in the expressions, with its value. Units are yours; keep them consistent.
[parameters]
m = 1.0  # kg
g = 9.81  # m/s^2
l = 1.0  # m
c = 0.1  # kg m^2/s

# The state at the start; what is not named is zero.
[initial]
theta = "pi/3"
theta_dot = 0.0

# How to run it; each line may be left out.
[run]
t_end = 10.0
# method = "taylor"
# rtol = 1e-8
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that the arguments `argv` name, those of the process by default, and return the exit code.

    The code is 0 for done, 1 for failed, 2 for a wrong request, 130 for interrupted, 141 for a broken pipe.
    """
    as_json = False
    try:
        with redirect_stdout(io.StringIO()) as page:
            try:
                request, unknown = parser().parse_known_args(argv)
                if unknown:
                    request.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
            except SystemExit as stop:
                request = None
                code = int(stop.code or 0)
        if request is None:
            return output(page.getvalue().rstrip("\n"), code) if page.getvalue() else code
        as_json = getattr(request, "json", False)
        return _print(_answer(request), as_json=as_json)
    except KeyboardInterrupt as interrupt:
        code = interrupt.code if isinstance(interrupt, Signalled) else INTERRUPTED
        return _print(Answer(code, SENTENCE, {"error": SENTENCE, "exit_code": code}), as_json=as_json)


def _answer(request: argparse.Namespace) -> Answer:
    try:
        answer: Answer = request.command(request)
    except StatementError as error:
        message = str(error)
        return Answer(WRONG, message, {"error": message, "exit_code": WRONG})
    except LagrangeError as error:
        message = str(error)
        return Answer(FAILED, message, {"error": message, "exit_code": FAILED})
    return answer


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    top = CommandParser(
        "lagrange",
        description="State kinetic and potential energy, get checked, compiled equations of motion and trajectories.",
        epilog="Exit codes: 0 done, 1 the run or the check failed, 2 the request was wrong, 130 "
        "interrupted, 143 terminated, 141 nobody read the output.",
        allow_abbrev=False,
        formatter_class=Help,
    )
    top.add_argument("--version", action="version", version=f"lagrange {lg.__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (place, summary) in COMMANDS.items():
        about = f"{capitalized(summary)}."
        command = commands.add_parser(name, help=summary, description=about, allow_abbrev=False, formatter_class=Help)
        command.set_defaults(parser=command)
        command.add_options = partial(_add_options, place, name)
    return top


def _add_options(place: str, name: str, command: CommandParser) -> None:
    """Make the parser `command` call the function `name` of the module `place`, and add the arguments of the command.

    The function add_`name` of the module, if there is one, adds the arguments that only this command has.
    """
    module = import_module(place)
    command.set_defaults(command=getattr(module, name))
    if name not in WITHOUT_SCENE:
        add_scene(command)
    if add := getattr(module, f"add_{name}", None):
        add(command)
    if name not in WITHOUT_JSON:
        add_json(command)


def add_derive(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `derive`, such as --format and --detail."""
    command.add_argument(
        "--format", choices=FORMATS, help="language of the page (default: unicode in a terminal that has it, else text)"
    )
    for field in ABOVE:
        command.add_argument(f"--{field}", metavar="TEXT", default="", help=f"the {field} above the derivation")
    command.add_argument("--detail", choices=DETAILS, default="full", help="short leaves out the steps (default: full)")


def derive(request: argparse.Namespace) -> Answer:
    """Return the derivation of a scene's equations of motion."""
    derivation = load_scene(request).derivation(request.detail)
    above = {field: getattr(request, field) for field in ABOVE}
    return Answer(DONE, derivation.written(request.format, **above).rstrip("\n"))


def check(request: argparse.Namespace) -> Answer:
    """Check a scene's compiled equations and return the report."""
    report = load_scene(request).check()
    return Answer(DONE if report else FAILED, str(report), report.to_dict())


def add_new(command: CommandParser) -> None:
    """Add to the parser `command` the arguments of the command `new`: the name of the scene, and the option --out."""
    command.add_argument("name", metavar="NAME", help="name of the scene; the file is NAME.toml")
    command.add_argument("--out", metavar="DIR", default=".", help="folder to write it to (default: this one)")


def new(request: argparse.Namespace) -> Answer:
    """Write a new scene file, a pendulum to start from; existing files are not overwritten."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", request.name):
        raise StatementError(
            f"{request.name[:80]!r} cannot name a scene: use 1 to 64 letters, digits, - and _, such as double-pendulum."
        )
    path = folder(request.out) / f"{request.name}.toml"
    if path.exists():
        raise StatementError(f"{path} exists already and was not changed: choose another name, or remove it first.")
    text = STARTER.format(name=request.name, file=path.name)
    write_atomically(path, lambda file: file.write(text.encode()))
    return Answer(DONE, f"{path} is a pendulum for now: change it, then  lagrange run {path}")


def _print(answer: Answer, *, as_json: bool) -> int:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    refused = isinstance(answer.data, dict) and "error" in answer.data
    if refused:
        complain(fitted(f"lagrange: {answer.text}", sys.stderr).removeprefix("lagrange: "))
    if as_json:
        return output(json.dumps(answer.data, indent=2, allow_nan=False), answer.code)
    return answer.code if refused else output(fitted(answer.text, sys.stdout), answer.code)


SCENES = Path(__file__).resolve().parent.parent / "scenes"


def add_scenes(command: CommandParser) -> None:
    """Add to the parser `command` the option --long of the command `scenes`, for more lines on each scene."""
    command.add_argument(
        "--long", action="store_true", help="with coordinates, constraints, end, method and source of each"
    )


def scenes(request: argparse.Namespace) -> Answer:
    """List the scenes of the library. Only their files are read, and nothing is compiled."""
    entries = [_entry(path, long=request.long) for path in sorted(SCENES.glob("*.toml"))]
    if request.long:
        return Answer(DONE, "\n\n".join(map(_paragraph, entries)), entries)
    rows = [(scene["name"], plain_text(scene["about"])) for scene in entries]
    return Answer(DONE, text_table(("scene", "what it shows"), rows, columns=columns_of_output()), entries)


def _entry(path: Path, *, long: bool) -> dict[str, Any]:
    scene = Document(path).data
    entry = {"name": path.stem, "about": scene.get("about", ""), "source": scene.get("source", "")}
    if not long:
        return entry
    stated = scene.get("constraints", {})
    run = scene.get("run", {})
    return entry | {
        "coordinates": [*scene.get("coordinates", []), *scene.get("rotations", [])],
        "constraints": [f"{name}: {text}" for name, text in stated.items()] if isinstance(stated, dict) else stated,
        "contacts": list(scene.get("contacts", {})),
        "positions": list(scene.get("positions", {})),
        "t_end": run.get("t_end", DEFAULT_T_END),
        "method": run.get("method", DEFAULT_METHOD),
    }


def _paragraph(entry: dict[str, Any]) -> str:
    lines = [
        ("coordinates", ", ".join(entry["coordinates"])),
        ("constraints", "; ".join(map(plain_text, entry["constraints"])) or "none"),
        ("contacts", ", ".join(entry["contacts"]) or "none"),
        ("positions", ", ".join(entry["positions"]) or "none"),
        ("method", f"{entry['method']} to t = {entry['t_end']}"),
        ("source", plain_text(entry["source"])),
    ]
    title = f"{entry['name']}: {plain_text(entry['about'])}"
    return "\n".join([title, *(f"  {name:11}  {text}" for name, text in lines)])
