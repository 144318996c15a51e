"""The panel of paths and the phase plane: labels, space around marks, and small motions far from the origin."""

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.show.figures.curve import BLOWN_UP
from lagrange.show.figures.paths import Box
from lagrange.show.figures.run_figure import plot
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.show.examples import m, solved
from tests.show.test_picture_laws import drawn, nothing_overlaps

a, b, x, y, z = coordinates("a b x y z")


def moving(*place: Any, size: float = 1.0, **more: Any) -> Solution:
    """Return a solution with a point whose position depends on a = size sin(t) and b = size sin(2 t)."""
    stated: dict[str, Any] = {"positions": {"p": place}, "parameters": {m: 1}, "name": "s"} | more
    return solved(
        declare(kinetic=m * (a.dot**2 + b.dot**2) / 2, **stated),
        np.linspace(0.0, 6.0, 9),
        lambda t: size * np.array([np.sin(t), np.sin(2 * t), np.cos(t), 2 * np.cos(2 * t)]),
    )


def test_a_view_of_space_has_units_at_its_floor_alone() -> None:
    axis = moving(a, b, a + b, dimensions={m: "kg", a: "m", b: "m", lg.t: "s"}).plot("path").axes[0]
    assert axis.get_xlabel() == axis.get_ylabel() == ""
    assert {"x (m)", "y (m)", "z (m)"} <= {text.get_text() for text in axis.texts}


def test_small_motions_far_away_are_drawn_with_all_digits() -> None:
    (axis,) = moving(a + 1e6, b - 3e5).plot("path").axes
    nothing_overlaps(axis.figure)
    assert "1000000" in [text.get_text() for text in axis.get_xticklabels()]


def test_of_a_level_line_the_phase_plane_is_drawn() -> None:
    far = solved(
        moving(a, b).model.statement,
        np.linspace(0.0, 6.0, 9),
        lambda t: np.array([1e6 + np.sin(t), 0 * t, np.cos(t), 0 * t]),
    )
    nothing_overlaps(far.plot("phase", of="a"))
    level = drawn(far.plot("phase", of="b")).axes[0]
    assert level.get_xlim() == (-1.0, 1.0)


@pytest.mark.parametrize("up", [0, b + 10])
def test_round_off_of_a_place_fills_no_panel(up: Any) -> None:
    (axis,) = drawn(moving(a + 10, up, size=1e-11).plot("path")).axes
    assert axis.get_xlim() == pytest.approx((5.0, 15.0))
    assert up == 0 or axis.get_ylim() == pytest.approx((5.0, 15.0))


def test_many_points_have_one_colour_and_no_legend() -> None:
    for count, names in ((10, 10), (11, 0)):
        places = {f"p{k}": (a + k, b) for k in range(count)}
        (axis,) = moving(positions=places).plot("path").axes
        assert len(axis.get_legend_handles_labels()[1]) == names
        ends = [line for line in axis.lines if line.get_marker() == "o"]
        assert len({line.get_markeredgecolor() for line in ends}) == (count if names else 1)
        assert (max(line.get_markersize() for line in ends) > 6) == bool(names)


@pytest.mark.parametrize("size", [1.0, 3.0, 7.0, 9.9])
def test_every_axis_of_space_has_numbers(size: float) -> None:
    box = Box(np.array([-1.0, -1.0, 0.04 * size]), np.array([1.0, 1.0, 0.1 * size]))
    for k in range(3):
        ticks = box.ticks(k)
        assert len(ticks) >= 3 and ((ticks >= box.low[k]) & (ticks <= box.high[k])).all()


# --- Panels of runs that end at a singularity ---


POLE = 2.0


def growing(status: Status = Status.STEP_TOO_SMALL, *, forward: bool = True, space: bool = False) -> Solution:
    """Return a solution with x = 1/(2 - t), almost up to its pole, and oscillations."""
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
    """Return the points (2, K) through which a line is drawn."""
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
