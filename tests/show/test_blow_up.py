"""Panels of runs that end at a singularity: what came before stays visible, and what is left out is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.show.figures.curve import BLOWN_UP
from lagrange.show.figures.run_figure import plot
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.show.examples import m, oscillator, solved

x, y, z = coordinates("x y z")
POLE = 2.0


def growing(status: Status = Status.STEP_TOO_SMALL, *, forward: bool = True, space: bool = False) -> Solution:
    """Return x = 1/(2 - t), with oscillations beside it, almost up to its pole."""
    t = POLE - np.geomspace(POLE, 1e-9, 60)

    def path(t: Any) -> Any:
        gap = POLE - (t if forward else -t)
        return np.array([1 / gap, np.sin(t), np.cos(t), gap**-2, np.cos(t), -np.sin(t)])

    point = (x, y, z) if space else (x, y)
    statement = declare(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        coordinates=[x, y, z],  # else they are in the order in which this process, all tests of it, declared them
        parameters={m: 1},
        positions={"bob": point, "end": (0, *point[1:])},
        name="growing",
    )
    return solved(statement, t if forward else -t, path, status)


def data(line: Any) -> Any:
    """Return what a line is drawn through, (2, K)."""
    return np.array([line.get_xdata(), line.get_ydata()], dtype=float)


@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("status", BLOWN_UP)
def test_a_blow_up_does_not_flatten_what_came_before(status: Status, forward: bool) -> None:
    axis = growing(status, forward=forward).plot("x").axes[0]
    low, high = axis.get_ylim()
    # The middle of the values by time: 1/(2 - t) at 5 % and 95 % of [0, 2] is 0.526 and 10.
    assert high == pytest.approx(10 + (10 - 1 / 1.9), rel=0.02) and 0 < 0.5 - low < 1
    assert "shown: 90% of the time; then up to 1.0e+09" in axis.get_title("left")
    times, values = data(axis.lines[0])
    shown = values < high
    exact = 1 / (POLE - np.abs(times[shown]))
    np.testing.assert_allclose(values[shown], exact, rtol=1e-9)
    order = np.argsort(np.abs(times))
    between = np.linspace(0.0, 1.8, 500)
    off = np.interp(between, np.abs(times)[order], values[order]) - 1 / (POLE - between)
    assert np.abs(off).max() < (high - low) / 150, "a pixel of a panel of less than an inch"
    ends = growing(status, forward=forward).plot("y").axes[0]
    assert ends.get_title("left") == "" and np.ptp(data(ends.lines[0])[1]) > 0.9, "what is bounded is drawn whole"


@pytest.mark.parametrize("status", sorted(set(Status) - set(BLOWN_UP), key=str))
def test_any_other_run_is_drawn_whole(status: Status) -> None:
    axis = growing(status).plot("x").axes[0]
    assert axis.get_ylim()[1] > 1e9 and axis.get_title("left") == ""


def test_a_bounded_run_that_stops_is_drawn_whole() -> None:
    ours, whole = (oscillator(status=one).plot(["x", "phase"]).axes for one in (Status.STEP_TOO_SMALL, Status.SUCCESS))
    for one, other in zip(ours, whole, strict=True):
        assert (one.get_xlim(), one.get_ylim()) == (other.get_xlim(), other.get_ylim())
        assert one.get_title("left") == other.get_title("left")


@pytest.mark.parametrize("space", [False, True])
def test_planes_and_paths_show_the_part_before_the_end(space: bool) -> None:
    run = growing(space=space)
    phase = run.plot("phase", of="x").axes[0]
    assert 10 < phase.get_xlim()[1] < 25 and 100 < phase.get_ylim()[1] < 250
    assert "shown: 90% of the time; then up to 1.0e+18" in phase.get_title("left")
    path = run.plot("path").axes[0]
    widths = [np.abs(row).max(initial=0.0, where=np.isfinite(row)) for row, _ in map(data, path.lines)]
    assert max(widths) < 60 and "then up to 1.0e+09" in path.get_title("left")


def test_runs_side_by_side_are_shown_each_as_it_is() -> None:
    whole = growing(Status.SUCCESS).sampled(np.linspace(0.0, 1.99, 200))
    axis = plot([growing(), whole], "x", labels=["a", "b"]).axes[0]
    assert 99 < axis.get_ylim()[1] < 130, "that of the run that did not blow up, which reached 100"
