"""Methods with multipliers among their unknowns, on systems with constraints: each against its claims."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, parameters, t
from lagrange.trajectory.integrator import Claims
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.index2 import STAGES, radau5_index2
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build
from tests.trajectory.runs import CONSTRAINED, CONTROLLED, EQUAL, implicit, run

x, y, z, a, b, x1, y1, x2, y2 = coordinates("x y z a b x1 y1 x2 y2")
m, g, l, c = parameters("m g l c")
VALUES = {m: 1.3, g: 9.81, l: 0.7, c: 0.15}
HOLONOMIC = tuple(name for name in CONSTRAINED if implicit(name).holonomic)
SYMPLECTIC = tuple(name for name in CONSTRAINED if find(name).claims.symplectic)


# --- systems --------------------------------------------------------------------------------------------------


def pendulum() -> dict[str, Any]:
    """A pendulum in Cartesian coordinates, released at 2 radians."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"rod": x**2 + y**2 - l**2},
        "initial": {x: 0.7 * np.sin(2.0), y: -0.7 * np.cos(2.0)},
    }


def pumped() -> dict[str, Any]:
    """A pendulum whose rod changes its length in time, with friction."""
    length, change = 0.7, 0.2 * 3.0
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "dissipation": c * (x.dot**2 + y.dot**2) / 2,
        "forces": {x: cos(2 * t)},
        "constraints": {"rod": x**2 + y**2 - (l + sin(3 * t) / 5) ** 2},
        "initial": {
            x: length * np.sin(1.0), y: -length * np.cos(1.0),
            x.dot: change * np.sin(1.0), y.dot: -change * np.cos(1.0),
        },
    }  # fmt: skip


def spherical() -> dict[str, Any]:
    """A spherical pendulum in Cartesian coordinates."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        "potential": m * g * z,
        "constraints": {"rod": x**2 + y**2 + z**2 - l**2},
        "initial": {x: 0.7 * np.sin(1.2), z: -0.7 * np.cos(1.2), y.dot: 1.5},
    }


def double_pendulum() -> dict[str, Any]:
    """Two rods in Cartesian coordinates."""
    state = from_angles(np.array([1.2, -0.5, 0.3, 0.8]))
    symbols = (x1, y1, x2, y2, x1.dot, y1.dot, x2.dot, y2.dot)
    return {
        "kinetic": m * (x1.dot**2 + y1.dot**2 + x2.dot**2 + y2.dot**2) / 2,
        "potential": m * g * (y1 + y2),
        "coordinates": [x1, y1, x2, y2],
        "constraints": {"upper": x1**2 + y1**2 - l**2, "lower": (x2 - x1) ** 2 + (y2 - y1) ** 2 - l**2},
        "initial": dict(zip(symbols, state, strict=True)),
    }


def guided() -> dict[str, Any]:
    """A double pendulum in angles, whose mass matrix moves, with its tip at one height."""
    second = float(np.arccos(1.2 / 0.7 - np.cos(0.4)))
    rate = -np.sin(0.4) * 0.9 / np.sin(second)
    return {
        **angles(),
        "constraints": {"guide": l * cos(a) + l * cos(b) - 1.2},
        "initial": {a: 0.4, b: second, a.dot: 0.9, b.dot: float(rate)},
    }


def angles() -> dict[str, Any]:
    """The double pendulum in angles."""
    return {
        "kinetic": m * l**2 * (2 * a.dot**2 + b.dot**2 + 2 * a.dot * b.dot * cos(a - b)) / 2,
        "potential": -m * g * l * (2 * cos(a) + cos(b)),
        "coordinates": [a, b],
        "initial": {a: 1.2, b: -0.5, a.dot: 0.3, b.dot: 0.8},
    }


def sleigh() -> dict[str, Any]:
    """Chaplygin's sleigh on an incline: a knife edge, which is a constraint of velocities."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2 + m * a.dot**2 / 5,
        "potential": m * g * y / 3 + m * cos(a) / 7,
        "coordinates": [x, y, a],
        "constraints": {"edge": x.dot * sin(a) - y.dot * cos(a)},
        "initial": {a: 0.3, x.dot: np.cos(0.3), y.dot: np.sin(0.3), a.dot: 0.8},
    }


