"""The path between steps: as accurate as its method, through every step, at any times, also after an early end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.dense.hermite import hermite_polynomial
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.explicit import RungeKutta
from lagrange.trajectory.methods.radau import PATHS
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.paths.step_paths import StepPath, step_path
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.tableaux.dopri5 import DOPRI5
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.models import TARGETS, VALUES, build, g, k, l, m, model, x, z
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, SPLITTINGS, exact, run


def path_round_off(name: str) -> float:
    """The dense weights of verner9 reach 13,293 and cancel; those of the others reach 545."""
    return 2e-12 if name == "verner9" else 1e-13


def hermite(compiled: Model, times: FloatArray, states: FloatArray, order: int) -> StepPath:
    return step_path(compiled, compiled.parameter_array(), hermite_polynomial(order), times, states)


CLAIMED: dict[str, Planned] = {
    **{name: method for name in NAMES if isinstance(method := find(name), Planned) and name != "taylor"},
    **{f"taylor, order {order}": Taylor(order=order) for order in (4, 5, 8, 12)},
}
"""Every method of ours, by its own name or as it is asked for: the order of taylor follows from the tolerance."""


def measured_order(method: Any, system: str, end: float) -> float:
    """Return the order of the path alone: between states of the exact motion its error goes like h^(order + 1).

    By the four grids with the smallest errors above round-off, from 2 to 1448 steps by factors of the square root of 2.
    Round-off is more where weights of the path cancel: those of verner9 reach 13,293, those of dop853 545.
    """
    compiled, times = model(system), np.linspace(0.0, end, 499)
    truth, kept = exact(compiled, end, t_eval=times).y, []
    problem = Problem(compiled, compiled.parameter_values(), 0.0, end, truth[:, 0])
    for count in (round(2 * 2 ** (i / 2)) for i in range(20)):
        grid = np.linspace(0.0, end, count + 1)
        path = method.plan(problem).path(problem, grid, exact(compiled, end, t_eval=grid).y.T, None)
        error = np.abs(path(times) - truth).max()
        if error < (3e-11 if method.name in ("verner9", "dop853") else 1e-12):
            break
        kept.append((count, error))
    assert len(kept) >= 4, kept
    counts, errors = zip(*kept[-4:], strict=True)
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1)


def off(method: Any) -> float:
    """Return by how much the measured order of the path differs from the claimed one."""
    system, end = ("Henon-Heiles", 3.0) if method.name in SPLITTINGS else ("cart and pole", 1.2)
    claimed: int = method.claims.dense
    return abs(measured_order(method, system, end) - claimed)


@pytest.mark.parametrize("name", CLAIMED)
def test_the_observed_order_of_the_path_is_the_claimed_one(name: str) -> None:
    """Neither less nor more: measured orders are within 0.17 of what is claimed."""
    assert off(CLAIMED[name]) < 0.25


@dataclass(frozen=True)
class Overstated:
    """A method that claims of its path what is not so."""

    method: Any
    by: int

    @property
    def name(self) -> str:
        return str(self.method.name)

    @property
    def claims(self) -> Claims:
        claims: Claims = self.method.claims
        return replace(claims, dense=claims.dense + self.by)

    def plan(self, problem: Problem) -> Any:
        return self.method.plan(problem)


@pytest.mark.parametrize("by", [-1, 1])
@pytest.mark.parametrize("name", ["euler", "dopri5", "verlet", "gauss3", "taylor, order 8"])
def test_a_wrong_claim_of_a_path_is_seen(name: str, by: int) -> None:
    assert off(Overstated(CLAIMED[name], by)) > 0.75


def test_a_method_of_ours_that_has_a_path_claims_its_order() -> None:
    assert [name for name in NAMES if find(name).claims.dense == 0] == []


@pytest.mark.parametrize("order", range(3, 10))
@pytest.mark.parametrize(("name", "counts"), [("Henon-Heiles", (8, 16)), ("cart and pole", (80, 160))])
def test_a_hermite_path_of_any_order(name: str, counts: tuple[int, int], order: int) -> None:
    """Between states of the exact motion the error within a step shows, which is of one order more.

    The exact motion itself is known to some 3e-13 between its steps, ten times the tolerance of its run.
    """
    compiled = model(name)
    times = np.linspace(0.0, 2.0, 203)
    truth = exact(compiled, 2.0, t_eval=times).y
    errors = []
    for count in counts:
        grid = np.linspace(0.0, 2.0, count + 1)
        path = hermite(compiled, grid, exact(compiled, 2.0, t_eval=grid).y.T, order)
        errors.append(np.abs(path(times) - truth).max())
    assert np.log2(errors[0] / errors[1]) > order + 1 - 0.5 or errors[1] < 3e-13, errors


@pytest.mark.parametrize(("name", "counts"), [("Henon-Heiles", (32, 64)), ("cart and pole", (100, 200))])
@pytest.mark.parametrize("stages", PATHS)
def test_a_path_of_collocation_is_of_one_order_more_than_its_stages(
    stages: int, name: str, counts: tuple[int, int]
) -> None:
    """Between states of the exact motion, with steps of two lengths in turn."""
    compiled = model(name)
    times, errors = np.linspace(0.0, 2.0, 499), []
    truth = exact(compiled, 2.0, t_eval=times).y
    for count in counts:
        grid = np.linspace(0.0, 2.0, count + 1)
        grid[1::2] += 0.5 / count
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 2.0, truth[:, 0])
        path = PATHS[stages](problem, grid, exact(compiled, 2.0, t_eval=grid).y.T)
        errors.append(np.abs(path(times) - truth).max())
    claimed = find(f"radau{2 * stages - 1}").claims.dense
    assert claimed == stages + 1
    assert np.log2(errors[0] / errors[1]) > claimed + 1 - 0.4, errors


@pytest.mark.parametrize("stretched", [0.0, 1e-6])
def test_the_path_of_a_stiff_run_is_as_good_as_its_steps(stretched: float) -> None:
    """A spring of 1e4 or 1e8: slopes of the law at the ends would bring in its rate times what they miss."""
    compiled = model("elastic pendulum")
    rate = 1e8 if stretched == 0 else 1e4
    length = (VALUES[l] + VALUES[m] * VALUES[g] * np.cos(0.5) / rate) * (1 + stretched)
    given: Any = {"parameters": {k: rate}, "initial": {"r": length, "theta": 0.5, "theta_dot": 0}}
    fine = run(compiled, 5.0, "radau5", rtol=1e-10, atol=1e-12, **given)
    found = run(compiled, 5.0, "radau5", rtol=1e-6, atol=1e-8, **given)
    times = np.linspace(0.0, 5.0, 2003)
    at_steps = np.abs(found.y - fine.dense(found.t)).max(axis=1)
    between = np.abs(found.dense(times) - fine.dense(times)).max(axis=1)
    # The spring's own part, of 1e-9 and less, counts for nothing beside the tolerance.
    assert (between < 1.02 * at_steps + 1e-9).all(), between / at_steps


def test_a_tableau_of_high_order_without_a_path_gets_one() -> None:
    """The cubic of a tableau of one's own is of order 3, too little for a method of order 5."""
    compiled, times = model("Henon-Heiles"), np.linspace(0.0, 3.0, 203)
    truth = exact(compiled, 3.0, t_eval=times).y
    bare = replace(DOPRI5, error=None, dense=None).hermite()
    runs = [run(compiled, 3.0, RungeKutta(bare, step=3.0 / n)).dense(times) for n in (24, 48)]
    errors = [np.abs(found - truth).max() for found in runs]
    assert np.log2(errors[0] / errors[1]) > 4.65, errors


