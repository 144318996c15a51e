"""Each method against its formula and its claims: order, symplecticity, symmetry, energy, and where it is refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.splitting import Splitting
from tests.models import TARGETS, build, k, m, model, x, y
from tests.trajectory.runs import ADAPTIVE, SPLITTINGS, STEPPED, exact, run, stepped

Rhs = Callable[[float, Any], Any]
Step = Callable[[Rhs, float, Any, float], Any]


# --- formulas, written out again ------------------------------------------------------------------------------


def euler(f: Rhs, t: float, y: Any, h: float) -> Any:
    return y + h * f(t, y)


def midpoint(f: Rhs, t: float, y: Any, h: float) -> Any:
    return y + h * f(t + h / 2, y + h / 2 * f(t, y))


def rk4(f: Rhs, t: float, y: Any, h: float) -> Any:
    a = f(t, y)
    b = f(t + h / 2, y + h / 2 * a)
    c = f(t + h / 2, y + h / 2 * b)
    d = f(t + h, y + h * c)
    return y + h / 6 * (a + 2 * b + 2 * c + d)


def by_scipy(solver: Any) -> Step:
    def step(f: Rhs, t: float, y: Any, h: float) -> Any:
        slopes: list[Any] = []
        for row, c in zip(solver.A, solver.C, strict=True):
            slopes.append(
                f(t + c * h, y + h * sum((a * s for a, s in zip(row, slopes, strict=False)), np.zeros(len(y))))
            )
        return y + h * sum(b * s for b, s in zip(solver.B, slopes, strict=True))

    return step


def symplectic_euler(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    v = y[n:] + h * f(t, y)[n:]
    return np.concatenate([y[:n] + h * v, v])


def verlet(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    q = y[:n] + h * y[n:] + h * h / 2 * f(t, y)[n:]
    force = f(t, y)[n:] + f(t + h, np.concatenate([q, y[n:]]))[n:]
    return np.concatenate([q, y[n:] + h / 2 * force])


FORMULAS: dict[str, Step] = {
    "euler": euler,
    "midpoint": midpoint,
    "rk4": rk4,
    "dopri5": by_scipy(scipy.integrate.RK45),
    "dop853": by_scipy(scipy.integrate.DOP853),
    "symplectic-euler": symplectic_euler,
    "verlet": verlet,
}


def driven() -> Any:
    """A system that every method may run: constant mass matrix, forces of position and time."""
    from sympy import cos, sin

    from lagrange.statement.coordinate import t

    return {
        "kinetic": m * (x.dot**2 + x.dot * y.dot + y.dot**2) / 2,
        "potential": k * x**2 / 2 + sin(x * y) + y**4 / 4,
        "forces": {x: cos(3 * t), y: -x * sin(t)},
        "coordinates": [x, y],
        "initial": {x: 0.7, y: -0.4, x.dot: 0.2, y.dot: 0.5},
    }


PROBLEM = Problem(model("oscillator"), {}, 0.0, 1.0, np.zeros(2))


def test_every_step_program_has_its_formula_here() -> None:
    assert set(FORMULAS) == set(STEPPED)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", STEPPED)
def test_steps_follow_the_formula(name: str, target: str) -> None:
    compiled = build(target, **driven())
    h, count = 0.05, 12
    found = run(compiled, 0.3 + count * h, stepped(name, h), start=0.3)
    state = np.array(compiled.statement.initial)
    for i in range(count):
        assert found.t[i] == pytest.approx(0.3 + i * h, abs=1e-15)
        assert found.y[:, i] == pytest.approx(state, rel=1e-12, abs=1e-13)
        state = FORMULAS[name](compiled.rhs, 0.3 + i * h, state, h)
    assert found.y[:, -1] == pytest.approx(state, rel=1e-12)
    assert found.steps == count and found.rejected == 0


# --- claims ---------------------------------------------------------------------------------------------------


def general() -> Model:
    return model("cart and pole")


CONSERVATIVE = {"Henon-Heiles": 3.0, "coupled masses": 1.0}
GENERAL = {"cart and pole": 1.2, "elastic pendulum": 1.5}
COUNTS = {1: (800, 1131, 1600), 2: (200, 283, 400), 4: (40, 57, 80)}


@pytest.mark.parametrize("name", [name for name in STEPPED if find(name).claims.order in COUNTS])
def test_the_observed_order_is_the_claimed_one(name: str) -> None:
    """On two non-linear systems, with errors far above round-off."""
    claims = find(name).claims
    for system, end in (CONSERVATIVE if claims.symplectic else GENERAL).items():
        compiled = model(system)
        truth = exact(compiled, end).y[:, -1]
        counts = COUNTS[claims.order]
        errors = [np.abs(run(compiled, end, stepped(name, end / n)).y[:, -1] - truth).max() for n in counts]
        assert min(errors) > 1e-10 and max(errors) < 0.2
        order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
        assert order == pytest.approx(claims.order, abs=0.15), (system, errors)


def driven_pendulum(t: Any, y: Any) -> Any:
    return np.array([y[1], -mpmath.sin(y[0]) * (1 + t)])


def henon_heiles(t: Any, y: Any) -> Any:
    return np.array([y[2], y[3], -y[0] - 2 * y[0] * y[1], -y[1] - y[0] ** 2 + y[1] ** 2])


def accelerations_of(law: Rhs) -> Rhs:
    return lambda t, q: law(t, np.concatenate([q, q * 0]))[len(q) :]


@pytest.mark.parametrize("law", [driven_pendulum, henon_heiles])
@pytest.mark.parametrize("name", STEPPED)
def test_the_order_without_round_off(name: str, law: Rhs) -> None:
    """The step as it was written, at 40 digits: halving h divides the change of the result by 2^order."""
    step = stepped(name, 1.0).plan(PROBLEM).step
    order = find(name).claims.order
    with mpmath.workdps(40):
        start = [mpmath.mpf(value) for value in ("0.4", "0.3", "0.2", "-0.5")[: 2 if law is driven_pendulum else 4]]
        ends = []
        for count in {1: (512, 1024, 2048), 2: (64, 128, 256), 5: (96, 192, 384), 8: (12, 24, 48)}.get(
            order, (32, 64, 128)
        ):
            h, y = mpmath.mpf(3) / count, np.array(start)
            n = len(y) // 2
            for i in range(count):
                if step.partitioned:
                    y = np.concatenate(step.function(accelerations_of(law), i * h, y[:n], y[n:], h))
                else:
                    y = step.function(law, i * h, y, h)
            ends.append(y)
        changes = [float(max(abs(b - a))) for a, b in itertools.pairwise(ends)]
    assert np.log2(changes[0] / changes[1]) == pytest.approx(order, abs=0.15)


def momenta(compiled: Model, state: Any) -> Any:
    n = len(state) // 2
    return np.concatenate([state[:n], compiled.mass_matrix(state[:n]) @ state[n:]])


def step_map(compiled: Model, name: str, h: float, z: Any) -> Any:
    """Return one step in (q, p)."""
    n = len(z) // 2
    v = np.linalg.solve(compiled.mass_matrix(z[:n]), z[n:])
    names = compiled.statement.names
    start = {**dict(zip(names, z[:n], strict=True)), **{f"{name}_dot": s for name, s in zip(names, v, strict=True)}}
    return momenta(compiled, run(compiled, h, stepped(name, h), initial=start).y[:, -1])


def defect(compiled: Model, name: str, h: float, z: Any) -> float:
    """Return how far the Jacobian J of the step map is from J^T W J = W; differences in h^6 leave about 1e-12."""
    n, d = len(z) // 2, 2e-2
    columns = []
    for e in np.eye(len(z)):
        rows = [
            (step_map(compiled, name, h, z + s * e) - step_map(compiled, name, h, z - s * e)) / (2 * s)
            for s in (d, d / 2, d / 4, d / 8)
        ]
        for power in (4, 16, 64):
            rows = [(power * b - a) / (power - 1) for a, b in itertools.pairwise(rows)]
        columns.append(rows[0])
    jacobian = np.array(columns).T
    w = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return float(np.abs(jacobian.T @ w @ jacobian - w).max())


@pytest.mark.parametrize("system", ["Henon-Heiles", "coupled masses", "saddle"])
@pytest.mark.parametrize("name", [name for name in STEPPED if find(name).claims.order <= 4])
def test_what_claims_to_be_symplectic_is_and_the_rest_is_not(name: str, system: str) -> None:
    compiled = model(system)
    z = momenta(compiled, np.array(compiled.statement.initial) + 0.1)
    error = defect(compiled, name, 0.2, z)
    assert (error < 1e-10) == find(name).claims.symplectic, error


@pytest.mark.parametrize("name", STEPPED)
def test_what_claims_to_be_symmetric_runs_back_and_the_rest_does_not(name: str) -> None:
    compiled = model("Henon-Heiles")
    there = run(compiled, 5.0, stepped(name, 0.05))
    end = dict(zip(("x", "y", "x_dot", "y_dot"), there.y[:, -1], strict=True))
    back = run(compiled, 0.0, stepped(name, 0.05), start=5.0, initial=end)
    error = np.abs(back.y[:, -1] - there.y[:, 0]).max()
    assert back.t[-1] == 0.0 and back.steps == 100
    if find(name).claims.symmetric:
        assert error < 1e-13
    elif find(name).claims.order <= 4:  # the others come back to round-off by accuracy alone
        assert error > 1e-9


@pytest.mark.parametrize("name", SPLITTINGS)
def test_energy_stays_bounded_without_drift(name: str) -> None:
    compiled = model("Henon-Heiles")
    found = run(compiled, 3000.0, name, step=0.05)
    energy = compiled.energy(found.y[:2], found.y[2:])
    error = energy / energy[0] - 1
    halves = np.array_split(np.abs(error), 2)
    assert halves[0].max() < (0.2 if name == "symplectic-euler" else 2e-3)
    assert halves[1].max() < 1.1 * halves[0].max()
    means = [part.mean() for part in np.array_split(error, 10)]
    assert np.ptp(means) < 0.2 * np.abs(error).max()


def test_rk4_drifts_where_verlet_does_not() -> None:
    compiled = model("Henon-Heiles")
    drifts = {}
    for name in ("rk4", "verlet"):
        found = run(compiled, 3000.0, name, step=0.25)
        energy = compiled.energy(found.y[:2], found.y[2:])
        parts = [part.mean() for part in np.array_split(energy, 4)]
        drifts[name] = abs(parts[-1] - parts[0]) / abs(energy[0])
    assert drifts["rk4"] > 10 * drifts["verlet"]


@pytest.mark.parametrize("name", ADAPTIVE)
def test_errors_follow_the_tolerance(name: str) -> None:
    compiled = model("double pendulum")
    truth = exact(compiled, 3.0).y[:, -1]
    tolerances = (1e-5, 1e-7, 1e-9, 1e-11)
    errors = []
    for rtol in tolerances:
        found = run(compiled, 3.0, name, rtol=rtol, atol=rtol)
        errors.append(np.abs(found.y[:, -1] - truth).max())
        assert errors[-1] < 300 * rtol
    # The order of a series follows the tolerance, and with it the ratio of error to tolerance, up or down.
    least = 10 if name in STEPPED else 5
    assert all(b < a / least for a, b in itertools.pairwise(errors)), errors


@pytest.mark.parametrize("name", [name for name in ADAPTIVE if name in STEPPED])
def test_steps_are_in_line_with_scipys(name: str) -> None:
    """The same tableau and the same error norm should need about the same steps."""
    compiled = model("double pendulum")
    solver: Any = {"dopri5": "RK45", "dop853": "DOP853"}[name]
    slope: Any = compiled.rhs
    theirs = scipy.integrate.solve_ivp(slope, (0, 5), compiled.statement.initial, method=solver, rtol=1e-8, atol=1e-10)
    ours = run(compiled, 5.0, name, rtol=1e-8, atol=1e-10)
    assert ours.steps < 1.25 * (len(theirs.t) - 1)
    assert ours.evaluations < 1.25 * theirs.nfev


# --- where a method has no business ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", SPLITTINGS)
@pytest.mark.parametrize(
    ("system", "reason"),
    [
        ("double pendulum", "its mass matrix changes along the motion"),
        ("charge", "its accelerations depend on velocities"),
        ("friction", "its accelerations depend on velocities"),
    ],
)
def test_a_splitting_is_refused_where_it_is_not_legal(name: str, system: str, reason: str) -> None:
    with pytest.raises(StatementError, match=rf"{name} moves coordinates and velocities in turn.*: {reason}\. Use rk4"):
        run(model(system), 1.0, name, step=0.01)


def test_a_splitting_runs_with_forces_of_place_and_time() -> None:
    compiled = build(**driven())
    assert run(compiled, 1.0, "verlet", step=0.01).status.complete


def test_the_parts_of_a_splitting_add_up_to_a_step() -> None:
    with pytest.raises(StatementError, match=r"the kicks of half add up to 0\.5: they must add up to one step"):
        Splitting("half", 1, ((0.5, 1.0),), symmetric=False)
    with pytest.raises(StatementError, match=r"the drifts of half add up to 2"):
        Splitting("half", 1, ((1.0, 2.0),), symmetric=False)


def test_a_splitting_of_ones_own() -> None:
    """Yoshida's composition of three Verlet steps is of order 4."""
    outer = 1 / (2 - 2 ** (1 / 3))
    inner = 1 - 2 * outer
    kicks = (outer / 2, (outer + inner) / 2, (outer + inner) / 2, outer / 2)
    method = Splitting("yoshida", 4, tuple(zip(kicks, (outer, inner, outer, 0.0), strict=True)), symmetric=True)
    compiled = model("Henon-Heiles")
    truth = exact(compiled, 3.0).y[:, -1]
    errors = [np.abs(run(compiled, 3.0, method, step=3.0 / n).y[:, -1] - truth).max() for n in (40, 57, 80)]
    assert -np.polyfit(np.log([40, 57, 80]), np.log(errors), 1)[0] == pytest.approx(4, abs=0.15)
