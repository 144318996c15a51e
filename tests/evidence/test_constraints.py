"""The checks of systems with constraints: right models pass, and each kind of fault is found."""

from collections.abc import Callable, Mapping
from dataclasses import replace
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
from lagrange.evidence.quick import quick_check
from lagrange.machine.model import Model
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

    monkeypatch.setattr("lagrange.evidence.quick._confirm", refused)
    quick_check(make().compile(check=False))


class Wrong(Model):
    """A model with wrong quantities. `errors` maps their names to the errors that are added."""

    def __init__(self, right: Model, errors: Mapping[str, Any]) -> None:
        self.__dict__.update(right.__dict__)
        self.errors = errors

    def evaluate(self, name: str, *where: Any, **more: Any) -> Any:
        return super().evaluate(name, *where, **more) + self.errors.get(name, 0.0)

    def accelerations(self, q: Any, v: Any, *where: Any, **more: Any) -> Any:
        return super().accelerations(q, v, *where, **more) + self.errors.get("accelerations", lambda q: 0.0)(q)


@pytest.mark.few(2)
@pytest.mark.parametrize("quantity", CONSTRAINT_QUANTITIES)
def test_a_wrong_quantity_of_the_constraints_is_found(quantity: str) -> None:
    report = check(Wrong(rod_pendulum().compile(), {quantity: 1e-9}), points=1)
    assert [row.quantity for row in report.rows if not row.holds] == [CONSTRAINT_QUANTITIES[quantity]]
    assert "rod" in report.failures[0].partition(", entry ")[2].partition(":")[0]


@pytest.mark.parametrize(
    "error",
    [lambda q: 1e-9 * np.array([q[1], -q[0]]), lambda q: 1e-9 * np.array(q), lambda q: np.array([1e-9, 0.0])],
    ids=["along the constraint", "across it", "of one entry"],
)
def test_the_quick_check_finds_wrong_accelerations(error: Callable[[Any], Any]) -> None:
    with pytest.raises(RunError, match="the compiled accelerations of system are wrong"):
        quick_check(Wrong(rod_pendulum().compile(), {"accelerations": error}))


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
        held.compile(), {p: values[p] for p in held.statement.parameters}, 0.0, [0.6, -0.8, 0.0, 0.0], [1.0],
        digits=digits,
    )  # fmt: skip
    with mpmath.workdps(40):
        start = mpmath.atan2(mpmath.mpf(0.6), mpmath.mpf(0.8))
        (angle,) = precise_run(
            free.compile(), {p: values[p] for p in free.statement.parameters}, 0.0, [start, 0.0], [1.0], digits=digits
        )
        off = [ends[0] - mpmath.sin(angle[0]), ends[1] + mpmath.cos(angle[0]), ends[0] ** 2 + ends[1] ** 2 - 1]
    assert max(map(abs, off)) < 1e-20  # 22 digits were asked for, and the run loses one or two