@pytest.mark.parametrize("order", [3, 5, 8])
def test_a_hermite_path_is_smooth_at_the_joints(order: int) -> None:
    compiled = model("cart and pole")
    grid = np.linspace(0.0, 2.0, 11)
    states = exact(compiled, 2.0, t_eval=grid).y
    path = hermite(compiled, grid, states.T, order)
    assert path(grid) == pytest.approx(states, abs=1e-14)
    h = 1e-5
    for sign in (-1.0, 1.0):
        slopes = sign * (path(grid[1:-1] + sign * h) - states[:, 1:-1]) / h
        assert slopes == pytest.approx(compiled.rhs(grid[1:-1], states[:, 1:-1]), abs=1e-3)


def test_a_hermite_path_of_a_stiff_step_stays_the_cubic() -> None:
    """x'' = -1e8 x' - x over steps of 0.1: the iteration would multiply what is wrong by 1e7 each time."""
    compiled = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, dissipation=sp.Integer(10) ** 8 * x.dot**2 / 2)
    grid = np.linspace(0.0, 1.0, 11)
    values = np.exp(-1e-8 * grid)
    states = np.stack([values, -1e-8 * values], axis=1)
    times = np.linspace(0.0, 1.0, 101)
    for order in (3, 5, 8):
        assert hermite(compiled, grid, states, order)(times)[0] == pytest.approx(np.exp(-1e-8 * times), abs=1e-7)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", [2.0, -2.0])
