"""Plots: the right panels with the right curves, for few and many coordinates, in a plane and in space."""

from __future__ import annotations

import io
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from lagrange.statement.coordinate import coordinate
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.show.animations import double_pendulum
from tests.show.examples import free, m, moving, oscillator, solved, x

LINKED = [("origin", "p")]


def drawn(solution: Solution, **asked: Any) -> Any:
    """Return the figure after it is drawn. Warnings count as errors."""
    figure = solution.plot(**asked)
    figure.savefig(io.BytesIO(), format="png", dpi=60)
    return figure


def titles(figure: Any) -> list[str]:
    return [axis.get_title("left") for axis in figure.axes]


def labels(figure: Any) -> list[str]:
    return [axis.get_ylabel() or axis.get_title("right") for axis in figure.axes]


def test_one_coordinate_and_its_energy() -> None:
    figure = drawn(oscillator())
    assert titles(figure) == ["", "energy drift: (E − E₀) relative to the initial energy"]
    assert labels(figure)[0] == "$x$" and "oscillator   exact, 50 steps" in figure.get_suptitle()
    (line,) = figure.axes[0].lines
    times, values = line.get_data()
    assert len(times) > 1000, "the path between the outputs is drawn"
    np.testing.assert_allclose(values, np.cos(2 * times), atol=1e-12)
    assert np.abs(figure.axes[1].lines[0].get_ydata()).max() < 1e-14


@pytest.mark.slow
def test_a_hundred_coordinates_share_panels() -> None:
    figure = free(100).plot()
    assert len(figure.axes) == 26 and titles(figure)[0] == "coordinates x1 to x4"
    assert sum(len(axis.lines) for axis in figure.axes[:-1]) == 100


def test_a_long_name_stands_above() -> None:
    q = coordinate("angle_of_the_first_link")
    statement = declare(kinetic=q.dot**2 / 2, name="s")
    figure = drawn(solved(statement, np.array([0.0, 1.0]), lambda t: np.array([t, np.ones_like(t)])))
    assert titles(figure)[0] == "angle_of_the_first_link" and labels(figure)[0] == ""


def test_an_energy_that_is_not_conserved_is_shown_itself() -> None:
    solution = oscillator(forces={x: -x.dot / 10})
    figure = drawn(solution)
    assert titles(figure)[1] == "energy (the system does not conserve it)"
    times, energy = figure.axes[1].lines[0].get_data()
    np.testing.assert_array_equal(energy, solution.model.energy(*np.split(solution.at(times), 2)))


def test_the_path_in_the_plane_with_links_at_the_end() -> None:
    figure = drawn(double_pendulum((0.0, 2.0), links=[("origin", "first"), ("first", "second")]))
    path = figure.axes[-1]
    assert path.get_title("left") == "path; open circles: start"
    assert (path.get_xlabel(), path.get_ylabel()) == ("x", "y")
    data = [line.get_xydata() for line in path.lines]
    np.testing.assert_allclose(data[0], [(0, 0), (np.sin(2), -np.cos(2))], atol=1e-12)
    lower = (np.sin(2) - np.sin(4), -np.cos(2) - np.cos(4))
    np.testing.assert_allclose(data[1], [(np.sin(2), -np.cos(2)), lower], atol=1e-12)
    curve = data[2]
    np.testing.assert_allclose(np.hypot(*curve.T), 1.0)
    assert [text.get_text() for text in path.get_legend().get_texts()] == ["first", "second"]
    assert path.get_aspect() == 1.0


def test_a_path_in_space_is_seen_from_a_side_over_a_floor_with_numbers() -> None:
    axis = drawn(moving(lambda a, b: a, lambda a, b: b, lambda a, b: a * b, links=LINKED)).axes[-1]
    texts = [text.get_text() for text in axis.texts]
    assert [text for text in texts if text in "xyz"] == ["x", "y", "z"]
    assert texts[-4:] == ["2.5", "5.0", "7.5", "z"]
    azimuth, elevation = np.radians(-60), np.radians(25)
    end = np.array([2.0, 4.0, 8.0])
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    eye = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    seen = np.array([across @ end, np.cross(eye, across) @ end])
    (last,) = [line for line in axis.lines if line.get_label() == "p"]
    np.testing.assert_allclose(last.get_xydata()[0], seen)
    depths = [line for line in axis.lines if 2.0 <= line.get_zorder() < 3.0 and len(line.get_xdata())]
    widths = [line.get_linewidth() for line in depths]
    assert len(depths) > 1 and widths == sorted(set(widths)), "what is near is wider"
    shadow = next(line for line in axis.lines if line.get_zorder() == 1.0).get_xydata()
    np.testing.assert_allclose(shadow[-1, 0], seen[0])
    assert shadow[-1, 1] < seen[1]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((lambda a, b: a, lambda a, b: b, 0.0), ("x", "y")),
        ((lambda a, b: a, 0.0, lambda a, b: b), ("x", "z")),
        ((0.0, lambda a, b: a, lambda a, b: b), ("y", "z")),
    ],
)
def test_a_plane_in_space_is_seen_from_above(parts: Any, expected: tuple[str, str]) -> None:
    axis = drawn(moving(*parts, links=LINKED)).axes[-1]
    assert (axis.get_xlabel(), axis.get_ylabel()) == expected
    (last,) = [line for line in axis.lines if line.get_label() == "p"]
    np.testing.assert_allclose(last.get_xydata()[-1], [2.0, 4.0])


