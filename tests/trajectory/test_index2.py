"""Radau's step on index 2: its multipliers, its tolerances, and the floors of vectors of a state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.step.constants import LEAST_FLOOR
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.index2 import STAGES, radau5_index2
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.models import LLVM_FIRST, TARGETS, build
from tests.trajectory.constrained_systems import SYSTEMS, held, system, truth, x
from tests.trajectory.runs import CONSTRAINED, CONTROLLED, run


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


@pytest.mark.slow
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


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
@pytest.mark.parametrize("method", [name for name in CONSTRAINED if name in CONTROLLED])
def test_errors_follow_the_tolerance(method: str, name: str, target: str) -> None:
    compiled, errors = system(name, target), []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        found = run(compiled, 1.0, method, rtol=rtol, atol=rtol)
        assert found.status is Status.SUCCESS, found.message
        errors.append(np.abs(found.y[:, -1] - truth(name)).max())
        assert errors[-1] < 100 * rtol
    # A decade of the tolerance is one of the error. The projection makes up for some of it where steps are long.
    assert np.polyfit([-4, -6, -8, -10], np.log10(errors), 1)[0] == pytest.approx(1, abs=0.15), errors


@pytest.mark.few
@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
def test_constraints_hold_to_round_off_at_a_loose_tolerance(name: str) -> None:
    """By the projection of every step: Newton's method leaves a part of the tolerance."""
    compiled = system(name)
    phi, psi = held(compiled, run(compiled, 2.0, "radau5-index2", rtol=1e-5))
    assert phi.max() < 2 * 32 * 2.0**-52 and psi.max() < 10 * 32 * 2.0**-52


@pytest.mark.parametrize("name", [*SYSTEMS, "sleigh"])
def test_floors_follow_the_scale_where_none_are_given(name: str) -> None:
    """Entries that begin at zero have their size from the survey; the run takes as many steps in other units."""
    found = run(system(name), 1.0, "radau5-index2", rtol=1e-7)
    assert found.status is Status.SUCCESS, found.message
    assert found.steps < 400 and np.abs(found.y[:, -1] - truth(name)).max() < 1e-5


def controlled(model: Model, share: float, floors: Any) -> tuple[Any, DriverState]:
    """Return a driver of Radau's step with a run at its start, whose tolerances begin at some floors."""
    start = np.array(model.statement.initial)
    problem = Problem(model, model.parameter_values(), 0.0, 1.0, start)
    plan: Any = find("radau5-index2")
    state = DriverState(0.0, 1.0, start, 1e-6, 1.0, 0.0, share)
    state.floors[:] = floors
    return plan.plan(problem).driver(model, model.parameter_array()), state


def taken(driver: Any, state: DriverState, trials: int) -> Outcome:
    state.counts[DriverState.ROWS] = 0
    outcome: Outcome = driver.advance(state, trials, np.empty(trials), np.empty((trials + 4, len(state.y))))
    return outcome


@pytest.mark.parametrize("target", TARGETS)
def test_the_sizes_of_entries_are_asked_for_before_the_first_step(target: str) -> None:
    driver, state = controlled(system("pendulum", target), 1e-9, LEAST_FLOOR)
    assert taken(driver, state, 5) is Outcome.UNSCALED
    assert state.count(DriverState.STEPS) == state.count(DriverState.REJECTED) == 0


@pytest.mark.parametrize("target", TARGETS)
def test_a_velocity_without_a_size_is_asked_for_at_once(target: str) -> None:
    driver, state = controlled(system("pendulum", target), 1e-9, [1e-3, 1e-3, LEAST_FLOOR, LEAST_FLOOR])
    state.counts[DriverState.SURVEYED] = 1
    assert taken(driver, state, 1) is Outcome.UNSCALED and state.count(DriverState.REJECTED) == 1


@pytest.mark.parametrize("target", TARGETS)
def test_floors_of_velocities_follow_their_sizes(target: str) -> None:
    driver, state = controlled(system("spherical", target), 1e-9, 1e-12)
    state.counts[DriverState.SURVEYED], largest = 1, np.zeros(6)
    for _ in range(40):
        taken(driver, state, 1)
        largest = np.maximum(largest, np.abs(state.y) * min(1, state.count(DriverState.STEPS)))
    assert state.count(DriverState.STEPS) > 20
    assert (state.floors >= 0.999e-9 * largest).all() and (state.floors <= np.maximum(1.001e-9 * largest, 1e-12)).all()


@pytest.mark.parametrize("target", TARGETS)
def test_errors_of_velocities_count_where_coordinates_are_large(target: str) -> None:
    far = 1e6
    compiled = build(target, kinetic=x.dot**2 / 2, potential=(x - far) ** 2 / 2, initial={x: far + 1.0})
    found = run(compiled, 3.0, "radau5-index2", rtol=1e-6, atol=1e-9)
    assert found.y[1, -1] == pytest.approx(-np.sin(3.0), abs=1e-5)
