"""Parse the options, numbers, scenes and folders that commands share; the answer of a command and its exit codes."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import lagrange as lg
from lagrange.errors import LagrangeError, StatementError, suggestion
from lagrange.statement.display import fitted
from lagrange.statement.run_settings import DESCRIPTIONS

if TYPE_CHECKING:
    from lagrange.system import System

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130

NUMBER = re.compile(r"([+-]?)(?:([0-9.]+(?:[eE][+-]?[0-9]+)?)\*?)?(pi|deg)?(?:/([0-9.]+))?")
"""Pattern of a number with an optional factor pi or deg and an optional divisor: 9.81, -1e-3, 30deg, pi/6, 2*pi/3."""

PICTURES = (".png", ".svg", ".pdf")  # Suffixes of files of still pictures


@dataclass(frozen=True)
class Answer:
    """Result of a command: the exit code, the text to print, and the same content as data for --json."""

    code: int
    text: str
    data: Any = None


class Help(argparse.HelpFormatter):
    """Formatter of the help text, whose column of command names is wide enough for indented names.

    The formatter of argparse does not count the indentation.
    """

    def add_argument(self, action: argparse.Action) -> None:
        """Add an argument to the help text. For command names, which are indented, make their column wider."""
        super().add_argument(action)
        if action.nargs == argparse.PARSER:
            self._action_max_length += self._indent_increment


class CommandParser(argparse.ArgumentParser):
    """A parser whose error messages suggest the nearest known word, and fit the width of the terminal.

    `add_options` adds the arguments of a command only when this command is parsed, so that the modules of other
    commands are not loaded.
    """

    add_options: Callable[[CommandParser], None] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse the arguments `args` as argparse does, after the options of this command were added to the parser."""
        if self.add_options is not None:
            add, self.add_options = self.add_options, None
            add(self)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print the usage and the error `message` to standard error, with a suggestion, and exit with code 2."""
        self.print_usage(sys.stderr)
        text = str(LagrangeError(f"{self.prog}: error: {message.rstrip('.')}.{self._hint(message)}"))
        self.exit(WRONG, fitted(text, sys.stderr) + "\n")

    def _hint(self, message: str) -> str:
        if match := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            return suggestion(match[1], re.findall(r"[\w-]+", match[2]))
        if match := re.search(r"unrecognized arguments: (--[^\s=]+)", message):
            known = self._option_string_actions
            other = {"--start": "--initial", "--parameter": "--set", "--output": "--out"}.get(match[1])
            return f" Did you mean {other!r}?" if other in known else suggestion(match[1], known)
        return ""


def add_scene(command: CommandParser) -> None:
    """Add to the parser `command` the argument SCENE: a scene file, or a name in the scene library."""
    command.add_argument("scene", metavar="SCENE", help="a scene file, or a name that `lagrange scenes` lists")


def add_json(command: CommandParser) -> None:
    """Add to the parser `command` the option --json, which prints the answer of the command as JSON instead of text."""
    command.add_argument("--json", action="store_true", help="print one JSON document instead of text")


def add_start(command: CommandParser, *, method: bool = True) -> None:
    """Add to the parser `command` the options of a run: parameters, initial state, and end time.

    With `method` the option for the integration method is added, too.
    """
    add_parameters(command)
    add_initial(command)
    command.add_argument("--t-end", metavar="T", help=DESCRIPTIONS["t_end"])
    for name, metavar in (("method", "NAME"), ("rtol", "X"), ("atol", "X"), ("step", "H")) if method else ():
        command.add_argument(f"--{name}", metavar=metavar, help=DESCRIPTIONS[name])


def add_parameters(command: CommandParser) -> None:
    """Add to the parser `command` the option --set for values of parameters, which is stored as `request.set`."""
    command.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="value of a parameter, such as m=2"
    )


def add_initial(command: CommandParser) -> None:
    """Add to the parser `command` the option --initial for initial values, which is stored as `request.initial`."""
    text = "initial value, such as theta=30deg or theta_dot=1"
    command.add_argument("--initial", metavar="NAME=VALUE", action="append", default=[], help=text)


def start(request: argparse.Namespace) -> dict[str, Any]:
    """Return the values of the options that `add_start` added, as keyword arguments of `System.run`."""
    stated = {
        "initial": assignments("--initial", request.initial),
        "parameters": assignments("--set", request.set),
        "t_end": given_number("--t-end", request.t_end),
    }
    if not hasattr(request, "method"):
        return stated
    numbers = {key: given_number(f"--{key}", getattr(request, key)) for key in ("rtol", "atol", "step")}
    return {**stated, "method": request.method, **numbers}


def load_scene(request: argparse.Namespace) -> System:
    """Return the system of a scene, given as a file or as a name in the scene library.

    Raises StatementError if --set gives the value of a coordinate or velocity, or --initial that of a parameter.
    """
    scene: str = request.scene
    # A library name has no suffix and no separator; everything else is taken as the path of a file.
    short = len(scene.encode(errors="replace")) < 255
    named = scene.endswith(".toml") or "/" in scene or os.sep in scene or (short and Path(scene).is_file())
    system = lg.System.from_scene(scene) if named else lg.scene(scene)
    state, parameters = system.statement.state_names, [symbol.name for symbol in system.statement.parameters]
    for option, names, kind, other in (
        ("set", state, "a coordinate or velocity", "initial"),
        ("initial", parameters, "a parameter", "set"),
    ):
        for text in getattr(request, option, ()):
            name = text.partition("=")[0].strip()
            if name in names:
                raise StatementError(f"--{option} {text[:80]}: {name} is {kind}: write --{other} {text[:80]}.")
    return system


def folder(name: str) -> Path:
    """Return the path of the folder `name`, the argument of --out. The folder is created if it is missing.

    Raises StatementError for a folder that cannot be used, and for the name of a file.
    """
    if not name:
        raise StatementError("--out: the name of the folder is empty. Give one, such as --out out, or . for this one.")
    path = Path(name)
    if path.suffix.lower() in (*PICTURES, ".csv", ".json") and not path.is_dir():
        raise StatementError(
            f"--out {name}: this command writes several files into a folder: name a folder, such as --out {path.stem}."
        )
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError for a name with a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise StatementError(f"--out {name}: the folder cannot be made ({reason}). Name another folder.") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise StatementError(f"--out {name}: the folder may not be written to. Name another folder.")
    return path


def entries(option: str, texts: Sequence[str], form: str, example: str) -> dict[str, list[str]]:
    """Return the values of a repeated option NAME=VALUE by name; each value is split at its colons.

    `texts` are the arguments of the option; "l=0.5:2" gives {"l": ["0.5", "2"]}. `form` is the required form of a
    value, such as LOW:HIGH, and `example` is an example for error messages. Raises StatementError for another form, and
    for a name that occurs twice.
    """
    table: dict[str, list[str]] = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        name, parts = name.strip(), [part.strip() for part in rest.split(":")]
        if not (name and equals) or len(parts) != len(form.split(":")):
            raise StatementError(f"{option} {text[:80]}: write NAME={form}, such as {option} {example}.")
        if name in table:
            raise StatementError(f"{option} gives {name[:80]} twice: give it once.")
        table[name] = parts
    return table


def assignments(option: str, texts: Sequence[str]) -> dict[str, float]:
    """Return {name: number} from `texts`, the arguments NAME=VALUE of the option `option`, which may be repeated."""
    stated = entries(option, texts, "VALUE", "m=2")
    return {name: number(f"{option} {name}", value) for name, (value,) in stated.items()}


def given_number(option: str, text: str | None) -> float | None:
    """Return the number in `text`, the argument of the option `option`; None if the option is absent.

    Raises StatementError, with the name of the option, for any other text.
    """
    return None if text is None else number(option, text)


def number(option: str, text: str) -> float:
    """Return the value of a text such as 30deg or 2*pi/3, which a user gives for an `option` such as --set.

    Raises StatementError, with the name of the option, if the text is not a number.
    """
    wrong = StatementError(f"{option}: {text[:80]!r} is not a number. Write one such as 2, 1e-3, 30deg or pi/6.")
    match = NUMBER.fullmatch(text)
    if not match or not (match[2] or match[3] == "pi"):
        raise wrong
    sign, digits, unit, divisor = match.groups()
    try:
        value = float(f"{sign}{digits or 1}") / float(divisor or 1)
    except (ValueError, ZeroDivisionError):
        raise wrong from None
    return value * {None: 1.0, "pi": pi, "deg": pi / 180}[unit]


def count(option: str, text: str | None) -> int | None:
    """Return the whole number, at least 2, in `text`, the argument of the option `option`.

    The result is None if the option is absent. Raises StatementError for any other text.
    """
    if text is None:
        return None
    if not re.fullmatch(r"[0-9]{1,8}", text) or int(text) < 2:
        raise StatementError(
            f"{option}: {text[:80]!r} is not a number of output times. Give 2 or more, below 100 million."
        )
    return int(text)


def code_of(solution: lg.Solution) -> int:
    """Return the exit code for the status of a run: 0 if it is complete, 1 if it failed, 130 if it was interrupted."""
    if solution.status is lg.Status.INTERRUPTED:
        return INTERRUPTED
    return DONE if solution.status.complete else FAILED
