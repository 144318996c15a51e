"""Runs to animate, and what a page of HTML says about its frames."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import numpy as np
from sympy import cos, sin

from lagrange.show.animation.animation import Animation
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from tests.show.examples import solved


def double_pendulum(times: Any = (0.0, 1.0), **more: Any) -> Solution:
    """Return a double pendulum whose angles are t and -2 t, a spring between its bobs."""
    a, b = coordinates("a b")
    first = (sin(a), -cos(a))
    second = (sin(a) + sin(b), -cos(a) - cos(b))
    positions = {"first": first, "second": second}
    statement = declare(
        kinetic=a.dot**2 + b.dot**2,
        potential=-3 * cos(a) - cos(b),
        **{
            "positions": positions,
            "links": [("origin", "first"), ("first", "second", "spring")],
            "name": "double",
            **more,
        },
    )
    t = np.asarray(times, dtype=float)
    return solved(statement, t, lambda t: np.array([t, -2 * t, np.ones_like(t), -2 * np.ones_like(t)]))


def in_page(page: str) -> dict[str, Any]:
    """Return the data of the player in a page, with its numbers unpacked: rows (R, S) in pixels."""
    found = re.search(r"^const sheet = (.*);$", page, re.MULTILINE)
    assert found
    sheet: dict[str, Any] = json.loads(found[1])
    packed = np.frombuffer(base64.b64decode(sheet["numbers"]), dtype="<i2")
    samples = (sheet["frames"] - 1) * sheet["detail"] + 1
    sheet["rows"] = packed.reshape(-1, samples) * sheet["grain"]
    return sheet


def in_pixels(animation: Animation) -> np.ndarray[Any, Any]:
    """Return the tracks of an animation at its frames, (P, 2, K)."""
    return animation.sheet.tracks[:, :, :: animation.sheet.detail]
