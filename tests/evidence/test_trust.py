"""The time for which a run claims to be right, compared with its known error."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.evidence.precise_run import precise_run
from tests.models import build, model, shared_scene, x

OSCILLATOR = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0}, name="oscillator")


def test_euler_on_an_oscillator_holds_as_long_as_its_formula_says() -> None:
    """Euler's solution is x + iv = (1 - ih)^n. The claimed time may be shorter by the safety factor, but not longer."""
    h, error = 1e-3, 1e-2
    horizon = lg.trust_horizon(OSCILLATOR, (0.0, 100.0), error=error, method="euler", step=h)
    n = np.arange(round(100 / h))
    off = (1 - 1j * h) ** n - np.exp(-1j * h * n)
    apart = np.maximum(abs(off.real), abs(off.imag))
    until = {level: h * int(np.argmax(apart > level)) for level in (error / 20, error)}
    assert until[error / 20] <= float(horizon) <= until[error]
    assert not horizon.complete and "not known" in repr(horizon)


def test_a_run_that_holds_to_its_end_says_so() -> None:
    horizon = lg.trust_horizon(OSCILLATOR, (0.0, 10.0), error=1e-6)
    result = lg.integrate(OSCILLATOR, (0.0, 10.0))
    wrong = np.abs(result["x"] - np.cos(result.t)).max()
    assert horizon.complete and horizon.time == 10.0
    assert wrong <= horizon.bounds[-1] <= 1e-6
    assert "until the end" in repr(horizon)
    assert (lg.trust_horizon(OSCILLATOR, 10.0, error=1e-6).bounds == horizon.bounds).all()
    backwards = lg.trust_horizon(OSCILLATOR, (0.0, -10.0), error=1e-6)
    assert backwards.complete and backwards.time == -10.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_it_is_not_over_claimed(seed: int) -> None:
    """Random starts of a chaotic double pendulum are compared with runs in multiple precision."""
    rng = np.random.default_rng(seed)
    pendulum = model("double pendulum")
    start = [*rng.uniform(-math.pi, math.pi, 2), *rng.uniform(-6.0, 6.0, 2)]
    initial = dict(zip(("a0", "a1", "a0_dot", "a1_dot"), start, strict=True))
    options: dict[str, Any] = {"method": "dop853", "rtol": 1e-6, "atol": 1e-6}
    horizon = lg.trust_horizon(pendulum, (0.0, 20.0), initial, error=1e-3, **options)
    times = [horizon.time / 2, horizon.time]
    truth = precise_run(pendulum, pendulum.parameter_values(), 0.0, start, times, digits=18)
    run = lg.integrate(pendulum, (0.0, 20.0), initial, **options)
    errors = [
        np.abs(run.at(t) - [float(value) for value in right]).max() for t, right in zip(times, truth, strict=True)
    ]
    assert 0.5 < horizon.time < 20.0
    assert max(errors) <= 1e-3
    assert errors[1] > 1e-3 / 200  # nor so timid that it says nothing


def test_rounding_is_part_of_it() -> None:
    """At the smallest tolerance the growth of rounding errors is still detected."""
    initial = {"a0": 2.0, "a1": 2.5}
    pendulum = model("double pendulum")
    tight = {
        method: lg.trust_horizon(pendulum, (0.0, 60.0), initial, method=method, rtol=1e-15, atol=1e-16)
        for method in ("taylor", "dop853")
    }
    for horizon in tight.values():
        assert not horizon.complete
        assert len(horizon.witnesses) == 3 and horizon.witnesses[-1].endswith("from a start put off")
    a, b = (lg.integrate(pendulum, (0.0, 60.0), initial, method=m, rtol=1e-15, atol=1e-16) for m in tight)
    common = np.linspace(0.0, min(float(horizon) for horizon in tight.values()), 50)
    assert np.abs(a.at(common) - b.at(common)).max() <= 2e-3


def test_relative_errors_follow_the_size_of_the_state() -> None:
    small: dict[str, Any] = {"initial": {x: 1e-20}, "atol": 1e-40}
    assert lg.trust_horizon(OSCILLATOR, (0.0, 10.0), error=1e-6, relative=True, **small).complete
    coarse = lg.trust_horizon(OSCILLATOR, (0.0, 10.0), {x: 1e-20}, error=1e-6, relative=True, method="euler", step=0.1)
    assert coarse.time < 0.1
    assert lg.trust_horizon(OSCILLATOR, (0.0, 10.0), {x: 1e-20}, error=1e-6, method="euler", step=0.1).complete


def test_it_ends_where_the_motion_does() -> None:
    pole = build(kinetic=x.dot**2 / 2, potential=-2 * x**3, initial={x: 1.0, x.dot: 2.0}, name="pole")
    horizon = lg.trust_horizon(pole, (0.0, 5.0), error=1e-3)
    assert not horizon.complete and 0.8 < horizon.time < 1.0


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"error": 0.0}, "error = 0: give a positive one"),
        ({"error": math.nan}, "error is nan"),
        ({"method": "rk5"}, "no method 'rk5'"),
    ],
)
def test_what_cannot_be_meant_is_refused(request_: dict[str, Any], words: str) -> None:
    with pytest.raises(lg.StatementError, match=words):
        lg.trust_horizon(OSCILLATOR, (0.0, 1.0), **request_)


def test_it_takes_a_system_too() -> None:
    assert lg.trust_horizon(shared_scene("pendulum"), (0.0, 1.0)).complete
    untyped: Any = lg.trust_horizon
    for given in ("pendulum", lg.System):
        with pytest.raises(lg.StatementError, match="is not a system: give an"):
            untyped(given, (0.0, 1.0))
