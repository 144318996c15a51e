"""Results along the runs of members: states at output times, extremes and means, in lanes and in single runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.algorithm.members.reductions import largest_between, lobatto
from lagrange.machine.python_source import called
from lagrange.members import jobs

METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "tsit5": {"rtol": 1e-7},
    "rk4": {"step": 0.01},
    "forest-ruth4": {"step": 0.02},
}
"""Series, dense output by stages, by Hermite polynomials, and coordinates and velocities apart."""

STARTS = 0.4 + np.linspace(-0.2, 0.25, 21)


@cache
def pendulum() -> lg.System:
    return lg.scene("pendulum")


@cache
def oscillator() -> lg.System:
    """Return an oscillator with mass 1 and angular frequency 2: x = a cos 2t."""
    x, k = lg.coordinate("x"), lg.parameters("k")
    return lg.System(kinetic=x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 4.0})


def one_after_the_other(monkeypatch: pytest.MonkeyPatch, *args: Any, **options: Any) -> lg.Ensemble:
    """Return the ensemble without lanes: its members run one after the other."""
    with monkeypatch.context() as changed:
        changed.setattr(jobs, "lane_engine", lambda *_, **__: None)
        return lg.ensemble(*args, workers=1, **options)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.few(1)
@pytest.mark.parametrize("method", list(METHODS))
def test_states_at_output_times_are_those_of_a_run(method: str, backward: bool) -> None:
    """Output times are at both ends, repeated, several in a step, and none in some steps.

    Machine code for one state adds some terms in another order, so results differ by rounding.
    """
    times = np.array([0.0, 0.3, 0.3, 1.2, 1.2001, 1.2002, 2.9, 3.0])
    span, times = (-3.0, -times) if backward else (3.0, times)
    given: dict[str, Any] = {"t_eval": times, "method": method, **METHODS[method]}
    runs = lg.ensemble(pendulum(), span, {"theta": STARTS}, **given)
    assert "side by side" in runs.form
    for i in (0, 8, 20):
        alone = pendulum().run(span, {"theta": STARTS[i]}, **given)
        assert np.allclose(runs.y[:, :, i], alone.y, rtol=1e-13, atol=1e-14)
    ends = lg.ensemble(pendulum(), span, {"theta": STARTS}, method=method, **METHODS[method])
    assert np.array_equal(runs.y[:, -1], ends.y)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", list(METHODS))
def test_extremes_and_means_of_an_oscillator_have_closed_forms(method: str) -> None:
    """The motion is x = a cos 2t until t = 5.

    Methods with error control have a relative error of at most 1e-9. rk4 and forest-ruth4 have errors of
    (2h)**4 t / 60 and ten times this. Sampling, quadrature and search add only round-off.
    """
    (x,) = oscillator().coordinates
    keep = ("end", ("max", x), ("min", x), ("max", x.dot), ("mean", x**2), ("min", sympy.Abs(x)))
    a = np.linspace(1.0, 2.0, 11)
    runs = lg.ensemble(oscillator(), 5.0, {"x": a}, keep=keep, method=method, **METHODS[method])
    assert "side by side" in runs.form
    bound = {"rk4": 1e-7, "forest-ruth4": 1e-5, "tsit5": 1e-6}.get(method, 1e-8)
    assert np.allclose(runs["max(x)"], a, rtol=bound)
    assert np.allclose(runs["min(x)"], -a, rtol=bound)
    assert np.allclose(runs["max(x_dot)"], 2 * a, rtol=bound)
    assert np.allclose(runs["mean(x**2)"], a**2 * (0.5 + np.sin(20.0) / 40.0), rtol=bound)
    # The kink of |x| is found to 2**-27 of a step, which is at most 0.5 long and at speeds below 4.
    assert (runs["min(Abs(x))"] < 2e-8).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "rk4"])
def test_the_drift_is_that_to_the_time_of_the_end(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The potential of a driven oscillator depends on time, and its runs end early by a limit of steps."""
    x = lg.coordinate("x")
    driven = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2 - x * sympy.sin(3 * lg.t), initial={x: 1.0})
    given: dict[str, Any] = {"keep": ("drift",), "max_steps": 5, "method": method, **METHODS[method]}
    together = lg.ensemble(driven, 20.0, {"x": STARTS}, **given)
    alone = one_after_the_other(monkeypatch, driven, 20.0, {"x": STARTS}, **given)
    assert "side by side" in together.form and "one after" in alone.form
    assert set(together.status) == {lg.Status.MAX_STEPS} and np.abs(together["drift"]).min() > 1e-6
    assert np.allclose(together["drift"], alone["drift"], rtol=1e-9)


@pytest.mark.slow
def test_a_rejected_taylor_step_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A free motion meets a bump that its series do not show, so that steps beyond the bump are rejected.

    States on rejected steps, beyond the bump, must not count as extremes.
    """
    x = lg.coordinate("x")
    bump = lg.System(kinetic=x.dot**2 / 2, potential=sympy.exp(-1000 * (x - 1) ** 2) / 5, initial={x: 0.0})
    speeds = np.linspace(0.5, 1.5, 24)
    given: dict[str, Any] = {"keep": ("counts", ("max", x), ("mean", x), ("min", x.dot)), "rtol": 1e-9}
    together = lg.ensemble(bump, 3.0, {"x_dot": speeds}, **given)
    alone = one_after_the_other(monkeypatch, bump, 3.0, {"x_dot": speeds}, **given)
    rejected = together.results.column("rejected")
    assert rejected.max() > 1
    slow = speeds**2 / 2 < 0.2
    turning = 1 - np.sqrt(np.log(0.2 / (speeds[slow] ** 2 / 2)) / 1000)
    assert np.allclose(together["max(x)"][slow], turning, rtol=1e-9)
    for name in ("max(x)", "mean(x)", "min(x_dot)"):
        assert np.allclose(together.results.column(name), alone.results.column(name), rtol=1e-9, atol=1e-9)


def test_the_rule_is_exact_to_degree_15() -> None:
    points, weights = lobatto()
    assert np.array_equal(points + points[::-1], np.ones(9)) and np.array_equal(weights, weights[::-1])
    errors = [abs(weights @ points**k - 1 / (k + 1)) for k in range(17)]
    assert max(errors[:16]) < 4e-16 and errors[16] > 1e-10


@pytest.mark.parametrize(
    ("shape", "peak", "middle", "allowed"),
    [
        (lambda u: 1 - (u - 0.31) ** 2, 0.31, 0.35, 1e-15),
        (lambda u: math.sin(math.pi * u), 0.5, 0.52, 1e-15),
        (lambda u: 1 - abs(u - 0.777), 0.777, 0.7, 2e-8),
        (lambda u: 1 - (u - 0.4) ** 4, 0.4, 0.5, 1e-15),
        (lambda u: 1 - u, 0.2, 0.3, 2e-8),
    ],
)
def test_the_search_finds_the_largest_value_of_any_shape(
    shape: Callable[[float], float], peak: float, middle: float, allowed: float
) -> None:
    """The shapes are a parabola, a sine, a kink, a flat top and an end. The error is at most two resolutions."""
    search, none, places = called(largest_between.form()), np.empty(0), (0.2, middle, 0.8)
    step = (lambda u, *_: shape(u)), 0.0, 0.0, 0.0, 0, none, none, 0
    best = search(*step, 1.0, *places, *map(shape, places), -math.inf)
    assert best == pytest.approx(shape(peak), rel=0, abs=allowed)
