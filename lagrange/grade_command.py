"""The command `lagrange grade`: a student's equations of motion against those of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from lagrange.arguments import DONE, FAILED, Answer, add_command, add_json, load_scene
from lagrange.errors import StatementError

LARGEST_FILE = 1_000_000
"""Bytes of a file of equations."""


def add_grade(commands: Any) -> None:
    """Add the command to the command line."""
    grade_ = add_command(commands, "grade", grade, "compare equations of motion in a file with those of a scene")
    grade_.add_argument("file", metavar="FILE", help="equations, one a line, such as  l*theta_ddot + g*sin(theta) = 0")
    add_json(grade_)


def grade(request: argparse.Namespace) -> Answer:
    """Compare the equations of a file with those of a scene, and say which term is wrong."""
    system = load_scene(request.scene)
    try:
        result = system.compare_text(_text(request.file))
    except StatementError as error:
        raise StatementError(f"{request.file}: {error}") from None
    data = {
        "right": bool(result),
        "message": result.message,
        "wrong": [i + 1 for i in result.wrong],
        "counterexample": dict(result.counterexample),
    }
    return Answer(DONE if result else FAILED, result.message, data)


def _text(name: str) -> str:
    """Return the text of a file. Raises StatementError where it cannot be read."""
    path = Path(name)
    if path.is_dir():
        raise StatementError("this is a folder. Give one of its files; a shell goes through all of them.")
    if not path.is_file():
        raise StatementError("there is no such file. Give a text file with one equation a line.")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise StatementError(f"the file has more than {LARGEST_FILE} bytes, the most for equations.")
        return path.read_text("utf-8-sig")
    except OSError as error:
        raise StatementError(f"the file cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError:
        raise StatementError("the file is no text in UTF-8.") from None
