"""The checks of systems with constraints: faults are found; empty or dependent constraints are refused."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.equations import euler_lagrange
from lagrange.equations.constraints import ConstraintEquations, constraint_equations
from lagrange.errors import RunError
from lagrange.evidence.check import CONSTRAINT_QUANTITIES, QUANTITIES, check
from lagrange.evidence.differences import ConstraintSurface
from lagrange.evidence.precise import OutsideDomain
from lagrange.evidence.precise_run import precise_run
from lagrange.evidence.quick_check import quick_check
from lagrange.machine.model import Model
from tests.models import c, k
from tests.refusals import refusal
from tests.systems import rod_pendulum

m, g, l, a, R, J, omega = lg.parameters("m g l a R J omega")
x, y, z, phi, psi, theta = lg.coordinates("x y z phi psi theta")


def disc() -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2 + J * phi.dot**2 / 2 + J * psi.dot**2 / 3,
        constraints={"roll": x.dot - R * phi.dot * cos(psi), "side": y.dot - R * phi.dot * sin(psi)},
        forces={psi: sin(lg.t)},
    )


def mixed() -> lg.System:
    """Return a system with a holonomic constraint, a time-dependent velocity constraint, and a variable mass matrix."""
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2 + m * x * y * x.dot * y.dot / 10,
        potential=m * g * z,
        constraints={"hoop": x**2 + y**2 + z**2 - l**2, "turn": x * y.dot - y * x.dot - omega * cos(omega * lg.t) * z},
    )


def appell() -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        potential=m * g * z,
        constraints={"appell": x.dot**2 + y.dot**2 - a**2 * z.dot**2},
    )


def wire() -> lg.System:
    """Return a bead on a parabola that opens and closes in time."""
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"wire": y - a * x**2 * cos(omega * lg.t)},
        initial={x: 0.5, y: 0.1},
    )


SYSTEMS = [rod_pendulum, disc, mixed, appell, wire]


@pytest.mark.few(1)
@pytest.mark.parametrize("make", SYSTEMS, ids=lambda make: make.__name__)
def test_everything_holds(make: Callable[[], lg.System]) -> None:
    report = make().check(points=2)
    assert report, str(report)
    rows = [row.quantity for row in report.rows]
    assert rows[: len(QUANTITIES) + len(CONSTRAINT_QUANTITIES)] == [
        *QUANTITIES.values(),
        *CONSTRAINT_QUANTITIES.values(),
    ]
    assert "textbook accelerations" in rows


@pytest.mark.parametrize("make", SYSTEMS, ids=lambda make: make.__name__)
def test_the_quick_check_passes_what_is_right(make: Callable[[], lg.System], monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any) -> bool:
        raise AssertionError("a right model was taken for a suspect")

    monkeypatch.setattr("lagrange.evidence.quick_check._is_confirmed", refused)
    quick_check(make().compile(check=False))


@cache
def compiled_rod() -> Model:
    return rod_pendulum().compile()


class Wrong(Model):
    """A model with wrong quantities. `errors` maps their names to the errors that are added."""

    def __init__(self, right: Model, errors: Mapping[str, Any]) -> None:
        self.__dict__.update(right.__dict__)
        self.errors = errors

    def evaluate(self, name: str, *where: Any, **more: Any) -> Any:
        return super().evaluate(name, *where, **more) + self.errors.get(name, 0.0)

    def accelerations(self, q: Any, v: Any, *where: Any, **more: Any) -> Any:
        return super().accelerations(q, v, *where, **more) + self.errors.get("accelerations", lambda q: 0.0)(q)


@pytest.mark.few(1)
@pytest.mark.parametrize("quantity", CONSTRAINT_QUANTITIES)
def test_a_wrong_quantity_of_the_constraints_is_found(quantity: str) -> None:
    report = check(Wrong(compiled_rod(), {quantity: 1e-9}), points=1)
    assert [row.quantity for row in report.rows if not row.holds] == [CONSTRAINT_QUANTITIES[quantity]]
    assert "rod" in report.failures[0].partition(", entry ")[2].partition(":")[0]


@pytest.mark.parametrize(
    "error",
    [lambda q: 1e-9 * np.array([q[1], -q[0]]), lambda q: 1e-9 * np.array(q), lambda q: np.array([1e-9, 0.0])],
    ids=["along the constraint", "across it", "of one entry"],
)
def test_the_quick_check_finds_wrong_accelerations(error: Callable[[Any], Any]) -> None:
    with pytest.raises(RunError, match="the compiled accelerations of system are wrong"):
        quick_check(Wrong(compiled_rod(), {"accelerations": error}))


Change = Callable[[ConstraintEquations], ConstraintEquations]

BUILT_WRONG: dict[str, Change] = {
    "G negated": lambda right: replace(right, gradient=tuple(tuple(-e for e in row) for row in right.gradient)),
    "one entry of G dropped": lambda right: replace(
        right, gradient=((right.gradient[0][0].graph.zero, *right.gradient[0][1:]), *right.gradient[1:])
    ),
    "rows of G exchanged": lambda right: replace(right, gradient=right.gradient[::-1]),
    "gamma dropped": lambda right: replace(right, bias=tuple(e.graph.zero for e in right.bias)),
    "gamma halved": lambda right: replace(right, bias=tuple(e / 2 for e in right.bias)),
    "gamma negated": lambda right: replace(right, bias=tuple(-e for e in right.bias)),
    "rates scaled": lambda right: replace(right, velocities=tuple(2 * e for e in right.velocities)),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("fault", BUILT_WRONG)
def test_constraints_that_are_derived_wrong_are_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right, change = constraint_equations, BUILT_WRONG[fault]
    monkeypatch.setattr(euler_lagrange, "constraint_equations", lambda *arguments: change(right(*arguments)))
    model = mixed().compile("numpy", check=False)
    assert not check(model, points=1)
    if fault not in ("G negated", "rates scaled"):  # the accelerations of these are right
        with pytest.raises(RunError, match="the compiled accelerations of system are wrong"):
            quick_check(model)


@pytest.mark.slow
@pytest.mark.parametrize(
    "held",
    [
        {"tie": z - sin(x)},
        pytest.param({"tie": z - x, "level": y - x**2}, marks=pytest.mark.slow),
        pytest.param({"area": z.dot - x * y.dot + y * x.dot}, marks=pytest.mark.slow),
    ],
)
def test_coordinates_without_inertia_that_constraints_hold_are_checked(held: dict[str, Any]) -> None:
    """Differences give rounding errors instead of zero inertia, which must not be used as pivots."""
    system = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        coordinates=[x, y, z],
        constraints=held,
        parameters={m: 1.2, g: 9.81},
    )
    report = system.check(points=2)
    assert report, str(report)
    assert report.rows and len(report.points) == 2


def test_states_are_brought_onto_the_constraints_to_many_digits() -> None:
    system = mixed()
    surface = ConstraintSurface(system.statement)
    values = {m: 1.0, g: 9.8, l: 1.3, omega: 2.0}
    values = {p: values[p] for p in system.statement.parameters}
    q, v = surface.nearest([0.7, 0.4, -0.6], [0.2, 0.5, 0.1], 0.3, values)
    with mpmath.workdps(60):
        hoop = sum(c * c for c in q) - mpmath.mpf(1.3) ** 2
        rate = sum(c * u for c, u in zip(q, v, strict=True))
        turn = q[0] * v[1] - q[1] * v[0] - 2 * mpmath.cos(2 * mpmath.mpf(0.3)) * q[2]
    assert max(map(abs, (hoop, rate, turn))) < 1e-38  # differences with steps of 1e-20 leave an error of 1e-40


def test_states_that_no_motion_has_are_outside() -> None:
    system = lg.System(kinetic=x.dot**2 / 2 + y.dot**2 / 2, constraints={"none": x**2 + y**2 + 1})
    with pytest.raises(OutsideDomain, match="no state nearby satisfies the constraints"):
        ConstraintSurface(system.statement).nearest([0.3, 0.4], [0.0, 0.0], 0.0, {})
    with pytest.raises(RunError, match="no precise run starts here: no state nearby satisfies the constraints"):
        precise_run(system.compile(check=False), {}, 0.0, [0.3, 0.4, 0.0, 0.0], [1.0])


def test_a_precise_run_keeps_the_rod_and_agrees_with_the_angle() -> None:
    values: dict[Any, float] = {m: 1.0, g: 9.81, l: 1.0}
    held = rod_pendulum()
    free = lg.System(kinetic=m * l**2 * theta.dot**2 / 2, potential=-m * g * l * cos(theta))
    digits = 22
    (ends,) = precise_run(
        compiled_rod(), {p: values[p] for p in held.statement.parameters}, 0.0, [0.6, -0.8, 0.0, 0.0], [1.0],
        digits=digits,
    )  # fmt: skip
    with mpmath.workdps(40):
        start = mpmath.atan2(mpmath.mpf(0.6), mpmath.mpf(0.8))
        (angle,) = precise_run(
            free.compile(), {p: values[p] for p in free.statement.parameters}, 0.0, [start, 0.0], [1.0], digits=digits
        )
        off = [ends[0] - mpmath.sin(angle[0]), ends[1] + mpmath.cos(angle[0]), ends[0] ** 2 + ends[1] ** 2 - 1]
    assert max(map(abs, off)) < 1e-20  # 22 digits were asked for, and the run loses one or two


# --- empty, dependent or contradictory constraints, and motions without inertia, are refused; messages name them ---


METHODS = ("taylor", "dop853", "tsit5", "radau5")
upper, lower, s = lg.coordinates("a b s")


def system(constraints: Any, kinetic: Any = None, **options: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2 if kinetic is None else kinetic,
        potential=m * g * y,
        constraints=constraints,
        **{"parameters": {m: 1.3, g: 9.81, l: 0.7}, **options},
    )


@pytest.mark.parametrize("always", [cos(x) ** 2 + sin(x) ** 2 - 1, sin(2 * x) - 2 * sin(x) * cos(x)])
def test_a_constraint_that_is_always_true(always: Any) -> None:
    text = refusal(system, {"line": x - y, "empty": always})
    assert text == (
        "the constraint 'empty' is always true: it is zero at every state tried, and constrains nothing. Leave it out."
    )


@pytest.mark.parametrize("never", [cos(x) ** 2 + sin(x) ** 2 + 1, sin(2 * x) - 2 * sin(x) * cos(x) + 2])
def test_a_constraint_that_is_never_true(never: Any) -> None:
    text = refusal(system, {"false": never})
    assert "the constraint 'false' is never true: no coordinate and no velocity changes its value, which is 2" in text


def test_constraints_that_are_dependent_everywhere() -> None:
    text = refusal(system, {"a": x - y, "b": z, "c": 2 * x - 2 * y}, coordinates=[x, y, z])
    assert text.startswith("the constraints 'a' and 'c' are dependent here: where 'a' holds, 'c' restricts no further.")
    assert "Drop one of them" in text and "'b'" not in text
    text = refusal(system, {"a": x - y, "b": y - z, "c": x - z}, coordinates=[x, y, z])
    assert "the constraints 'a', 'b' and 'c' are dependent here: where 'a' and 'b' hold, 'c' restricts" in text


def test_a_velocity_constraint_that_is_the_rate_of_a_position() -> None:
    assert "the constraints 'place' and 'speed' are dependent" in refusal(
        system, {"place": x - y, "speed": x.dot - y.dot}
    )


def test_constraints_that_contradict_one_another() -> None:
    text = refusal(system, {"small": x**2 + y**2 - 1, "large": x**2 + y**2 - 4})
    assert text.startswith("the constraints 'small' and 'large' are dependent and contradict one another: no state was")
    # Whether they do is known only with the values of all parameters.
    assert "are dependent here" in refusal(system, {"a": x + y - c, "b": x + y - k})


def test_constraints_that_are_dependent_where_they_hold() -> None:
    stated = system({"line": x - y, "square": x**2 - y**2})
    text = refusal(stated.run, 1.0, {x: 1.0, y: 1.0}, check=False)
    assert text.startswith("the constraints 'line' and 'square' are dependent here: where 'line' holds, 'square'")


def test_a_motion_without_inertia_that_the_constraints_allow() -> None:
    text = refusal(system, {"a": x}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    assert text.startswith("a motion with y.dot = 1, z.dot = -1 satisfies the constraints and has no inertia at every")
    text = refusal(system, {"a": y - z}, m * x.dot**2 / 2, coordinates=[x, y, z])
    assert text.startswith("a motion with y.dot = 1, z.dot = 1 satisfies the constraints and has no inertia")


def test_a_singular_mass_matrix_is_no_refusal_where_the_constraints_make_it_definite() -> None:
    held = system({"a": y - z}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    assert held.run(0.1, check=False).status is lg.Status.SUCCESS


def test_one_configuration_where_constraints_are_dependent_is_named() -> None:
    bars = system({"a": x * y, "b": z - x}, m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, coordinates=[x, y, z])
    solution = bars.run(1.0, check=False)
    assert solution.status is lg.Status.SINGULAR
    assert (
        "the constraint 'a' restricts no velocity, as all its velocity derivatives vanish, at t = 0, x = 0, y = 0, "
        in (solution.message)
    )
    assert "the multipliers, and with them the accelerations, are not determined there." in solution.message
    model = bars.compile(check=False)
    with pytest.raises(RunError, match="the constraint 'a' restricts no velocity"):
        model.accelerations([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_a_configuration_without_inertia_is_named_with_the_motion() -> None:
    stated = system({"a": x - y * z}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    solution = stated.run(1.0, check=False)
    assert solution.status is lg.Status.SINGULAR
    assert "a motion with y.dot = 1, z.dot = -1 satisfies the constraints and has no inertia at t = 0, x = 0" in (
        solution.message
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_an_arm_that_is_pulled_straight_ends_with_the_configuration(method: str) -> None:
    arm = lg.System(
        kinetic=(upper.dot**2 + lower.dot**2) / 2,
        coordinates=[upper, lower],
        constraints={"reach": cos(upper) + cos(lower) - 1 - lg.t},
        initial={upper: 1.0, lower: -1.0},
    )
    solution = arm.run(3.0, arm.consistent().initial, method=method, check=False)
    assert solution.status is lg.Status.SINGULAR and solution.t[-1] == pytest.approx(1.0, abs=1e-5)
    assert "the constraint 'reach' restricts no velocity, as all its velocity derivatives vanish, there, at a = " in (
        solution.message
    )
    assert "these derivatives are" in solution.message and "their least" not in solution.message
    assert "times their values at the start, and the accelerations grow beyond all bounds." in solution.message


def test_units_do_not_matter() -> None:
    big, small = 1e9, 1e-9
    sound = system({"a": big * (x - y)}, m * (big * x.dot**2 + small * theta.dot**2) / 2, coordinates=[x, y, theta])
    assert sound.run(0.1, sound.consistent().initial, check=False).status is lg.Status.SUCCESS
    scaled = {"a": x - y, "b": 1e-9 * (x + 2 * y), "c": 1e9 * (x - y)}
    assert "the constraints 'a' and 'c' are dependent" in refusal(
        system, scaled, coordinates=[x, y, z], kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2
    )


@pytest.mark.parametrize("angle", [0.0, 0.5, 0.6435011087932844, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("method", METHODS)
def test_a_square_is_refused_whatever_rounding_leaves_of_it(angle: float, method: str) -> None:
    twice = system({"twice": (x**2 + y**2 - l**2) ** 2})
    start = {x: 0.7 * float(cos(angle)), y: -0.7 * float(sin(angle))}
    text = refusal(twice.run, 0.1, start, method=method, check=False)
    assert "the constraint 'twice' restricts no velocity, as all its velocity derivatives vanish, wherever it" in text
    flow = lg.flow(twice.compile(check=False), method=method)
    assert "state it without the square" in refusal(flow, [*start.values(), 0.0, 0.0], 0.0, 0.1)
