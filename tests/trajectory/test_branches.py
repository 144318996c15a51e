"""A branch of a Piecewise that does not apply is never evaluated, by any method.

The reference is SciPy's DOP853 on each interval between two switches, with equations without branches.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sympy import Max, Piecewise, Rational, log, sqrt

from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import TARGETS, build, x

Law = Callable[[float, float, float], float]

END, START = 3.0, (-0.5, 0.1)
HALF = Rational(1, 2)


@dataclass(frozen=True)
class Case:
    """A potential and a force, and the equations of motion for each sign of `switch`.

    A constant force of 1 is added.
    """

    below: Law
    above: Law
    potential: Any = 0
    force: Any = 0
    switch: Law = lambda time, q, v: q


def only(value: Any, condition: Any) -> Any:
    return Piecewise((value, condition), (0, True))


def free(time: float, q: float, v: float) -> float:
    return 1.0


def hertz(time: float, q: float, v: float) -> float:
    return 1 - 50 * float(max(q, 0.0) ** 1.5)


def root(time: float, q: float, v: float) -> float:
    return 1 - 30 * math.sqrt(max(q, 0.0))


CASES = {
    "Hertz": Case(free, hertz, only(20 * x ** Rational(5, 2), x > 0)),
    "Hertz by max": Case(free, hertz, 20 * Max(x, 0) ** Rational(5, 2)),
    "an infinite slope": Case(free, root, only(20 * x ** Rational(3, 2), x > 0)),
    "an infinite slope by max": Case(free, root, 20 * Max(x, 0) ** Rational(3, 2)),
    "logarithm": Case(
        free,
        lambda time, q, v: 1 - 10 * math.log(q),
        force=only(-10 * log(x), x > HALF),
        switch=lambda time, q, v: q - 0.5,
    ),
    "a speed": Case(
        free,
        lambda time, q, v: 1 - 3 * math.sqrt(max(v - 0.25, 0.0)),
        force=only(-3 * sqrt(x.dot - HALF / 2), x.dot > HALF / 2),
        switch=lambda time, q, v: v - 0.25,
    ),
    "a time": Case(
        free,
        lambda time, q, v: 1 - 4 * math.sqrt(max(time - 1, 0.0)),
        force=only(-4 * sqrt(t - 1), t > 1),
        switch=lambda time, q, v: time - 1,
    ),
}
"""What is written in a branch has no value, or no derivative, where the run begins."""


def system(name: str, target: str = "llvm") -> Model:
    case = CASES[name]
    return build(
        target,
        kinetic=x.dot**2 / 2,
        potential=case.potential - x,
        forces={x: case.force},
        coordinates=[x],
        initial={x: START[0], x.dot: START[1]},
    )


def solve(law: Law, switch: Law, now: float, state: Any, direction: float) -> Any:
    """Return the motion under one law until `switch` crosses zero in a direction."""

    def crossing(time: float, y: Any) -> float:
        return switch(time, *y)

    vars(crossing).update(terminal=True, direction=direction)
    run: Any = solve_ivp
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "max_step": 0.01}
    return run(lambda time, y: [y[1], law(time, *y)], (now, END), state, events=crossing, **options)


@cache
def truth(name: str) -> Any:
    """Return the end state, integrated from one switch to the next, each time with the law that applies."""
    case, now, state = CASES[name], 0.0, np.array(START)
    above = False
    while now < END:
        result: Any = solve(case.above if above else case.below, case.switch, now, state, -1.0 if above else 1.0)
        now, state, above = float(result.t[-1]), result.y[:, -1], not above
    return state


def go(model: Model, method: Any, **options: Any) -> Trajectory:
    return trajectory_of(model, (0.0, END), None, RunOptions(method, **options))[0]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("target", TARGETS)
def test_a_series_goes_through(name: str, target: str) -> None:
    result = go(system(name, target), "taylor")
    assert result.status is Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(truth(name), abs=2e-8)
    # The path between the steps knows the branches as well.
    middle = result.dense(np.linspace(0.0, END, 200))
    assert middle[1:, 1:-1] == pytest.approx(np.gradient(middle[0], END / 199)[None, 1:-1], abs=0.05)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("method", ["dopri5", "dop853", "radau5", "gauss2", "velocity-verlet", "scipy-lsoda"])
def test_every_other_method_goes_through(name: str, method: str) -> None:
    """Equal steps of 1e-3 pass a kink or jump with an error of the same size.

    An adaptive method detects a kink if a stage is beyond it. At an infinite slope its error is larger by a factor.
    """
    adaptive = find(method).claims.adaptive
    model = system(name)
    if method == "velocity-verlet" and name == "a speed":
        pytest.skip("a splitting takes no force that depends on velocities")
    result = go(model, method, **({"rtol": 1e-8, "atol": 1e-10} if adaptive else {"step": 1e-3}))
    assert result.status is Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(truth(name), abs=3e-5 if adaptive else 2e-2)


@pytest.mark.parametrize("target", TARGETS)
def test_the_jacobian_of_a_branch_that_is_not_taken_is_that_of_the_other(target: str) -> None:
    for name in ("an infinite slope by max", "an infinite slope", "Hertz", "Hertz by max"):
        model = system(name, target)
        assert model.jacobian(0.0, [-0.5, 0.1]).tolist() == [[0.0, 1.0], [0.0, 0.0]], name
        assert np.isfinite(model.jacobian(0.0, np.array([[-0.5] * 9, [0.1] * 9]))).all(), name


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5", "scipy-lsoda"])
def test_an_event_with_a_branch(method: str) -> None:
    """The event is the indentation, a Piecewise: zero before the contact, and largest at zero speed."""
    depth = Piecewise((x ** Rational(3, 2), x > 0), (-1, True)) - Rational(1, 64)
    model = system("Hertz")
    result = go(model, method, events=[event(depth, direction=1), event(x.dot, direction=-1)], rtol=1e-10, atol=1e-12)
    assert result.status is Status.SUCCESS, result.message
    assert len(result.t_events[0]) == len(result.t_events[1]) > 0
    assert result.y_events[0][:, 0] == pytest.approx(1 / 16, abs=1e-8)
