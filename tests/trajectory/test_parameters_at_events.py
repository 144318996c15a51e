"""Parameters that change at an event: a run that ends there, and one that goes on."""

from __future__ import annotations

import math

import pytest

import lagrange as lg

x = lg.coordinate("x")
m, k = lg.parameters("m k")


def test_a_reset_of_a_parameter_is_refused_with_what_to_do_and_that_works() -> None:
    swing = lg.System(m * x.dot**2 / 2, k * x**2 / 2, parameters={m: 1, k: 1}, initial={x: 1})
    with pytest.raises(lg.StatementError, match=r"the reset of event 0 sets the parameter k, .* terminal=True"):
        swing.run(9.0, events=[lg.event(x, reset={k: 2 * k})])
    first = swing.run(9.0, events=[lg.event(x, terminal=True)])
    after = swing.run(9.0, first.final, t_start=first.t[-1], parameters={k: 4}, events=[lg.event(x.dot, terminal=True)])
    # A quarter of a period with omega = 1, another one with omega = 2, to half the amplitude.
    assert after.t[-1] == pytest.approx(math.pi / 2 + math.pi / 4, rel=1e-9)
    assert after[x][-1] == pytest.approx(-0.5, rel=1e-9)
