"""Methods whose unknowns include multipliers, on systems with constraints: each is tested against its claims."""

from __future__ import annotations

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


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", HOLONOMIC)
def test_constraints_hold_to_round_off_at_every_step(method: str, name: str, target: str) -> None:
    """The bounds are 32 units of round-off of the terms, whose sizes are 2 (phi) and 10 (psi)."""
    compiled = system(name, target)
    phi, psi = held(compiled, run(compiled, 2.0, method, step=0.02))
    assert phi.max() < 2 * 32 * 2.0**-52 and psi.max() < 10 * 32 * 2.0**-52


# --- the symplectic form, in reduced coordinates ---------------------------------------------------------------


# --- where they end, and their path ----------------------------------------------------------------------


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
