"""Methods whose unknowns include multipliers, on systems with constraints: each is tested against its claims."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import Min

from lagrange.compiler import compile_model, reached
from lagrange.equations.regularity import equations_of
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.statement.event import Event
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.trajectory import Status
from tests.models import LLVM_FIRST, TARGETS, build
from tests.models import stated as stated_with
from tests.trajectory.constrained_systems import (
    HOLONOMIC,
    SYMPLECTIC,
    SYSTEMS,
    equal,
    from_angles,
    held,
    system,
    truth,
    x,
    y,
    z,
)
from tests.trajectory.runs import CONSTRAINED, CONTROLLED, EQUAL, run

# --- claims ---------------------------------------------------------------------------------------------------

COUNTS = tuple(round(32 * 2 ** (i / 2)) for i in range(12))
"""Numbers of steps, from 32 to 1448, by factors of the square root of 2."""
FLOOR = 2e-11
"""Errors below this are left out: round-off, some 1e-13, would move a measured order where they double."""


@pytest.mark.few(1)
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
@pytest.mark.parametrize("method", CONSTRAINED)
def test_the_observed_order_is_the_claimed_one(method: str, name: str) -> None:
    """The systems have moving constraints, friction, explicit time, and a mass matrix that depends on coordinates."""
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


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_hold_to_round_off_at_every_step(method: str, name: str, target: str) -> None:
    """The bounds are 32 units of round-off of the terms, whose sizes are 2 (phi) and 10 (psi)."""
    compiled = system(name, target)
    phi, psi = held(compiled, run(compiled, 2.0, method, step=0.02))
    assert phi.max() < 2 * 32 * 2.0**-52 and psi.max() < 10 * 32 * 2.0**-52


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["pendulum", "spherical", "double_pendulum", "guided"])
@pytest.mark.parametrize("method", HOLONOMIC)
def test_what_claims_to_be_symmetric_runs_back(method: str, name: str) -> None:
    compiled = system(name)
    there = run(compiled, 1.0, method, step=0.02)
    names = (*compiled.statement.names, *(f"{item}_dot" for item in compiled.statement.names))
    back = run(compiled, 0.0, method, start=1.0, step=0.02, initial=dict(zip(names, there.y[:, -1], strict=True)))
    assert find(method).claims.symmetric and np.abs(back.y[:, -1] - there.y[:, 0]).max() < 1e-11


# --- the symplectic form, in reduced coordinates ---------------------------------------------------------------


def canonical(state: FloatArray) -> FloatArray:
    """Return angles and momenta of a double pendulum from its Cartesian state."""
    q, v = np.split(state, 2)
    rods = [(q[:2], v[:2], v[:2] + v[2:]), (q[2:] - q[:2], v[2:] - v[:2], v[2:])]
    turns = [np.arctan2(rod[0], -rod[1]) for rod, _, _ in rods]
    momenta = [1.3 * (np.array([-rod[1], rod[0]]) @ total) for rod, _, total in rods]
    return np.array([*turns, *momenta])


def cartesian(canonical: FloatArray) -> FloatArray:
    """Return the Cartesian state from angles and momenta."""
    turns, momenta = np.split(canonical, 2)
    c = np.cos(turns[0] - turns[1])
    return from_angles(np.concatenate([turns, np.linalg.solve(1.3 * 0.49 * np.array([[2, c], [c, 1]]), momenta)]))


def reduced_step(method: Any, h: float, point: FloatArray) -> FloatArray:
    compiled = system("double_pendulum")
    names = (*compiled.statement.names, *(f"{item}_dot" for item in compiled.statement.names))
    start = dict(zip(names, cartesian(point), strict=True))
    return canonical(run(compiled, h, method, step=h, initial=start).y[:, -1])


def defect(method: Any, h: float) -> float:
    """Return the largest entry of J^T W J - W for the Jacobian J of a step; its numerical error is about 1e-11."""
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


@pytest.mark.few(2)
@pytest.mark.parametrize("method", CONSTRAINED)
def test_what_claims_to_be_symplectic_keeps_the_form_of_the_reduced_system(method: str) -> None:
    error = defect(equal(method), 0.1)
    assert error < 1e-9 if find(method).claims.symplectic else error > 1e-6


@pytest.mark.few(1)
@pytest.mark.parametrize("method", SYMPLECTIC)
def test_energy_stays_bounded_without_drift(method: str) -> None:
    """The run has about 600 swings of 50 steps each."""
    compiled = system("spherical")
    result = run(compiled, 600.0, method, step=0.02)
    energy = compiled.energy(result.y[:3], result.y[3:])
    error = energy - energy[0]
    halves = [np.abs(half).max() for half in np.array_split(error, 2)]
    assert result.status is Status.SUCCESS and halves[1] < 1.1 * halves[0] < 0.1
    means = [part.mean() for part in np.array_split(error, 10)]
    assert np.ptp(means) < 0.1 * np.abs(error).max()


# --- where they end, and their path ----------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("method", CONSTRAINED)
def test_constraints_that_become_dependent_are_told(method: str, target: str) -> None:
    """From x = 1 on both constraints say y = z. It is detected when Newton's matrix is updated, within 64 steps."""
    compiled = build(
        target,
        kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2,
        coordinates=[x, y, z],
        constraints={"first": y - z, "second": y - Min(1, x) * z},
        initial={x: 0.5, x.dot: 1.0},
    )
    result = run(compiled, 5.0, method, **({"step": 0.01} if method in EQUAL else {}))
    assert result.status is Status.SINGULAR and 0.4 < result.t[-1] < 1.15, result.message
    assert "the constraints 'first' and 'second' are dependent at t = " in result.message


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("method", CONSTRAINED)
def test_the_path_between_steps_leads_to_events(method: str, target: str) -> None:
    """Events are located on the dense output, whose order is at least 3."""
    compiled, event = system("pendulum", target), Event(x)
    exact = run(system("pendulum"), 2.0, Taylor(rtol=1e-14), events=(event,)).t_events[0]
    settings = {"step": 0.005} if method in EQUAL else {"rtol": 1e-7, "atol": 1e-7}
    result = run(compiled, 2.0, method, events=(event,), **settings)
    near = {2: 2e-4, 4: 1e-6, 5: 1e-7}[find(method).claims.order]
    assert len(exact) == 2 and result.t_events[0] == pytest.approx(exact, abs=near)
    assert result.dense(np.array([0.8125]))[:, 0] == pytest.approx(halfway(), abs=30 * near)