def test_the_path_goes_through_every_step_and_is_continuous(name: str, target: str, end: float) -> None:
    found = run(model("Henon-Heiles", target), end, name, **({"step": 0.1} if name in FIXED else {}))
    assert found.dense(found.t) == pytest.approx(found.y, abs=path_round_off(name))
    inner = found.t[1:-1]
    near = [found.dense(np.nextafter(inner, side)) for side in (-9.0, 9.0)]
    assert np.abs(near[0] - near[1]).max() < 10 * path_round_off(name)


@pytest.mark.few
@pytest.mark.parametrize("name", NAMES)
def test_times_in_any_order_and_number(name: str) -> None:
    found = run(model("Henon-Heiles"), 2.0, name, **({"step": 0.1} if name in FIXED else {}))
    rng = np.random.default_rng(1)
    times = rng.uniform(0, 2, 57)
    together = found.dense(times)
    assert together.shape == (4, 57)
    for i in range(0, 57, 8):
        assert found.dense(times[i : i + 1])[:, 0] == pytest.approx(together[:, i], abs=path_round_off(name))
    assert found.dense(times[::-1]) == pytest.approx(together[:, ::-1], abs=path_round_off(name))
    assert found.dense(np.empty(0)).shape == (4, 0)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_put_out_beyond_the_last_accepted_step(name: str, target: str) -> None:
    compiled = build(target, kinetic=m * x.dot**2 / 2, forces={x: sp.Piecewise((k, x < 1))}, initial={x.dot: 1.0})
    options: dict[str, Any] = {"step": 0.01} if name in FIXED else {}
    times = np.linspace(0, 5, 501)
    found = run(compiled, 5.0, name, t_eval=times, **options)
    assert found.status is Status.NON_FINITE and f"{name} stopped at t = " in found.message
    assert "x_dot is nan" in found.message or "the acceleration of x is nan" in found.message
    assert "Look for a division by zero" in found.message
    last = found.span[1]
    assert (found.t == times[times <= last]).all() and last < 0.75
    assert np.isfinite(found.y).all() and found.y.shape == (2, len(found.t))
    nowhere = run(compiled, 5.0, name, t_eval=[4.0, 5.0], **options)
    assert nowhere.t.shape == (0,) and nowhere.y.shape == (2, 0)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["euler", "midpoint", "rk4"])
def test_a_run_that_ends_in_a_singular_configuration_has_its_path(name: str, target: str) -> None:
    """The slope at the end of the last step is the one that there is not."""
    compiled = build(
        target,
        kinetic=m * (x.dot + z.dot) ** 2 / 2 + sp.Max(0, 1 - t) * m * z.dot**2 / 2,
        potential=k * (x - z) ** 2 / 2,
        coordinates=[x, z],
        initial={x: 0.3},
    )
    times = np.linspace(0, 5, 251)
    found = run(compiled, 5.0, name, step=0.05, t_eval=times)
    assert found.status is Status.SINGULAR and len(found.t) > 40 and np.isfinite(found.y).all()
    last = np.array([found.span[1]])
    steps = run(compiled, 5.0, name, step=0.05)
    assert found.dense(last)[:, 0] == pytest.approx(steps.y[:, -1], rel=1e-12)
    assert found.dense(steps.t) == pytest.approx(steps.y, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", ADAPTIVE)
def test_the_path_of_an_adaptive_run_keeps_the_tolerance(name: str) -> None:
    compiled = model("elastic pendulum")
    times = np.linspace(0, 5, 301)
    truth = exact(compiled, 5.0, t_eval=times).y
    for rtol in (1e-6, 1e-9):
        found = run(compiled, 5.0, name, rtol=rtol, atol=rtol)
        ends = np.abs(found.y[:, -1] - truth[:, -1]).max()
        assert np.abs(found.dense(times) - truth).max() < 300 * max(ends, rtol)
