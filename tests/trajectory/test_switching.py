"""Switching surfaces: the run ends a step on each surface and continues on its other side, or ends with a message."""

import math
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, Max, Min, Piecewise, Rational, sign, sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import Status
from tests.models import LLVM_FIRST, TARGETS, build, x, y, z
from tests.trajectory.runs import checked_run, run


def particle(potential: Any = 0, force: Any = 0, target: str = "llvm", **initial: float) -> Model:
    return build(target, kinetic=x.dot**2 / 2, potential=potential, forces={x: force}, initial=initial)


SPRINGS = Piecewise((2 * x**2, x > 0), (x**2 / 2, True))
"""Stiffness 4 on one side and 1 on the other: half a period each."""

STOPS = 50 * Max(0, x - 1) ** 2 + 50 * Min(0, x + 1) ** 2
"""Free between -1 and 1, where springs of frequency 10 begin."""


@pytest.mark.parametrize(
    ("potential", "start", "period"),
    [
        (SPRINGS, {"x_dot": 1.0}, 1.5 * math.pi),
        (Abs(x), {"x": 1.0}, 4 * math.sqrt(2)),
        (STOPS, {"x_dot": 1.0}, 4 + math.pi / 5),
        (Abs(x) + Abs(2 * x), {"x": 1.5}, 4.0),
        (Abs(Abs(x) - 1), {"x": 1.5}, 4.0),
        (Max(x, -2 * x), {"x": 1.0}, 2 * math.sqrt(2) * 1.5),
    ],
    ids=str,
)
@pytest.mark.parametrize("target", TARGETS)
def test_a_hundred_periods(potential: Any, start: dict[str, float], period: float, target: str) -> None:
    """The motion is compared with closed forms at rtol = 1e-12. An error of speed becomes a growing error of phase."""
    count = 100 if target == "llvm" else 3
    model = particle(potential, target=target, **start)
    result = checked_run(model, count * period, rtol=1e-12)
    assert result.status is Status.SUCCESS
    assert result.y[:, -1] == pytest.approx(result.y[:, 0], abs=2e-9)
    energy = model.energy(result.y[:1], result.y[1:])
    assert np.ptp(energy) < 1e-11 * energy[0]
    back = checked_run(model, 0.0, start=3 * period, initial=start)
    assert back.y[:, -1] == pytest.approx(result.y[:, 0], abs=1e-9)


@pytest.mark.parametrize("target", TARGETS)
def test_friction_slips_by_its_law_and_sticks_in_words(target: str) -> None:
    """Each half swing from 3.2 loses an amplitude of 1.

    At 0.2 the spring is weaker than friction, and the body sticks.
    """
    model = particle(x**2 / 2, -sign(x.dot) / 2, target, x=3.2)
    slipping = checked_run(model, 9.0, [x.dot])
    assert slipping.y_events[0][:, 0] == pytest.approx([-2.2, 1.2], abs=1e-9)
    assert slipping.t_events[0] == pytest.approx([math.pi, 2 * math.pi], abs=1e-9)
    assert slipping.y[0, -1] == pytest.approx(0.5 + 0.7 * math.cos(9.0), abs=1e-9)
    stuck = checked_run(model, 20.0)
    assert stuck.status is Status.STEP_TOO_SMALL and stuck.t[-1] == pytest.approx(3 * math.pi, abs=1e-9)
    assert (
        "jump where x_dot is zero, and from t = 9.42478 on they drive x_dot back to zero from both sides"
        in stuck.message
    )
    assert "State dry friction as a contact" in stuck.message and "tanh(v/0.001) in place of sign(v)" in stuck.message
    ended = checked_run(model, 20.0, [event(x.dot, terminal=3)])
    assert ended.status is Status.EVENT and ended.y[0, -1] == pytest.approx(-0.2, abs=1e-9)


def test_sliding_to_rest() -> None:
    """Without another force the body stays at rest, with a weak force it sticks, and a strong force moves it."""
    rest = checked_run(particle(force=-2 * sign(x.dot), x_dot=4.0), 3.0)
    assert rest.status is Status.SUCCESS and rest.y[:, -1] == pytest.approx([4.0, 0.0], abs=1e-13)
    held = checked_run(particle(force=1 - 2 * sign(x.dot)), 3.0)
    assert held.status is Status.STEP_TOO_SMALL and held.t[-1] == 0.0 and "sticks there" in held.message
    pushed = Piecewise((5, t > 1), (0, True))
    moved = checked_run(particle(force=pushed - 2 * sign(x.dot)), 3.0)
    assert moved.y[:, -1] == pytest.approx([6.0, 6.0], rel=1e-12)
    strong = checked_run(particle(force=-3 - 2 * sign(x.dot)), 2.0)
    assert strong.y[:, -1] == pytest.approx([-2.0, -2.0], rel=1e-12)


def test_chattering_is_said() -> None:
    result = checked_run(particle(force=-sign(x + x.dot), x=1.0), 10.0)
    assert result.status is Status.STEP_TOO_SMALL and result.t[-1] == pytest.approx(math.sqrt(3) - 1, rel=1e-12)
    assert "jump where x + x_dot is zero" in result.message


