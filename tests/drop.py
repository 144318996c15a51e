"""A scene file for tests of the command line."""

from __future__ import annotations

from pathlib import Path

DROP = """\
name = "drop"
about = "A stone that falls."
source = "Galilei"
coordinates = ["y"]
kinetic = "m*y_dot**2/2"
potential = "m*g*y"
positions = { stone = ["0", "y"] }
[parameters]
m = 2.0
g = 10.0
[initial]
y = 5.0
[run]
t_end = 2.0
"""


def written(folder: Path, text: str) -> str:
    """Write a scene and return where it is."""
    path = folder / "drop.toml"
    path.write_text(text, "utf-8")
    return str(path)