def from_angles(state: FloatArray) -> FloatArray:
    """Return the Cartesian state of a double pendulum of a state in angles."""
    p, q, pv, qv = state
    upper, rate = np.array([np.sin(p), -np.cos(p)]), np.array([np.cos(p), np.sin(p)]) * pv
    lower, other = np.array([np.sin(q), -np.cos(q)]), np.array([np.cos(q), np.sin(q)]) * qv
    return 0.7 * np.concatenate([upper, upper + lower, rate, rate + other])


SYSTEMS = {one.__name__: one for one in (pendulum, pumped, spherical, double_pendulum, guided)}


@cache
def system(name: str, target: str = "llvm") -> Model:
    stated = sleigh() if name == "sleigh" else SYSTEMS[name]()
    return build(target, parameters=VALUES, **stated) if "dissipation" in stated else build(target, **stated)


def equal(name: str) -> Any:
    """Return a method with equal steps; of an adaptive one the step without its error."""
    method = implicit(name)
    if method.control is None:
        return method
    return ImplicitMethod(
        f"{name}-equal", Claims(method.claims.order, explicit=False), without_error(method.function), law=method.law
    )


@cache
def without_error(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *given: function(*given)[:2]


def held(compiled: Model, found: Any) -> tuple[FloatArray, FloatArray]:
    """Return the sizes of phi and of psi along a run."""
    count, n = len(compiled.equations.constraints), compiled.dimension
    both = np.abs(compiled.evaluate("constraints", found.y[:n], found.y[n:], found.t))
    return both[:count], both[count:]


# --- claims ---------------------------------------------------------------------------------------------------

COUNTS = tuple(round(32 * 2 ** (i / 2)) for i in range(12))
"""Numbers of steps, from 32 to 1448, by factors of the square root of 2."""
FLOOR = 2e-11
"""Errors below this are left out: round-off, some 1e-13, would move a measured order where they double."""


@cache
def truth(name: str, end: float = 1.0) -> FloatArray:
    last: FloatArray = run(system(name), end, Taylor(rtol=1e-15, atol=1e-15)).y[:, -1]
    return last


@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
@pytest.mark.parametrize("method", CONSTRAINED)
def test_the_observed_order_is_the_claimed_one(method: str, name: str) -> None:
    """With constraints that move, friction, explicit time, and a mass matrix that moves."""
    if name == "sleigh" and method in HOLONOMIC:
        pytest.skip("is for constraints on coordinates")
    compiled, end = system(name), {"sleigh": 3.0, "guided": 4.0}.get(name, 1.0)
    kept: list[tuple[int, float]] = []
    for n in COUNTS:
        error = np.abs(run(compiled, end, equal(method), step=end / n).y[:, -1] - truth(name, end)).max()
        if error < FLOOR:
            break
        kept.append((n, error))
    counts, errors = zip(*kept[-3:], strict=True)
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(find(method).claims.order, abs=0.2), kept


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_hold_to_round_off_at_every_step(method: str, name: str, target: str) -> None:
    """Terms of phi are of size 2 and those of psi of size 10: 32 units of their round-off."""
    compiled = system(name, target)
    phi, psi = held(compiled, run(compiled, 2.0, method, step=0.02))
    assert phi.max() < 2 * 32 * 2.0**-52 and psi.max() < 10 * 32 * 2.0**-52


@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_hold_after_many_steps(method: str) -> None:
    compiled = system("spherical")
    phi, psi = held(compiled, run(compiled, 1000.0, method, step=0.02))
    assert phi.shape == (1, 50_001) and phi[:, -1000:].max() < 2 * 32 * 2.0**-52 and psi.max() < 10 * 32 * 2.0**-52


@pytest.mark.parametrize("method", HOLONOMIC)
def test_the_double_pendulum_is_that_in_angles(method: str) -> None:
    compiled, free, count = system("double_pendulum"), build(**angles()), {2: 20_000, 4: 1000}
    expected = from_angles(run(free, 1.0, Taylor(rtol=1e-15, atol=1e-15)).y[:, -1])
    found = run(compiled, 1.0, method, step=1 / count[find(method).claims.order])
    assert found.y[:, -1] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["pendulum", "spherical", "double_pendulum", "guided"])
