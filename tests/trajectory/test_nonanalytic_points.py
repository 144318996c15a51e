"""Points without a Taylor series, and branches of a Piecewise that do not apply."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from sympy import Abs, Max, Piecewise, Rational, log, sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import LLVM_FIRST, TARGETS, build, x, y, z
from tests.trajectory.runs import checked_run

G, C = 9.81, 0.1
LIMIT = math.sqrt(G / C)
"""The speed at which drag and weight of a unit mass are equal."""

speed = sqrt(x.dot**2 + y.dot**2)


def thrown() -> lg.System:
    """Return a unit mass in the plane with drag against the square of its speed."""
    drag = {x: -C * speed * x.dot, y: -C * speed * y.dot}
    return lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=G * y, forces=drag, name="thrown")


def fallen(time: Any) -> Any:
    """Return the height after a fall from rest."""
    return -(LIMIT**2) / G * np.log(np.cosh(G * time / LIMIT))


@pytest.mark.parametrize("target", LLVM_FIRST)
def test_drag_from_rest(target: str) -> None:
    model = thrown().compile(target=target)
    result = lg.integrate(model, (0.0, 5.0), {}, rtol=1e-12, atol=1e-14)
    assert result.status is lg.Status.SUCCESS
    # A step's tolerance is a tenth of 1e-12 of some 30 m; the first millionth of the run is DOP853's, as exact.
    times = np.linspace(0.0, 5.0, 301)
    assert result.at(times)[1] == pytest.approx(fallen(times), rel=1e-11, abs=1e-13)
    # On the leap itself, 5e-6 s long, the path is a cubic with the right slopes.
    times = np.linspace(0.0, 5e-6, 11)
    assert result.at(times)[3] == pytest.approx(-G * times, rel=1e-9, abs=1e-15)


def touching(*bodies: Any) -> Any:
    """Return the potential of Hertz's contact forces in a row of equal balls."""
    return sum(Piecewise(((p - q) ** Rational(5, 2), p > q), (0, True)) for p, q in pairwise(bodies))


@pytest.mark.few(1)
@pytest.mark.parametrize("start", [{x.dot: 1.0}, {x: -0.1, x.dot: 1.0}, {x: 0.2}, {x: -0.1, z: 0.1, x.dot: 1.0}])
def test_what_is_at_rest_is_hit(start: Any) -> None:
    """A body at rest is hit: its force grows with a power of time, and there is no velocity to compare it with."""
    balls = lg.System(kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2, potential=touching(x, y, z), coordinates=[x, y, z])
    result, right = balls.run(5.0, start), balls.run(5.0, start, method="dop853", rtol=1e-12, atol=1e-13)
    assert result.status is right.status is lg.Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(right.y[:, -1], abs=1e-8)


@pytest.mark.few(1)
@pytest.mark.parametrize("force", [1 / sqrt(x - y), log(x - y)])
def test_no_leap_into_a_force_that_is_infinite_where_it_begins(force: Any) -> None:
    balls = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y], forces={y: Piecewise((force, x > y), (0, True))}
    )
    result = balls.run(5.0, {x: -0.1, x.dot: 1.0})
    assert not result.status.complete and result.t[-1] == pytest.approx(0.1)


@pytest.mark.parametrize("events", [None, [y.dot], [lg.event(y.dot, direction=-1)]])
def test_straight_up_and_down_again(events: Any) -> None:
    """At the turning point the speed is the square root of zero; an event may be at the same point."""
    up = 10.0
    result = thrown().run(5.0, {y.dot: up}, events=events, rtol=1e-12, atol=1e-14)
    turn = LIMIT / G * math.atan(up / LIMIT)
    height = LIMIT**2 / (2 * G) * math.log1p((up / LIMIT) ** 2)
    assert result.status is lg.Status.SUCCESS
    assert result[y][-1] == pytest.approx(height + fallen(5.0 - turn), rel=1e-10)
    if events:
        assert result.t_events[0] == pytest.approx([turn], rel=1e-11)


SQUARE = x**2 - 2 * x * y + y**2
"""The square of x - y, which is not a square to see."""


