"""Scene files written for a test: a small pendulum, with any of its fields replaced."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FIELDS: dict[str, Any] = {
    "name": "pendulum",
    "coordinates": ["theta"],
    "kinetic": "m*l**2*theta_dot**2/2",
    "potential": "-m*g*l*cos(theta)",
    "forces": {"theta": "-c*theta_dot"},
    "parameters": {"m": 1.0, "l": 1.0, "g": 9.81, "c": 0.1},
    "initial": {"theta": 2.0},
    "positions": {"bob": ["l*sin(theta)", "-l*cos(theta)"]},
    "links": [["origin", "bob"]],
    "run": {"t_end": 10.0},
}

LEAN: dict[str, Any] = {"coordinates": ["theta"], "kinetic": "theta_dot**2/2"}
"""The least that a scene may hold."""

DROP = object()
"""As a value: leave the field out."""


def toml(value: Any) -> str:
    """Return a value as TOML. A text becomes a basic string with escaped special characters."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in value) + '"'
    return json.dumps(value)


def write(folder: Path, base: Mapping[str, Any] = FIELDS, **fields: Any) -> Path:
    """Write a scene with one line for each field, and return its path."""
    path = folder / "scene.toml"
    lines = [f"{key} = {toml(value)}" for key, value in {**base, **fields}.items() if value is not DROP]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