def test_a_thread_is_not_drawn_to_scale_but_a_straight_line_is() -> None:
    thread = drawn(moving(lambda a, b: 100 * a, lambda a, b: b)).axes[-1]
    assert thread.get_aspect() == "auto" and "not to scale" in thread.get_title("left")
    assert drawn(moving(lambda a, b: 3 * a, lambda a, b: b, links=LINKED)).axes[-1].get_aspect() == 1.0


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("parts", "label", "ticks"), [((lambda a, b: a, 0.0), "x", "yticks"), ((0.0, lambda a, b: b), "y", "xticks")]
)
def test_motion_on_a_line_has_a_row_or_a_column_and_no_square(parts: Any, label: str, ticks: str) -> None:
    figure = drawn(moving(*parts, links=LINKED))
    axis = figure.axes[-1]
    assert (axis.get_xlabel() or axis.get_ylabel()) == label and not len(getattr(axis, f"get_{ticks}")())
    box = axis.get_window_extent()
    assert max(box.width / box.height, box.height / box.width) > 2.5


@pytest.mark.parametrize("times", [[0.0], [0.0, -3.0, -4.0], np.linspace(0, 5, 100_001)])
def test_runs_of_any_length_and_direction(times: Any) -> None:
    figure = drawn(oscillator(times))
    drawn_times = figure.axes[0].lines[0].get_xdata()
    assert drawn_times[0] == times[0] and drawn_times[-1] == times[-1] and len(drawn_times) <= 20_001


def test_a_run_that_ended_early_says_so() -> None:
    assert "ended early: singular" in drawn(oscillator(status=Status.SINGULAR)).get_suptitle()
    assert "not the motion: unreliable" in drawn(oscillator(status=Status.UNRELIABLE)).get_suptitle()


def test_a_state_that_is_not_finite_can_be_drawn() -> None:
    statement = oscillator().model.statement
    bad = solved(statement, np.array([0.0]), lambda t: np.full((2, len(t)), np.nan), Status.NON_FINITE)
    assert titles(drawn(bad))[1] == "energy: it has no value at some state of the run"


def test_no_output_at_all_is_refused() -> None:
    with pytest.raises(StatementError, match="there is nothing to plot: the run ended before"):
        oscillator([]).plot()


def test_a_coordinate_at_rest_is_a_level_line() -> None:
    statement = declare(kinetic=m * x.dot**2 / 2, parameters={m: 1}, name="rest")
    axis = drawn(solved(statement, np.linspace(0, 1, 3), lambda t: np.array([1 + 1e-14 * t, 0 * t]))).axes[0]
    low, high = axis.get_ylim()
    assert low < 0.6 and high > 1.4


def test_values_near_the_largest_double_have_limits() -> None:
    """The sum of two such values overflows."""
    figure = oscillator(np.linspace(0, 1, 3)).plot(what=1e308)
    assert np.isfinite(figure.axes[0].get_ylim()).all()


@pytest.mark.slow
def test_matplotlib_comes_with_the_first_picture_only_and_none_of_its_global_state_is_touched() -> None:
    code = (
        "import lagrange.trajectory.solution, sys\n"
        "if 'matplotlib' in sys.modules: sys.exit('it came before')\n"
        "import matplotlib\n"
        "settings = lambda: [matplotlib.rcParams[key] for key in matplotlib.rcParams if key != 'backend']\n"
        "from tests.show.examples import oscillator; before = settings(); oscillator().plot()\n"
        "sys.exit('matplotlib.pyplot' in sys.modules or settings() != before)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)