@pytest.mark.few(1)
@pytest.mark.parametrize("force", [-(sqrt(SQUARE) - 1) * (x - y) / sqrt(SQUARE), -(x - y) * (1 - 1 / sqrt(SQUARE))])
def test_a_force_that_jumps_is_not_leapt_over(force: Any) -> None:
    """The ends of a spring of length 1 pass through each other, and its force changes sign.

    Until then x - y = 1 - 2 sin t, for a mass at y that does not move.
    """
    result = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, forces={x: force}).run(5.0, {x: 1.0, x.dot: -2.0})
    assert result.status is lg.Status.NON_FINITE
    assert result.t[-1] == pytest.approx(math.asin(0.5), rel=1e-8)
    assert "sqrt(x**2 - 2*x*y + y**2) becomes zero there" in result.message and "as abs" in result.message


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("potential", "stated"),
    [
        (x ** Rational(4, 3), "x**(1/3)"),
        (x ** Rational(5, 2), "x**(3/2)"),
        ((x - 1) ** Rational(5, 3), "(x - 1)**(2/3)"),
        ((x - 1) ** Rational(3, 2) + x, "sqrt(x - 1)"),
    ],
)
def test_the_message_names_the_power_that_becomes_zero(potential: Any, stated: str) -> None:
    result = lg.System(x.dot**2 / 2, potential).run(8.0, {x: 1.5, x.dot: -1.0})
    assert result.status is lg.Status.NON_FINITE and f" {stated} becomes zero there" in result.message


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("square", "absolute"),
    [
        (x**2, Abs(x)),
        (4 * x**2, 2 * Abs(x)),
        ((1 - x) ** 2 / 9, Abs(x - 1) / 3),
        ((x * (2 + x)) ** 2, Abs(x) * Abs(2 + x)),
        (x**6, Abs(x) ** 3),
    ],
)
def test_the_root_of_a_square_is_an_absolute_value(square: Any, absolute: Any) -> None:
    """sqrt(x**2) is abs(x): the motion passes x = 0, where the force jumps, at full order."""
    system = lg.System(kinetic=x.dot**2 / 2, potential=sqrt(square))
    result = system.run(5.0, {x: 1.25}, rtol=1e-12, atol=1e-14)
    truth = lg.System(kinetic=x.dot**2 / 2, potential=absolute).run(5.0, {x: 1.25}, rtol=1e-12, atol=1e-14)
    assert result.status is lg.Status.SUCCESS and result.steps == truth.steps
    assert result.y[:, -1] == pytest.approx(truth.y[:, -1], abs=1e-12)
    assert system.check()


# --- cuts of angles --------------------------------------------------------------------------------------------
# Runs across the cut of atan2 (y = 0, x < 0), where its value jumps by 2 pi: a switching surface.

ANGLE = sp.atan2(y, x)

LAWS: list[tuple[Any, Any, Callable[[float], tuple[float, float]]]] = [
    (sp.sign(ANGLE) / 10, 0, lambda a: (math.copysign(0.1, a), 0.0)),
    (ANGLE, -ANGLE, lambda a: (a, -a)),
    (sp.Abs(ANGLE - 1), -y, lambda a: (abs(a - 1), math.nan)),
    (-x + sp.Max(ANGLE, -2) / 5, -y, lambda a: (max(a, -2.0) / 5, math.nan)),
]
"""Forces along x and y, and by hand what the angle contributes; where nan stands, y is on a spring."""

STARTS = [([-1.0, 0.5, 0.0, -1.0], 1.5), ([-1.0, 0.5, 0.1, -0.7], 4.0), ([-2.0, -0.3, 0.3, 0.4], 6.0)]


def particle(force_x: Any = 0, force_y: Any = 0, target: str = "llvm", **options: Any) -> Model:
    forces = {x: force_x, y: force_y}
    return build(target, **{"kinetic": (x.dot**2 + y.dot**2) / 2, "forces": forces, "coordinates": [x, y], **options})


def state(values: Any) -> dict[Any, float]:
    return dict(zip((x, y, x.dot, y.dot), values, strict=True))


def by_hand(law: tuple[Any, Any, Callable[[float], tuple[float, float]]], start: list[float], end: float) -> Any:
    """Return the end state by SciPy, integrated from one crossing of y = 0 to the next.

    Between two crossings the angle is continued smoothly to x < 0.
    """
    sprung = law[0].has(sp.Max)
    z0, now, side = np.array(start), 0.0, math.copysign(1.0, start[1])

    def slope(_: float, z: Any) -> list[float]:
        angle = math.atan2(z[1], z[0]) if z[0] > 0 else side * math.pi - math.atan2(z[1], -z[0])
        along, across = law[2](angle)
        return [z[2], z[3], along - sprung * z[0], -z[1] if math.isnan(across) else across]

    def crossing(_: float, z: Any) -> float:
        return float(z[1])

    crossing.__dict__["terminal"] = True
    while now < end:
        crossing.__dict__["direction"] = -side
        part = solve_ivp(slope, (now, end), z0, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.02, events=crossing)
        now, z0, side = part.t[-1], part.y[:, -1], -side if part.status == 1 else side
    return z0


