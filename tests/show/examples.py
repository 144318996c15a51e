"""Solutions with known motions, animations and their data, and distances from polylines, for tests of pictures."""

import base64
import json
import re
import zlib
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from sympy import Float, cos, sin

import lagrange as lg
from lagrange.compiler import model_of
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.page.player import Animation
from lagrange.statement.coordinate import coordinate, coordinates, parameters
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

x = coordinate("x")
m, k = parameters("m k")


def solved(statement: Any, t: Any, path: Any, status: Status = Status.SUCCESS, message: str = "done") -> Solution:
    """Return the solution of a statement whose state at times (K,) is path(times), (2n, K)."""
    model = model_of(statement, NumpyMachine())
    span = (float(t[0]), float(t[-1])) if len(t) else (0.0, 0.0)
    trajectory = Trajectory(t, path(t), status, message, "exact", len(t) - 1, 3, 44, 0.0123, span, path)
    return Solution(trajectory, model, model.parameter_values())


def oscillator(times: Any = None, status: Status = Status.SUCCESS, message: str = "done", **more: Any) -> Solution:
    """Return the solution x = cos(2 t) with m = 1 and k = 4, by default over [0, 5]."""
    statement = declare(
        kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 4}, name="oscillator", **more
    )
    t = np.linspace(0.0, 5.0, 51) if times is None else np.asarray(times, dtype=float)
    return solved(statement, t, lambda t: np.array([np.cos(2 * t), -2 * np.sin(2 * t)]), status, message)


def moving(*parts: Any, **more: Any) -> Solution:
    """Return a solution over [0, 2] with a point p whose coordinates are functions of a = t and b = t^2, or numbers."""
    a, b = coordinates("a b")
    place = [part(a, b) if callable(part) else Float(part) for part in parts]
    statement = declare(kinetic=a.dot**2 + b.dot**2, positions={"p": place}, name="s", **more)
    return solved(statement, np.linspace(0, 2, 9), lambda t: np.array([t, t**2, np.ones_like(t), 2 * t]))


def free(count: int, **more: Any) -> Solution:
    """Return `count` free particles on lines, x1 to xn, at speeds 1 to n."""
    lines = [coordinate(f"x{i + 1}") for i in range(count)]
    statement = declare(kinetic=sum(q.dot**2 for q in lines) / 2, coordinates=lines, name="free", **more)
    speeds = np.arange(1.0, count + 1.0)
    return solved(
        statement,
        np.linspace(0.0, 1.0, 5),
        lambda t: np.concatenate([np.outer(speeds, t), np.repeat(speeds[:, None], len(t), axis=1)]),
    )


# --- runs for tests of animations, and functions that read the data of an animation's HTML ---------------------


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


# --- distance of curves from polylines, computed independently of the package ----------------------------------


def farthest(exact: FloatArray, lines: list[FloatArray]) -> float:
    """Return the largest distance in pixels from points (2, K) to polylines (2, C)."""
    placed = []
    for line in lines:
        begin, along = line[:, :-1], np.diff(line)
        length = np.nan_to_num(np.hypot(*along), nan=-1.0)
        parts = np.where(length < 0, 0, np.ceil(length / 0.25) + 1).astype(int)
        chord = np.repeat(np.arange(len(parts)), parts)
        part = np.arange(len(chord)) - np.repeat(np.cumsum(parts) - parts, parts)
        placed.append(begin[:, chord] + along[:, chord] * (part / np.maximum(parts[chord] - 1, 1)))
    tree = KDTree(np.concatenate(placed, axis=1).T)
    distance = np.asarray(tree.query(exact.T)[0])
    return float(distance.max())
