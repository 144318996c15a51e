"""Resets under constraints: the state behind one is held to them, as an initial state is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import exp

import lagrange as lg
from lagrange.machine.backend import FloatArray
from lagrange.trajectory.constraints.nearest import Nearest, Residuals
from tests.models import g, l, m, x, y

METHODS: list[tuple[str, dict[str, Any]]] = [
    ("taylor", {}), ("dop853", {}), ("rk4", {"step": 0.01}), ("rattle", {"step": 0.01}), ("radau5-index2", {}),
    ("scipy-lsoda", {}),
]  # fmt: skip


def run(end: float, *events: lg.Event, **options: Any) -> lg.Solution:
    pendulum = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"rod": x**2 + y**2 - l**2},
        parameters={m: 1, g: 9.81, l: 1},
        initial={x: 0.6, y: -0.8},
    )
    return pendulum.run(end, events=events, **options)


@pytest.mark.few(2)
@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_reset_of_a_position_off_the_constraint_ends_the_run(method: str, options: dict[str, Any]) -> None:
    found = run(3.0, lg.event(x, direction=-1, reset={y: -0.9}), method=method, **options)
    assert found.status is lg.Status.DIVERGED
    assert found.t[-1] == found.t_events[0][0] == pytest.approx(0.5148, abs=1e-3)
    assert np.abs(found.constraint_error).max() < 1e-6
    assert "stopped at t = 0.5" in found.message
    assert "The reset where x is zero leads off the constraints: 'rod' (-l**2 + x**2 + y**2) is -0.19" in found.message
    assert "An impact changes velocities alone" in found.message


@pytest.mark.few(2)
@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_reset_of_one_velocity_of_two_ends_the_run(method: str, options: dict[str, Any]) -> None:
    found = run(3.0, lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot}), method=method, **options)
    assert found.status is lg.Status.DIVERGED
    assert "The reset where x + 0.3 is zero leads off" in found.message
    assert "'rod' (the rate of change of -l**2 + x**2 + y**2) is -1.98" in found.message


@pytest.mark.few
@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_reset_that_satisfies_the_constraint_goes_on(method: str, options: dict[str, Any]) -> None:
    """Thrown back at x = -0.3 it has the energy that it had; the path of a step may be off by its error."""
    back = lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot, y.dot: -y.dot})
    found = run(3.0, back, method=method, **options).require()
    assert len(found.t_events[0]) > 1
    assert found.y[0].min() > -0.301


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_reset_off_by_rounding_is_projected(method: str) -> None:
    found = run(3.0, lg.event(x, direction=-1, reset={x.dot: -x.dot, y: y * (1 + 1e-8)}), method=method).require()
    assert found.constraint_error.max() < (1e-13 if method == "taylor" else 1e-7)


def test_thousands_of_resets_are_checked_in_every_loop() -> None:
    """The loops that are compiled leave resets to the check: a law that fails after a while is found."""
    late = lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot, y.dot: -y.dot * (1 + 1e-15 * exp(lg.t))})
    for method in ("taylor", "dop853"):
        found = run(60.0, late, method=method)
        assert found.status is lg.Status.DIVERGED
        assert 18 < found.t[-1] < 23
        assert len(found.t_events[0]) > 12


def test_a_reset_on_the_constraints_is_not_projected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of taylor end on the constraints: where a reset does too, their residuals say so and nothing is solved."""
    back = lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot, y.dot: -y.dot})
    expected = run(3.0, back, method="taylor").require()
    monkeypatch.setattr("lagrange.trajectory.events.actions.Projection", None)
    assert (run(3.0, back, method="taylor").require().y == expected.y).all()


@pytest.mark.parametrize("off", [1e-11, 1e-6, 1e-2])
def test_the_nearest_state_is_found_without_a_search_in_round_off(off: float) -> None:
    """On a circle, by the metric of one mass: what is left to go along it is round-off of its points."""
    asked = []

    def circle(point: FloatArray) -> Residuals:
        asked.append(point)
        value, size = np.array([point @ point - 1]), np.array([point @ point + 1])
        return Residuals(value, 2 * point[None], size, size)

    found, there = Nearest(circle, np.eye(2), np.ones(2, dtype=bool)).of(np.array([0.6, 0.8]) * (1 + off))
    assert found == pytest.approx([0.6, 0.8], abs=1e-15) and there.largest < 1e-15
    assert len(asked) <= 6


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_velocities_without_inertia_follow_behind_a_reset(method: str) -> None:
    """L = (x y.dot - y x.dot)/2 - (x^2 + y^2)/2 turns with rate 1, on a circle that the reset makes half as large."""
    turning = lg.System(lagrangian=(x * y.dot - y * x.dot) / 2 - (x**2 + y**2) / 2, initial={x: 1, y: 0})
    found = turning.run(4.0, events=[lg.event(y, direction=-1, reset={x: x / 2})], method=method).require()
    assert found.t_events[0] == pytest.approx([np.pi], abs=1e-7)
    assert found.y[:2, -1] == pytest.approx([np.cos(4.0) / 2, np.sin(4.0) / 2], abs=1e-7)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_run_may_end_behind_a_reset_where_all_terms_are_round_off(method: str) -> None:
    """At x = 0 the terms of x x.dot + y y.dot are both round-off, and so is what the reset leaves of them."""
    found = run(3.0, lg.event(x, direction=-1, terminal=True, reset={x.dot: -x.dot}), method=method)
    assert found.status is lg.Status.EVENT