@pytest.mark.parametrize("target", TARGETS)
def test_a_flow_knows_the_sides(target: str) -> None:
    """A flow determines the sides of surfaces, also if it never comes near one."""
    flow = flow_of(particle(Abs(x), target=target), method="taylor")
    assert flow([1.0, 0.0], 0.0, 0.5) == pytest.approx([0.875, -0.5], rel=1e-13)
    assert flow([10.0, 0.0], 0.0, 0.5) == pytest.approx([9.875, -0.5], rel=1e-13)
    assert flow([1.0, 0.0], 0.0, 4 * math.sqrt(2)) == pytest.approx([1.0, 0.0], abs=1e-12)


# --- sides at the start ---------------------------------------------------------------------------------------
# The sides on which a run starts, from the state alone: no mass matrix is asked for on sides that are not the state's.
#
# With a side of zero |v|**(3/2) has an infinite inertia, |v|**3 none, and a branch without inertia is taken.

a, b, c = x.dot, y.dot, z.dot

START = {x: 0.4, y: -0.1, z: -0.8, a: 0.7, b: 0.5, c: 0.6}

INERTIAS = {
    "a power of a speed": (1 + x / 10) * a**2 + b**2 + c**2 / 2 + a * Abs(b) ** Rational(3, 2) / 10,
    "a power of a place": (2 + sqrt(Abs(y))) * a**2 + b**2 + c**2 / 2 + a * b * Abs(x) ** Rational(-1, 4),
    "a cube": Abs(a) ** 3 / 3 + b**2 / 2 + c**2 / 2 - x**2 / 2,
    "a branch": Piecewise((a**2 / 2, x > 0), (0, True)) + b**2 / 2 + c**2 / 2 - x * y,
    "the larger": Max(x, y) * a**2 / 2 - Min(y, z) * b**2 / 2 + c**2 / 2 - x * y,
}


@pytest.mark.few(1)
@pytest.mark.parametrize("order", [20, 30, 31, 64])
@pytest.mark.parametrize("name", INERTIAS)
@pytest.mark.parametrize("target", LLVM_FIRST)
def test_the_start_is_regular_where_the_state_is(name: str, order: int, target: str) -> None:
    """The orders include some with unrolled series and some with series in loops."""
    model = build(target, lagrangian=INERTIAS[name], coordinates=[x, y, z], initial=START)
    result = run(model, 0.125, Taylor(rtol=1e-12, atol=1e-13, order=order))
    assert result.status is Status.SUCCESS, result.message
    expected = run(model, 0.125, "dop853", rtol=1e-13, atol=1e-14)
    assert result.y[:, -1] == pytest.approx(expected.y[:, -1], abs=1e-11)


@pytest.mark.parametrize("target", TARGETS)
def test_an_infinite_inertia_is_not_a_singular_one(target: str) -> None:
    """At rest |v|**(3/2) has an infinite second derivative, which is not a singular mass matrix."""
    start: dict[Any, float] = START | {b: 0.0}
    model = build(target, lagrangian=INERTIAS["a power of a speed"], coordinates=[x, y, z], initial=start)
    assert run(model, 0.125, "taylor").status is Status.NON_FINITE
    assert run(model, 0.125, "dop853").status is Status.NON_FINITE


@pytest.mark.parametrize("target", TARGETS)
def test_a_start_without_inertia_is_still_singular(target: str) -> None:
    start: dict[Any, float] = START | {a: 0.0}
    model = build(target, lagrangian=INERTIAS["a cube"], coordinates=[x, y, z], initial=start)
    assert run(model, 0.125, "taylor").status is Status.SINGULAR


def test_a_surface_that_depends_on_the_side_of_another() -> None:
    """At x = 0 the sign in |y + sign(x)| depends on the side to which x goes."""
    for speed, force in ((1.0, 1.0), (-1.0, -1.0)):
        model = build(
            kinetic=(a**2 + b**2) / 2, potential=-Abs(y + sign(x)), coordinates=[x, y], initial={a: speed, y: 0.25}
        )
        result = run(model, 1.0, "taylor")
        assert result.y[:, -1] == pytest.approx([speed, 0.25 + force / 2, speed, force], rel=1e-13)


# --- switches in time -----------------------------------------------------------------------------------------
# Forces that switch at times: every adaptive method ends its steps there, with and without events.

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


def model(force: str) -> Any:
    """Return an oscillator under a force that switches."""
    system = lg.System(
        kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: FORCES[force]}, initial={x: 0.6}, name=force
    )
    return system.compile()


@pytest.mark.few(1)
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


@pytest.mark.few
@pytest.mark.parametrize("method", METHODS)
def test_events_at_a_switch_happen_once(method: str) -> None:
    events = [lg.event(lg.t - 1), lg.event(lg.t - sp.Rational(5, 4)), lg.event(x, reset={x.dot: -x.dot / 2})]
    runs = [
        lg.integrate(model("step"), (0.0, 2.0), method=name, rtol=1e-11, events=events) for name in (method, "taylor")
    ]
    for ours, theirs in zip(*(each.t_events for each in runs), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    stopped = lg.integrate(model("step"), (0.0, 2.0), method=method, events=[lg.event(lg.t - 1, terminal=True)])
    assert stopped.t[-1] == pytest.approx(1.0, abs=1e-14)
