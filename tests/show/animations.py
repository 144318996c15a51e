"""Runs for tests of animations, and functions that read the data of an animation's HTML."""

from __future__ import annotations

import base64
import json
import re
import zlib
from typing import Any

import numpy as np
from sympy import cos, sin

import lagrange as lg
from lagrange.page.player import Animation
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from tests.show.examples import solved


def double_pendulum(times: Any = (0.0, 1.0), **more: Any) -> Solution:
    """Return a double pendulum whose angles are t and -2 t, with a spring between its bobs."""
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


def bouncing() -> Solution:
    """Return a ball that loses speed at each bounce."""
    y = lg.coordinate("y")
    ball = lg.System(kinetic=y.dot**2 / 2, potential=10 * y, initial={y: 1.0}, positions={"ball": (0, y)}, name="ball")
    return ball.run(2.0, events=[lg.event(y, direction=-1, reset={y.dot: -0.8 * y.dot}), y.dot])


def in_page(page: str) -> dict[str, Any]:
    """Return the data of the player in a page, with its numbers unpacked: rows (R, S)."""
    parts = [re.search(rf'id="{name}">(.*?)</script>', page, re.DOTALL) for name in ("data", "packed")]
    assert parts[0] and parts[1]
    data: dict[str, Any] = json.loads(parts[0][1])
    packed = zlib.decompress(base64.b64decode(parts[1][1].split(" ")[2]))
    scales = np.array(data["record"]["rows"])
    low, high = np.frombuffer(packed, np.uint8).reshape(2, len(scales), -1).astype(np.int64)
    whole = (low + 256 * high).cumsum(axis=1).cumsum(axis=1) & 0xFFFF
    data["rows"] = scales[:, :1] + scales[:, 1:] * whole
    return data


def unpacked(page: str) -> list[str]:
    """Return the unpacked style and scripts of a player."""
    packed = re.search(r'id="packed">(.*?) (.*?) ', page)
    assert packed
    return [zlib.decompress(base64.b64decode(text)).decode() for text in packed.groups()]


def in_pixels(animation: Animation) -> np.ndarray[Any, Any]:
    """Return the positions of named points in all frames, in pixels from the upper left corner, (P, 2, K)."""
    animation.frame(0)
    scene, drawn = animation.film.scene, animation.film._drawn
    assert scene is not None
    places = scene.seen[:, :, animation.recording.frames]
    pixels = drawn.figure.axes[0].transData.transform(places.transpose(0, 2, 1).reshape(-1, 2))
    pixels[:, 1] = animation.film.size[1] - pixels[:, 1]
    return pixels.reshape(len(places), -1, 2).transpose(0, 2, 1)


def texts(animation: Animation) -> set[str]:
    """Return all texts in the picture of an animation."""
    from matplotlib.text import Text

    animation.frame(0)
    return {text.get_text() for text in animation.film._drawn.figure.findobj(Text)} - {""}
