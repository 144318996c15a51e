"""Animate runs: frame times, frames, GIF and MP4, with defaults and suffixes. The HTML player is in `lagrange/page`."""

from __future__ import annotations

import os
from pathlib import Path

from lagrange.errors import StatementError, shown, with_type

DEFAULT_FPS = 30.0
"""Frames per second unless others are requested. The command line reads this file without loading an animation."""

SUFFIXES = (".html", ".gif", ".mp4", ".png")
"""Suffixes of animation files: a page with a player, two kinds of moving pictures, and a picture of the first frame."""


def named_kind(path: str | os.PathLike[str]) -> Path:
    """Return the path of an animation file. Raises StatementError if its suffix is not in `SUFFIXES`."""
    if not isinstance(path, (str, os.PathLike)):
        raise StatementError(f"the path is {with_type(path)}: give the path of a file.")
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise StatementError(
            f"the name {shown(str(path))} has no known suffix: give one that ends in .html for a page with a "
            "player, .gif or .mp4 for a picture that moves, .png for the first frame."
        )
    return target