@pytest.mark.few(1)
@pytest.mark.parametrize(("start", "end"), STARTS, ids=["once", "over", "up"])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: str(law[0]))
def test_a_force_jumps_where_the_angle_does(law: Any, start: list[float], end: float) -> None:
    """The tolerance of 1e-8 is the error of the reference solution at kinks."""
    expected = by_hand(law, start, end)
    for target in TARGETS:
        result = checked_run(particle(law[0], law[1], target), end, initial=state(start), rtol=1e-12)
        assert result.status is Status.SUCCESS
        assert result.y[:, -1] == pytest.approx(expected, abs=1e-8)
        back = checked_run(particle(law[0], law[1], target), 0.0, start=end, initial=state(result.y[:, -1]), rtol=1e-12)
        assert back.y[:, -1] == pytest.approx(start, abs=1e-8)


@pytest.mark.parametrize(("speed", "angle"), [(1.0, math.pi), (-1.0, -math.pi)])
@pytest.mark.parametrize("height", [0.0, -0.0])
def test_a_start_on_the_cut(speed: float, angle: float, height: float) -> None:
    """On the cut the angle has the value of the side to which the motion leaves."""
    result = checked_run(particle(ANGLE), 1e-6, initial={x: -1.0, y: height, y.dot: speed})
    assert result.y[2, -1] == pytest.approx(angle * 1e-6, rel=1e-6) and result.steps < 5


def test_a_motion_that_sticks_to_the_cut_says_so() -> None:
    result = checked_run(particle(sp.atan2(-x.dot, -1)), 4.0, initial={x.dot: 1.0})
    assert result.status is Status.STEP_TOO_SMALL and result.y[2, -1] == pytest.approx(0, abs=1e-12)
    assert "The equations of motion jump where -x_dot is zero" in result.message and "sticks" in result.message


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
def test_a_potential_that_is_periodic_in_the_angle_is_smooth(target: str) -> None:
    """cos(3 a) has no jump on the cut. The run equals that of the same potential written as a polynomial in x and y."""
    r2 = x**2 + y**2
    circle = {x: 1.0, y.dot: 1.1}
    ends = []
    for wave in (sp.cos(3 * ANGLE), (x**3 - 3 * x * y**2) / sp.sqrt(r2) ** 3):
        model = particle(target=target, potential=wave / 30 - 1 / sp.sqrt(r2))
        assert model.series()[0].program.sides == 0
        ends.append(checked_run(model, 10.0, initial=circle, rtol=1e-12).y[:, -1])
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@pytest.mark.parametrize("period", [2.0, 2.1])
def test_zeros_behind_a_jump_of_an_event_are_on_its_step_too(period: float) -> None:
    """A step of length about 2 contains a jump of Mod(t, period) and a zero after it."""
    u = lg.coordinate("u")
    swing = lg.System(u.dot**2 / 2, u**2 / 2, initial={u: 1.0})
    run = swing.run(8.5, events=[sp.Mod(lg.t, period) - 1])
    expected = np.arange(1.0, 8.5, period)
    # Steps end there, and times of zeros have 14 digits.
    assert run.t_events[0] == pytest.approx(expected, abs=1e-9)


# --- A branch of a Piecewise that does not apply is never evaluated, by any method -----------------------------
# The reference is SciPy's DOP853 on each interval between two switches, with equations without branches.


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


def run_case(model: Model, method: Any, **options: Any) -> Trajectory:
    return trajectory_of(model, (0.0, END), None, RunOptions(method, **options))[0]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("target", TARGETS)
def test_a_series_goes_through(name: str, target: str) -> None:
    result = run_case(system(name, target), "taylor")
    assert result.status is Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(truth(name), abs=2e-8)
    # The path between the steps knows the branches as well.
    middle = result.dense(np.linspace(0.0, END, 200))
    assert middle[1:, 1:-1] == pytest.approx(np.gradient(middle[0], END / 199)[None, 1:-1], abs=0.05)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("method", ["dopri5", "dop853", "radau5", "gauss2", "velocity-verlet", "scipy-lsoda"])
def test_every_other_method_goes_through(name: str, method: str) -> None:
    """Fixed steps of 1e-3 pass a kink or jump with an error of the same size.

    An adaptive method detects a kink if a stage is beyond it. At an infinite slope its error is larger by a factor.
    """
    adaptive = find(method).claims.adaptive
    model = system(name)
    if method == "velocity-verlet" and name == "a speed":
        pytest.skip("a splitting takes no force that depends on velocities")
    result = run_case(model, method, **({"rtol": 1e-8, "atol": 1e-10} if adaptive else {"step": 1e-3}))
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
    result = run_case(
        model, method, events=[event(depth, direction=1), event(x.dot, direction=-1)], rtol=1e-10, atol=1e-12
    )
    assert result.status is Status.SUCCESS, result.message
    assert len(result.t_events[0]) == len(result.t_events[1]) > 0
    assert result.y_events[0][:, 0] == pytest.approx(1 / 16, abs=1e-8)
