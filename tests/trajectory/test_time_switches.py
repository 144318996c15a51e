"""Forces that switch at times: every adaptive method ends its steps there, with and without events."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg

METHODS = ("dop853", "verner9", "tsit5", "dopri5", "radau5")
FORCES: dict[str, Any] = {
    "sawtooth": sp.Mod(lg.t, 1),
    "step": sp.Heaviside(lg.t - 1),
    "pulse": sp.Piecewise((1, lg.t < sp.Rational(1, 2)), (2, lg.t < sp.Rational(3, 2)), (0, True)),
    "square wave": sp.sign(sp.sin(3 * lg.t)),
    "two at once": sp.Heaviside(lg.t - 1) + sp.Abs(lg.t - 1) + sp.Heaviside(3 * lg.t - 3),
}
SPANS = ((0.0, 2.0), (-0.5, 3.1), (1.0, 2.5), (0.0, 1.0), (2.5, -1.0))
"""Spans that begin or end on a surface, have it inside, and lead backwards."""

x = lg.coordinate("x")


def model(force: str) -> Any:
    """Return an oscillator under a force that switches."""
    system = lg.System(
        kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: FORCES[force]}, initial={x: 0.6}, name=force
    )
    return system.compile()


@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize("force", FORCES)
def test_no_step_has_a_switch_inside(force: str, span: tuple[float, float]) -> None:
    compiled, times = model(force), np.linspace(*span, 701)
    expected = lg.integrate(compiled, span, rtol=1e-13, t_eval=times).y
    for method in METHODS:
        run = lg.integrate(compiled, span, method=method, rtol=1e-11, atol=1e-11)
        # Steps of a thousandth of the run have far smaller errors; one over a jump of 1 has 1e-10 and more.
        np.testing.assert_allclose(run.trajectory.dense(times), expected, rtol=0, atol=2e-12, err_msg=method)
        assert run.trajectory.rejected <= 2, method
        assert (np.diff(run.t) * (span[1] - span[0]) > 0).all()
        written = lg.integrate(compiled, span, method=method, rtol=1e-11, atol=1e-11, t_eval=times)
        np.testing.assert_allclose(written.y, expected, rtol=0, atol=2e-12, err_msg=method)


@pytest.mark.parametrize("method", METHODS)
def test_events_at_a_switch_happen_once(method: str) -> None:
    events = [lg.event(lg.t - 1), lg.event(lg.t - sp.Rational(5, 4)), lg.event(x, reset={x.dot: -x.dot / 2})]
    runs = [
        lg.integrate(model("step"), (0.0, 2.0), method=name, rtol=1e-11, events=events) for name in (method, "taylor")
    ]
    for ours, theirs in zip(*(run.t_events for run in runs), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    stopped = lg.integrate(model("step"), (0.0, 2.0), method=method, events=[lg.event(lg.t - 1, terminal=True)])
    assert stopped.t[-1] == pytest.approx(1.0, abs=1e-14)
