"""Numbers that overflow come back as inf and NaN, or as a sentence: NumPy's warnings stay inside.

pytest turns warnings into errors here; the same calls are made where a user has told NumPy to raise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from sympy import Abs, Rational, exp, log, sqrt

import lagrange as lg

x, y = lg.coordinates("x y")
T = x.dot**2 / 2

SYSTEMS: dict[str, dict[str, Any]] = {
    "exponential": {"kinetic": T, "potential": exp(x)},
    "high power": {"kinetic": T + y.dot**2 / 2, "potential": x**301 / 301 + x * y},
    "root": {"kinetic": T, "potential": sqrt(x)},
    "logarithm": {"kinetic": T, "potential": log(x) * x**2},
    "mass that overflows": {"kinetic": exp(x) * T + y.dot**2 / 2, "potential": y**2},
    "masses that differ": {"kinetic": 1e300 * x.dot**2 + 1e-300 * y.dot**2, "potential": x**2 + y**2},
    "coupled masses that differ": {"kinetic": 1e300 * x.dot**2 + 1e-300 * y.dot**2 + x.dot * y.dot, "potential": x},
    "drag": {"kinetic": T, "potential": x**2, "forces": {x: -x.dot * Abs(x.dot) ** 41}},
    "kink": {"kinetic": T, "potential": Abs(x) ** Rational(3, 2)},
    "velocity": {"kinetic": x.dot**4 / 4, "potential": x**2},
}
NUMBERS = [0.0, 1.0, -1.0, 1e3, 1e155, -1e308, 5e-324, np.inf, np.nan]


@pytest.fixture(params=["warn", "raise"])
def errors(request: pytest.FixtureRequest) -> Iterator[None]:
    with np.errstate(all=request.param):
        yield


def calls(model: lg.Model, q: Any, v: Any) -> list[Callable[[], Any]]:
    y0 = np.concatenate([q, v])
    named = [lambda name=name: model.evaluate(name, q, v) for name in ("forces", "bias", "lagrangian")]
    return [
        lambda: model.accelerations(q, v),
        lambda: model.rhs(0.0, y0),
        lambda: model.jacobian(0.0, y0),
        lambda: model.energy(q, v),
        lambda: model.momenta(q, v),
        lambda: model.mass_matrix(q, v=v),
        lambda: model.evaluate_expression(exp(x) / x + x.ddot, np.zeros(y0.shape[1]), y0) if y0.ndim > 1 else None,
        *named,
    ]


@pytest.mark.usefixtures("errors")
@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_no_evaluation_lets_a_warning_out(name: str, target: str) -> None:
    model = lg.System(**SYSTEMS[name]).compile(target)
    n, refused, answered = model.dimension, 0, 0
    for a in NUMBERS:
        for b in (0.0, 1e160):
            for shape in ((n,), (n, 3)):
                for call in calls(model, np.full(shape, a), np.full(shape, b)):
                    try:
                        call()
                        answered += 1
                    except lg.RunError:
                        refused += 1
    assert answered > refused


def split(system: lg.System, start: dict[Any, float]) -> tuple[list[float], list[float]]:
    coordinates = system.statement.coordinates
    return [start.get(q, 0.0) for q in coordinates], [start.get(q.diff(lg.t), 0.0) for q in coordinates]


@pytest.mark.usefixtures("errors")
@pytest.mark.parametrize("method", ["taylor", "dop853"])
@pytest.mark.parametrize("name", ["exponential", "coupled masses that differ", "drag", "velocity"])
def test_no_run_lets_a_warning_out(name: str, method: str) -> None:
    system = lg.System(**SYSTEMS[name])
    for start in ({x: 1e3}, {x: 1.0, x.dot: 1e160}, {x: -1.0, x.dot: 1e7}):
        if not np.isfinite(system.compile().energy(*split(system, start))):
            with pytest.raises(lg.StatementError, match=r"at the initial state .* Look for an overflow, a division by"):
                system.run(1.0, start, method=method)
            continue
        found = system.run(1.0, start, method=method, max_steps=100)
        assert len(found.energy) == len(found.t) and str(found) and found.message
        found.at(np.linspace(0.0, found.t[-1], 5))
        found.evaluate(exp(1000 * x) / x)


def test_what_is_finite_is_told_from_what_is_not() -> None:
    """Accelerations whose squares overflow are finite; one that is infinite for want of inertia is refused."""
    for target in ("llvm", "numpy"):
        free = lg.System(kinetic=T + y.dot**2 / 2, potential=1e200 * x * y).compile(target)
        assert free.accelerations([1e100, 1e100], [0.0, 0.0]).tolist() == [-1e300, -1e300]
        assert free.accelerations(np.full((2, 99), 1e100), np.zeros((2, 99))).tolist() == [[-1e300] * 99] * 2
        model = lg.System(kinetic=x**2 * T + y.dot**2 / 2, potential=x, coordinates=[x, y]).compile(target)
        for batch in (1, 99):
            q = np.ones((2, batch))
            q[0, -1] = 0.0
            with pytest.raises(lg.RunError, match="the mass matrix is singular at t = 0, x = 0, y = 1"):
                model.accelerations(q, np.zeros((2, batch)))