@cache
def halfway() -> FloatArray:
    place: FloatArray = run(system("pendulum"), 0.8125, Taylor(rtol=1e-15, atol=1e-15)).y[:, -1]
    return place


# --- where they are refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_of_velocities_are_refused_by_name(method: str) -> None:
    words = (
        f"{method} is for constraints on coordinates, and 'edge' is stated in velocities: take radau5-index2, taylor"
    )
    with pytest.raises(StatementError, match=words):
        run(system("sleigh"), 1.0, method, step=0.01)


@pytest.mark.parametrize("method", HOLONOMIC)
def test_coordinates_without_inertia_are_refused_by_name(method: str) -> None:
    vortices = build(lagrangian=x.dot * y - (x**2 + y**2) / 2, coordinates=[x, y])
    start = {x: 1.0, y: 0.3, x.dot: 0.3, y.dot: -1.0}
    with pytest.raises(StatementError, match=f"{method} finds velocities from momenta, .* of x and y: take"):
        run(vortices, 1.0, method, step=0.01, initial=start)
    result = run(vortices, 1.0, "radau5-index2", initial=start)
    turn = np.array([[np.cos(1.0), np.sin(1.0)], [-np.sin(1.0), np.cos(1.0)]])
    assert result.y[:2, -1] == pytest.approx(turn @ [1.0, 0.3], abs=1e-8)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", CONSTRAINED)
def test_redundant_constraints_that_are_allowed_change_nothing(method: str) -> None:
    stated = SYSTEMS["spherical"]()
    rod = stated["constraints"]["rod"]
    statement = stated_with(**{**stated, "constraints": {"rod": rod, "again": 3 * rod}, "redundant": "allow"})
    twice = compile_model(statement, equations_of(statement, reached), check=False)
    settings: dict[str, Any] = {"step": 0.01} if method in EQUAL else {"rtol": 1e-6, "atol": 1e-6}
    both = [run(compiled, 1.0, method, **settings).y for compiled in (system("spherical"), twice)]
    assert both[0] == pytest.approx(both[1], abs=1e-9)


# --- Radau's step on index 2 ----------------------------------------------------------------------------------
# Radau's step on index 2: its multipliers, its tolerances, and the floors of vectors of a state.


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
@pytest.mark.parametrize("method", [name for name in CONSTRAINED if name in CONTROLLED])
def test_errors_follow_the_tolerance(method: str, name: str, target: str) -> None:
    compiled, errors = system(name, target), []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        result = run(compiled, 1.0, method, rtol=rtol, atol=rtol)
        assert result.status is Status.SUCCESS, result.message
        errors.append(np.abs(result.y[:, -1] - truth(name)).max())
        assert errors[-1] < 100 * rtol
    # A decade of the tolerance is one of the error. The projection makes up for some of it where steps are long.
    assert np.polyfit([-4, -6, -8, -10], np.log10(errors), 1)[0] == pytest.approx(1, abs=0.15), errors


@pytest.mark.few
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
def test_floors_follow_the_scale_where_none_are_given(name: str) -> None:
    """Entries that are zero at first get sizes from the survey, so the number of steps does not depend on units."""
    result = run(system(name), 1.0, "radau5-index2", rtol=1e-7)
    assert result.status is Status.SUCCESS, result.message
    assert result.steps < 400 and np.abs(result.y[:, -1] - truth(name)).max() < 1e-5


@pytest.mark.parametrize("target", TARGETS)
def test_errors_of_velocities_count_where_coordinates_are_large(target: str) -> None:
    far = 1e6
    compiled = build(target, kinetic=x.dot**2 / 2, potential=(x - far) ** 2 / 2, initial={x: far + 1.0})
    result = run(compiled, 3.0, "radau5-index2", rtol=1e-6, atol=1e-9)
    assert result.y[1, -1] == pytest.approx(-np.sin(3.0), abs=1e-5)
