"""Events that saturate: where they are flat, their series knows nothing of the zero that lies ahead."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import erfinv
from sympy import Rational, asin, atan2, erf, exp, sin, tanh

import lagrange as lg
from tests.trajectory.test_contacts import METHODS, STEPS

x = lg.coordinate("x")
THROWN = lg.System(kinetic=x.dot**2 / 2, potential=x, initial={x.dot: 10})
FREE = lg.System(kinetic=x.dot**2 / 2, potential=0, initial={x.dot: 1})
OSCILLATOR = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1})

SATURATING = [
    (erf(x - 5) - Rational(3, 10), 5 + float(erfinv(0.3))),
    (tanh(10 * (x - 5)) - Rational(1, 2), 5 + math.atanh(0.5) / 10),
    (1 / (1 + exp(-20 * (x - 5))) - Rational(3, 10), 5 + math.log(3 / 7) / 20),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("event", "level"), SATURATING, ids=["erf", "tanh", "logistic"])
def test_both_passages_are_found(method: str, event: Any, level: float) -> None:
    half = math.sqrt(100 - 2 * level)
    found = THROWN.run(20, events=[event], method=method, step=STEPS.get(method)).require()
    assert found.t_events[0] == pytest.approx([10 - half, 10 + half], rel=1e-6)
    falling = lg.event(event, direction=-1, terminal=True)
    ended = THROWN.run(20, events=[falling], method=method, step=STEPS.get(method))
    assert ended.status is lg.Status.EVENT and ended.t[-1] == pytest.approx(10 + half, rel=1e-6)


@pytest.mark.parametrize("end", [100.0, 1e6])
def test_one_step_over_a_flat_event_is_cut(end: float) -> None:
    found = FREE.run(end, events=[erf(8 * (x - 5)) - Rational(3, 10)]).require()
    assert found.t_events[0] == pytest.approx([5 + erfinv(0.3) / 8], rel=1e-12)


def test_what_jumps_is_not_what_saturates() -> None:
    """A kink of an arc sine cuts the step as well. Steps end at a cut of atan2, and none is tried again there."""
    arc = asin(sin(3 * x)) - Rational(1, 2)
    times = [OSCILLATOR.run(20, events=[arc], method=method).require().t_events[0] for method in ("taylor", "dop853")]
    assert len(times[0]) == 13 and times[0] == pytest.approx(times[1], abs=1e-5)
    angle = OSCILLATOR.run(20, events=[atan2(x.dot, x) - 1]).require()
    assert (
        angle.t_events[0] == pytest.approx(2 * np.pi * np.arange(1, 4) - 1, rel=1e-9) and angle.trajectory.rejected < 5
    )
