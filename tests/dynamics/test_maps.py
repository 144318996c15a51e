"""Maps of starts: first passages in closed form and against single runs, basins that are as symmetric as the system."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sympy import cos

import lagrange as lg
from lagrange.dynamics import basins
from lagrange.dynamics.axes import Axis
from lagrange.dynamics.cells import Cells, Places, coarse_first, each_cell
from lagrange.errors import StatementError
from lagrange.members import work
from lagrange.members.chunk import Ends, Starts, Stopped
from lagrange.members.processors import processors, threads_of
from tests.dynamics.planar import (
    damped_pendulum,
    double_well,
    driven_linear,
    duffing,
    interrupted_after,
    pendulum,
    theta,
    x,
    y,
)
from tests.models import shared_scene

BALL = lg.System(kinetic=lg.kinetic_energy(1, x), potential=9.81 * x, name="ball")


def test_runs_of_a_passage_end_after_a_number_of_steps_and_that_is_said() -> None:
    small = {theta: (-1.0, 1.0, 2), theta.dot: (-1.0, 1.0, 2)}
    found = lg.first_passage(pendulum(), small, t_end=1e9)
    assert found.status is lg.Status.MAX_STEPS and (found.which == -1).all()
    assert found.message.endswith("4 ended before: 'max_steps' the first of them. Raise max_steps, or lower t_end.")
    met = lg.first_passage(pendulum(), small, theta - 0.5, t_end=1e9, max_steps=500)
    assert met.status is lg.Status.SUCCESS and np.isfinite(met.times).all()


def test_the_first_passage_of_a_thrown_ball_is_its_time_of_flight() -> None:
    """x0 + v0 t - g t^2/2 = 0; what is up until t_end has no time."""
    found = lg.first_passage(BALL, {x: (0.5, 2.0, 7), x.dot: (-3.0, 9.0, 9)}, x, t_end=1.8)
    height, speed = np.meshgrid(found.plane[0].values, found.plane[1].values)
    exact = (speed + np.sqrt(speed**2 + 2 * 9.81 * height)) / 9.81
    met = exact <= 1.8
    assert 0 < met.sum() < met.size
    assert np.array_equal(np.isfinite(found.times), met)
    assert found.times[met] == pytest.approx(exact[met], rel=1e-12)
    assert np.array_equal(found.which, np.where(met, 0, -1))
    assert found.message == f"{met.sum()} of 63 runs met the event until t = 1.8."


def test_flips_of_the_double_pendulum_are_those_of_single_runs() -> None:
    """The map has the symmetry of the mirror: (theta1, theta2) and (-theta1, -theta2) flip at the same time."""
    system, end = shared_scene("double-pendulum"), 4.0
    still = {"theta1_dot": 0.0, "theta2_dot": 0.0}
    found = lg.first_passage(system, {"theta1": (-3, 3, 7), "theta2": (-3, 3, 6)}, initial=still, t_end=end)
    assert found.labels == ("theta1 flips", "theta2 flips")
    first, second = system.coordinates
    for row, column in ((0, 0), (2, 1), (5, 3), (3, 6), (4, 2)):
        start = {first: found.plane[0].values[column], second: found.plane[1].values[row], **still}
        events = [lg.event(cos(q / 2), terminal=True) for q in (first, second)]
        alone = lg.integrate(system.compile(), (0.0, end), start, rtol=1e-9, events=events)
        times = [float(one[0]) if len(one) else np.inf for one in alone.t_events]
        if found.which[row, column] < 0:
            assert min(times) == np.inf
        else:
            assert found.times[row, column] == pytest.approx(min(times), rel=1e-9)
            assert found.which[row, column] == int(np.argmin(times))
    # Until then errors of 1e-9 have grown a hundredfold.
    early = found.times < 2.0
    assert early.sum() > 4
    assert found.times[::-1, ::-1][early] == pytest.approx(found.times[early], rel=1e-6)
    assert np.array_equal(found.which[::-1, ::-1][early], found.which[early])


def test_the_basins_of_a_symmetric_double_well_are_symmetric() -> None:
    found = lg.basins(double_well(), {x: (-2, 2, 24), x.dot: (-2, 2, 24)})
    assert [one.states.tolist() for one in found.attractors] == [[[-1.0, 0.0]], [[1.0, 0.0]]]
    assert np.array_equal(found.labels[::-1, ::-1], 1 - found.labels)
    assert {0, 1} == set(np.unique(found.labels))
    model = double_well().compile()
    flow = lg.flow(model, rtol=1e-9)
    for row, column in ((0, 0), (3, 17), (12, 11), (20, 8), (23, 23)):
        start = np.array([found.plane[0].values[column], found.plane[1].values[row]])
        end = flow(start, 0.0, 200.0)
        assert np.sign(end[0]) == 2 * found.labels[row, column] - 1
        # There it is within a thousandth of the plane's diagonal, and a period earlier it was not.
        near = flow(start, 0.0, float(found.times[row, column]) + 5.0)
        assert np.abs(near - [np.sign(end[0]), 0.0]).max() < 0.01


def test_labels_do_not_depend_on_the_number_of_threads() -> None:
    grid = {theta: (-9, 9, 12), theta.dot: (-3, 3, 12)}
    alone, many = (lg.basins(damped_pendulum(), grid, workers=workers) for workers in (1, 3))
    assert np.array_equal(alone.labels, many.labels)
    # An angle has one equilibrium for all turns, wherever it comes to rest.
    assert [one.states.tolist() for one in alone.attractors] == [[[0.0, 0.0]]]


def test_a_driven_oscillator_settles_on_its_cycle() -> None:
    found = lg.basins(driven_linear(), {x: (-2, 2, 5), x.dot: (-2, 2, 5)})
    (cycle,) = found.attractors
    a, b = np.linalg.solve([[4 - 9, 1.5], [-1.5, 4 - 9]], [1.0, 0.0])
    assert cycle.period == 1
    assert cycle.states[0] == pytest.approx([a, 3 * b], abs=1e-9)
    assert (found.labels == 0).all()
    assert found.period == pytest.approx(2 * np.pi / 3)


def test_cycles_of_two_periods_are_attractors_and_chaos_is_none() -> None:
    """At F = 0.28 there is a cycle of two periods in either well; at 0.5 the motion is chaotic (Jordan and Smith)."""
    grid = {x: (-1.2, 1.2, 4), x.dot: (-0.3, 0.3, 3)}
    two = lg.basins(duffing(), grid, parameters={"F": 0.28})
    assert sorted(one.period for one in two.attractors)[-1] == 2
    for one in two.attractors:
        again = lg.poincare(duffing(), two.period, one.states, crossings=one.period, parameters={"F": 0.28})
        assert again.states[0][-1] == pytest.approx(one.states[0], abs=1e-4)
    chaotic = lg.basins(duffing(), grid, parameters={"F": 0.5}, t_end=300.0)
    assert not chaotic.attractors
    assert (chaotic.labels == -1).all()
    assert "12 did not settle on an equilibrium or a cycle until t = 300." in chaotic.message
    with pytest.raises(StatementError, match="there is nothing to draw: 0 attractors"):
        chaotic.plot()


def test_attractors_may_be_given() -> None:
    grid = {x: (-2, 2, 6), x.dot: (-2, 2, 6)}
    found = lg.basins(double_well(), grid, attractors=[{x: 0.999}, {x: -0.999}])
    assert [one.states[0, 0] for one in found.attractors] == [-1.0, 1.0]
    for state, says in (({x: 0.0}, "attractor 0, x = 0, x_dot = 0, is none"), ({x: 3.0}, "attractor 0, x = 3")):
        with pytest.raises(StatementError, match=says):
            lg.basins(double_well(), grid, attractors=[state])


def test_cells_come_coarse_first_and_each_once() -> None:
    places = coarse_first(5, 7)
    assert sorted(map(tuple, places.tolist())) == [(i, j) for i in range(5) for j in range(7)]
    assert places[:4].tolist() == [[0, 0], [0, 4], [4, 0], [4, 4]]


class Slow:
    """An engine whose members take a millisecond each, and count."""

    form, side_by_side = "slow", 1

    def __init__(self) -> None:
        self.run_so_far = 0

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        for done in range(len(starts)):
            if stopped():
                return Ends({"x": starts.states[:done, 0]})
            time.sleep(1e-3)
            self.run_so_far += 1
        return Ends({"x": starts.states[:, 0]})


def test_ctrl_c_ends_the_threads_and_keeps_the_cells() -> None:
    plane = Axis("x", 0, 0.0, 1.0, 40), Axis("x_dot", 1, 0.0, 1.0, 40)
    every, engine, kept = Cells(plane, np.zeros(2), np.zeros(0)), Slow(), dict[tuple[int, ...], float]()

    def take(places: Places, found: Ends) -> None:
        kept.update(zip(map(tuple, places.tolist()), found.columns["x"], strict=True))

    assert not each_cell(every, engine, 2, take, interrupted_after(200))
    assert 200 <= len(kept) == engine.run_so_far < 1000
    assert each_cell(every, engine, 2, take)
    assert len(kept) == 1600 and all(x == plane[0].values[column] for (_, column), x in kept.items())


def test_an_interrupted_map_says_how_much_of_it_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "LARGEST_CHUNK", 16)

    def some(cells: Any, engine: Any, workers: int, take: Any, _: Any) -> bool:
        return each_cell(cells, engine, workers, take, interrupted_after(32))

    monkeypatch.setattr("lagrange.dynamics.passage.each_cell", some)
    monkeypatch.setattr("lagrange.dynamics.basins.each_cell", some)
    fall = lg.first_passage(BALL, {x: (0.5, 2.0, 20), x.dot: (-3.0, 1.0, 20)}, x, workers=1)
    wells = lg.basins(double_well(), {x: (-2, 2, 20), x.dot: (-2, 2, 20)}, workers=1)
    for found, computed in ((fall, fall.which != -2), (wells, wells.labels != -2)):
        assert found.status is lg.Status.INTERRUPTED
        assert 32 <= computed.sum() < 400
        assert found.message.startswith(f"interrupted: {computed.sum()} of 400 runs are done, and kept.")
    assert np.array_equal(np.isfinite(fall.times), fall.which == 0)


@pytest.mark.parametrize(
    ("system", "grid", "more"),
    [
        (double_well, {x: (-2, 2, 14), x.dot: (-2, 2, 13)}, {}),
        (double_well, {x: (-2, 2, 9), x.dot: (-2, 2, 9)}, {"method": "dop853"}),
        (driven_linear, {x: (-2, 2, 5), x.dot: (-2, 2, 5)}, {}),
        (damped_pendulum, {theta: (-9, 9, 9), theta.dot: (-3, 3, 9)}, {"method": "radau5"}),
    ],
)
def test_basins_of_runs_side_by_side_are_those_of_runs_one_by_one(
    system: Any, grid: Any, more: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = lg.basins(system(), grid, **more)
    monkeypatch.setattr(basins, "MANY", 1)
    together = lg.basins(system(), grid, **more)
    assert np.array_equal(together.labels, alone.labels)
    # A vector sums in another order than a packed step: round-off, that a tolerance of 1e-9 leaves alone.
    assert together.times == pytest.approx(alone.times, rel=1e-6, nan_ok=True)
    assert [one.states for one in together.attractors] == [pytest.approx(one.states) for one in alone.attractors]


def test_runs_that_fail_are_counted() -> None:
    """x'' = 6 x^2 is infinite at a finite time, before it gets to x = -5."""
    falling = lg.System(kinetic=x.dot**2 / 2, potential=-2 * x**3)
    found = lg.first_passage(falling, {x: (1.0, 2.0, 2), x.dot: (1.0, 2.0, 2)}, x + 5)
    assert (found.which == -1).all()
    assert not found.status.complete
    assert found.message.startswith("0 of 4 runs met the event until t = 10. 4 ended before:")
    with pytest.raises(StatementError, match="there is nothing to draw: 0 of 4 runs"):
        found.plot()


GRID = {x: (-1, 1, 3), x.dot: (-1, 1, 3)}
NO_GRID: Any = [x]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda: lg.basins(pendulum(), {theta: (-1, 1), theta.dot: (-1, 1)}),
            "pendulum conserves its energy, so that no",
        ),
        (lambda: lg.basins(double_well(), {x: (-1, 1), y: (-1, 1)}), "grid names 'y', which is no coordinate"),
        (lambda: lg.basins(double_well(), {x: (-1, 1, 5000), x.dot: (-1, 1)}), "values in the range of x = 5000"),
        (lambda: lg.basins(double_well(), GRID, t_end=0), "t_end is 0: give a positive time, until which motions may"),
        (lambda: lg.basins(double_well(), GRID, workers=0), "workers = 0: give a whole number from 1 to 1024"),
        (lambda: lg.basins(double_well(), GRID, attractors=[]), "starts is empty"),
        (lambda: lg.first_passage(BALL, GRID), "ball has no angle that could flip over: give event="),
        (lambda: lg.first_passage(BALL, GRID, []), "event is empty: give an expression, or leave it out"),
        (lambda: lg.first_passage(BALL, GRID, x, t_end=-1), "t_end is -1: give a positive time, until which runs wait"),
        (lambda: lg.first_passage(BALL, GRID, x, initial={"z": 1}), "initial names 'z'"),
        (lambda: lg.first_passage(BALL, NO_GRID, x), "grid is \\[x\\(t\\)\\]: give a dict of two entries"),
        (lambda: lg.first_passage(BALL, GRID, theta), "contains theta"),
    ],
)
def test_what_cannot_be_meant_is_refused(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(StatementError, match=says):
        call()


def test_a_plane_of_starts_off_its_constraints_is_refused() -> None:
    held = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, dissipation=x.dot**2, constraints=[x - y], coordinates=[x, y], name="held"
    )
    with pytest.raises(StatementError, match="held has constraints, and a plane of starts leaves them"):
        lg.basins(held, GRID)


def test_maps_and_ensembles_run_on_the_processors_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 8}, raising=False)
    assert threads_of(None) == processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert threads_of(None) == 7
    calls: list[Any] = [
        lambda: lg.first_passage(BALL, GRID, x, workers=2000),
        lambda: lg.basins(double_well(), GRID, workers=2000),
        lambda: lg.ensemble(BALL, 1.0, {"x": [1.0, 2.0]}, workers=2000),
    ]
    for call in calls:
        with pytest.raises(StatementError, match="workers = 2000: give a whole number from 1 to 1024"):
            call()


def test_a_range_that_is_a_matrix_is_refused() -> None:
    theta = lg.coordinate("theta")
    with pytest.raises(lg.StatementError, match=r"the range of theta is .*: give \(low, high\)"):
        lg.first_passage(lg.scene("pendulum"), {theta: np.zeros((2, 2)), theta.dot: (0, 1, 2)})
