"""Systems and states for the comparison of recipes with the model, and the allowed differences."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.compiler import machine, model_of
from lagrange.recipes.model import Model
from lagrange.statement.coordinate import coordinate
from lagrange.statement.scene.library import library
from tests.models import SYSTEMS, build, loaded, model

EPS = float(np.finfo(float).eps)
Array = NDArray[np.float64]

SCENES = [scene.name for scene in library() if "[contacts." not in scene.path.read_text("utf-8")]
"""Scenes without contacts: a recipe that leaves out contacts is refused."""

OWN = ["cart and pole", "chain of 7", "8 carried masses", "saddle", "blocks", "friction", "spherical pendulum"]
"""Time and friction, matrices too large to be written out, moving and constant, indefinite, in blocks; conditions."""


@cache
def named(name: str) -> Model:
    """Return the model of a scene, or of a system of `tests.models`."""
    if name in SYSTEMS:
        return model(name, "numpy")
    return model_of(loaded(name), machine("numpy"))


def states(of: Model, count: int = 3) -> Iterator[tuple[float, Array]]:
    """Yield times and states around the initial one, which is the first."""
    draw, start = np.random.default_rng(5), np.array(of.statement.initial)
    for k in range(count):
        yield 0.37 * k, start + 0.1 * k * draw.normal(size=len(start))


def sensitivity(of: Model, quantity: str, t: float, y: Array) -> float:
    """Return the change of a quantity if each entry of the state and each parameter changes by one rounding error."""
    draw, p, n = np.random.default_rng(6), of.parameter_array(), len(y)
    kernel, result = of.interpreted(quantity), []
    for _ in range(4):
        by = 1 + EPS * draw.choice([-1.0, 1.0], size=n + len(p))
        result.append(np.abs(kernel(t, y * by[:n], p * by[n:]) - kernel(t, y, p)).max())
    return float(max(result))


def apart(of: Model, quantity: str, t: float, y: Array, result: Any) -> float:
    """Return the difference of a result from the model's, in units of the allowed rounding error.

    This is 4 roundings of the largest entry plus 4 times the effect of one rounding of the inputs, the error of
    elimination in another order.
    """
    exact = of.interpreted(quantity)(t, y, of.parameter_array())
    bound = 4 * EPS * np.abs(exact).max() + 4 * sensitivity(of, quantity, t, y)
    difference = np.abs(np.asarray(result, dtype=float).reshape(exact.shape) - exact).max()
    return float(difference / bound) if bound else float(difference != 0)


def singular(n: int, target: str = "numpy") -> Model:
    """Return a system of n coupled coordinates whose mass matrix is singular when two of them are zero."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    kinetic = sum((q.dot for q in xs), start=0) ** 2 / 2 + sum(q**2 * q.dot**2 for q in xs) / 2
    return build(target, kinetic=kinetic, potential=sum(xs), coordinates=xs, initial=dict.fromkeys(xs, 1.0))


def unbounded(n: int) -> Model:
    """Return a system of n coupled coordinates whose first inertia is infinite at x0 = 0, and NaN below."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    kinetic = sum((q.dot for q in xs), start=0) ** 2 / 2 + sum(q.dot**2 for q in xs) + xs[0].dot ** 2 * xs[0] ** -1.5
    return build("numpy", kinetic=kinetic, potential=sum(xs), coordinates=xs, initial=dict.fromkeys(xs, 1.0))