@pytest.mark.parametrize("method", HOLONOMIC)
def test_what_claims_to_be_symmetric_runs_back(method: str, name: str) -> None:
    compiled = system(name)
    there = run(compiled, 1.0, method, step=0.02)
    names = (*compiled.statement.names, *(f"{one}_dot" for one in compiled.statement.names))
    back = run(compiled, 0.0, method, start=1.0, step=0.02, initial=dict(zip(names, there.y[:, -1], strict=True)))
    assert find(method).claims.symmetric and np.abs(back.y[:, -1] - there.y[:, 0]).max() < 1e-11


def test_radaus_step_is_not_symmetric() -> None:
    compiled, method = system("pendulum"), equal("radau5-index2")
    there = run(compiled, 1.0, method, step=0.04)
    start = dict(zip(("x", "y", "x_dot", "y_dot"), there.y[:, -1], strict=True))
    back = run(compiled, 0.0, method, start=1.0, step=0.04, initial=start)
    assert not find("radau5-index2").claims.symmetric and np.abs(back.y[:, -1] - there.y[:, 0]).max() > 1e-7


# --- the symplectic form, in reduced coordinates ---------------------------------------------------------------


def canonical(state: FloatArray) -> FloatArray:
    """Return angles and their momenta of the Cartesian double pendulum."""
    q, v = np.split(state, 2)
    rods = [(q[:2], v[:2], v[:2] + v[2:]), (q[2:] - q[:2], v[2:] - v[:2], v[2:])]
    turns = [np.arctan2(rod[0], -rod[1]) for rod, _, _ in rods]
    momenta = [1.3 * (np.array([-rod[1], rod[0]]) @ total) for rod, _, total in rods]
    return np.array([*turns, *momenta])


def cartesian(canonical: FloatArray) -> FloatArray:
    """Return the Cartesian state of angles and momenta."""
    turns, momenta = np.split(canonical, 2)
    c = np.cos(turns[0] - turns[1])
    return from_angles(np.concatenate([turns, np.linalg.solve(1.3 * 0.49 * np.array([[2, c], [c, 1]]), momenta)]))


def reduced_step(method: Any, h: float, point: FloatArray) -> FloatArray:
    compiled = system("double_pendulum")
    names = (*compiled.statement.names, *(f"{one}_dot" for one in compiled.statement.names))
    start = dict(zip(names, cartesian(point), strict=True))
    return canonical(run(compiled, h, method, step=h, initial=start).y[:, -1])


def defect(method: Any, h: float) -> float:
    """Return how far J^T W J is from W for the Jacobian J of a step; differences in d^6 leave about 1e-11."""
    point, d, columns = canonical(from_angles(np.array([1.2, -0.5, 0.3, 0.8]))), 2e-2, []
    for e in np.eye(4):
        rows = [
            (reduced_step(method, h, point + s * e) - reduced_step(method, h, point - s * e)) / (2 * s)
            for s in (d, d / 2, d / 4, d / 8)
        ]
        for power in (4, 16, 64):
            rows = [(power * near - far) / (power - 1) for far, near in itertools.pairwise(rows)]
        columns.append(rows[0])
    jacobian, w = np.array(columns).T, np.kron(np.array([[0, 1], [-1, 0]]), np.eye(2))
    return float(np.abs(jacobian.T @ w @ jacobian - w).max())


@pytest.mark.parametrize("method", CONSTRAINED)
def test_what_claims_to_be_symplectic_keeps_the_form_of_the_reduced_system(method: str) -> None:
    error = defect(equal(method), 0.1)
    assert error < 1e-9 if find(method).claims.symplectic else error > 1e-6


