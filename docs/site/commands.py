"""The page of the command line: what `lagrange COMMAND --help` prints, for every command."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from stage import write_changed

from lagrange.cli.program import parser

INTRODUCTION = """\
# Command line

`lagrange COMMAND --help` prints what stands here. A scene is a name of the [library](gallery/index.md) or
[a file](scenes.md). Exit codes: 0 done, 1 the run or the check failed, 2 the request was wrong, 130 interrupted.
"""


def write(path: Path) -> None:
    """Write the page."""
    os.environ["COLUMNS"] = "88"
    top = parser()
    found = next(action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    parts = [INTRODUCTION]
    for name, command in found.choices.items():
        command.add_options(command)
        parts.append(f"## lagrange {name}\n\n```text\n{command.format_help()}```\n")
    write_changed(path, "\n".join(parts))