@pytest.mark.parametrize("method", SYMPLECTIC)
def test_energy_stays_bounded_without_drift(method: str) -> None:
    """Some 600 swings of 50 steps."""
    compiled = system("spherical")
    found = run(compiled, 600.0, method, step=0.02)
    energy = compiled.energy(found.y[:3], found.y[3:])
    error = energy - energy[0]
    halves = [np.abs(half).max() for half in np.array_split(error, 2)]
    assert found.status is Status.SUCCESS and halves[1] < 1.1 * halves[0] < 0.1
    means = [part.mean() for part in np.array_split(error, 10)]
    assert np.ptp(means) < 0.1 * np.abs(error).max()


# --- index 2 --------------------------------------------------------------------------------------------------


class Newton:
    """What a step function gets as `solve`, in doubles; it keeps the unknowns of the first solve of a step."""

    def __init__(self) -> None:
        self.kept: list[tuple[FloatArray, ...]] = []

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Any = None) -> Any:
        unknowns, count = np.concatenate(guess), len(guess)

        def off(values: FloatArray) -> FloatArray:
            return np.concatenate(residual(*np.split(values, count)))

        for _ in range(12):
            rows = [(off(unknowns + 1e-6 * e) - off(unknowns - 1e-6 * e)) / 2e-6 for e in np.eye(len(unknowns))]
            unknowns = unknowns - np.linalg.solve(np.array(rows).T, off(unknowns))
        self.kept.append(tuple(np.split(unknowns, count)))
        return self.kept[-1]


@pytest.mark.parametrize("name", ["pumped", "sleigh"])
def test_the_multipliers_of_radaus_step_are_of_order_3(name: str) -> None:
    compiled = system(name)
    law, values, count = compiled.law("constrained"), compiled.parameter_array(), len(compiled.equations.constraints)
    n, errors, counts = compiled.dimension, [], (8, 11, 16)

    def call(t: float, *arguments: FloatArray) -> tuple[FloatArray, ...]:
        return tuple(np.split(law(float(t), np.concatenate(arguments), values), 5))

    end = truth(name)
    exact = compiled.multipliers(end[:n], end[n:], 1.0)
    for steps in counts:
        q, v = np.split(np.array(compiled.statement.initial), 2)
        for i in range(steps):
            solve = Newton()
            q, v, *_ = radau5_index2(call, i / steps, q, v, 1 / steps, solve)
        errors.append(np.abs(solve.kept[0][2 * STAGES - 1][:count] - exact).max())
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(3, abs=0.3), errors


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
@pytest.mark.parametrize("method", [name for name in CONSTRAINED if name in CONTROLLED])
def test_errors_follow_the_tolerance(method: str, name: str, target: str) -> None:
    compiled, errors = system(name, target), []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        found = run(compiled, 1.0, method, rtol=rtol, atol=rtol)
        assert found.status is Status.SUCCESS, found.message
        errors.append(np.abs(found.y[:, -1] - truth(name)).max())
        assert errors[-1] < 100 * rtol
    assert all(later < first / 10 for first, later in itertools.pairwise(errors)), errors


@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
def test_floors_follow_the_scale_where_none_are_given(name: str) -> None:
    """Entries that begin at zero have their size from the survey; the run takes as many steps in other units."""
    found = run(system(name), 1.0, "radau5-index2", rtol=1e-7)
    assert found.status is Status.SUCCESS, found.message
    assert found.steps < 400 and np.abs(found.y[:, -1] - truth(name)).max() < 1e-5


# --- where they are refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_of_velocities_are_refused_by_name(method: str) -> None:
    words = (
        f"{method} is for constraints on coordinates, and 'edge' is stated in velocities: take radau5-index2, taylor"
    )
    with pytest.raises(StatementError, match=words):
        run(system("sleigh"), 1.0, method, step=0.01)


def test_a_method_of_ones_own_may_take_velocity_constraints() -> None:
    mine = replace(implicit("rattle"), name="mine", holonomic=False)
    found = run(system("pendulum"), 0.1, mine, step=0.01)
    assert (found.y == run(system("pendulum"), 0.1, "rattle", step=0.01).y).all()


def test_the_methods_of_this_file_are_those_with_multipliers() -> None:
    assert {*CONSTRAINED} == {"rattle", "constrained-midpoint", "lobatto4", "radau5-index2"}
    assert {*HOLONOMIC} == {*CONSTRAINED} & {*EQUAL}
