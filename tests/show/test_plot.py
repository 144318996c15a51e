"""Plots: the right panels with the right curves, and their arguments."""

import io
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from sympy import cos

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.coordinate import coordinate
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.models import shared_scene
from tests.refusals import refusal
from tests.show.examples import double_pendulum, free, k, m, moving, oscillator, solved, x

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


@pytest.mark.slow
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
    assert "there is nothing to plot: the run ended before" in refusal(lambda: oscillator([]).plot())


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


# --- arguments of a plot: the right rows in the right panels, a user's axes, and refusals ----------------------


@pytest.mark.parametrize(
    ("what", "values"),
    [
        ("velocities", lambda t: [-2 * np.sin(2 * t)]),
        ("x_dot", lambda t: [-2 * np.sin(2 * t)]),
        (x, lambda t: [np.cos(2 * t)]),
        (x.ddot, lambda t: [-4 * np.cos(2 * t)]),
        (k * x**2 / 2, lambda t: [2 * np.cos(2 * t) ** 2]),
        ("energies", lambda t: [2 * np.sin(2 * t) ** 2, 2 * np.cos(2 * t) ** 2, 2 + 0 * t]),
        ("invariants", lambda t: [0 * t]),
        ("drift", lambda t: [0 * t]),
    ],
)
def test_each_thing_that_can_be_asked_for_is_drawn(what: Any, values: Any) -> None:
    figure = oscillator().plot(what)
    assert len(figure.axes) == 1
    for line, row in zip(figure.axes[0].lines, range(9), strict=False):
        t, result = np.asarray(line.get_xydata()).T
        np.testing.assert_allclose(result, values(t)[row], atol=1e-12)
    assert len(figure.axes[0].lines) == len(values(np.zeros(1)))


@pytest.mark.parametrize(
    ("word", "what"), [("phase plane", "phase"), ("phase_plane", "phase"), ("energy", "energies"), ("paths", "path")]
)
def test_other_words_for_what_is_shown_mean_the_same(word: str, what: str) -> None:
    run = shared_scene("pendulum").run(1.0)
    result, expected = ([line.get_xydata() for line in run.plot(name).axes[0].lines] for name in (word, what))
    assert len(result) == len(expected) > 0
    for first, second in zip(result, expected, strict=True):
        np.testing.assert_array_equal(first, second)


def test_a_coordinate_comes_before_another_word_for_what_is_shown() -> None:
    energy = lg.coordinate("energy")
    figure = lg.System(energy.dot**2 / 2, initial={energy: 1}, name="named so").run(1.0).plot("energy")
    np.testing.assert_array_equal(np.asarray(figure.axes[0].lines[0].get_ydata()), 1.0)


@pytest.mark.slow
def test_phase_planes_paths_and_several_panels() -> None:
    figure = drawn(oscillator(), what=["phase", "coordinates"])
    time, phase = figure.axes
    assert (phase.get_xlabel(), phase.get_ylabel()) == ("$x$", "$\\dot{x}$") and time.get_ylabel() == "$x$"
    q, v = phase.lines[0].get_xydata().T
    np.testing.assert_allclose(q**2 + v**2 / 4, 1.0, atol=1e-12)
    only = drawn(double_pendulum(), what="path")
    assert len(only.axes) == 1 and only.get_figwidth() < 5
    assert len(drawn(free(4), what="phase", of=["x2", "x4"]).axes) == 2


def test_multipliers_and_violations_of_constraints() -> None:
    run = shared_scene("cartesian-double-pendulum").run(1.0)
    figure = run.plot(["multipliers", "violation"])
    assert len(figure.axes) == 3 and [axis.get_ylabel() for axis in figure.axes[:2]] == [
        "$\\lambda_{\\mathrm{upper}}$",
        "$\\lambda_{\\mathrm{lower}}$",
    ]
    line = figure.axes[0].lines[0]
    times, result = np.asarray(line.get_xydata()).T
    np.testing.assert_allclose(result, run.sampled(times).multipliers["upper"], rtol=1e-9)


def test_of_a_long_path_the_last_part_is_drawn_and_that_is_said() -> None:
    run = shared_scene("kepler").run(1000.0)
    (axis,) = run.plot("path").axes
    title = axis.get_title("left")
    assert title.startswith("path from t = ")
    begun = float(title.split()[4])
    line = next(line for line in axis.lines if line.get_zorder() == 2)
    np.testing.assert_allclose(np.asarray(line.get_xydata())[0], run.at(begun)[:2], atol=0.2)
    assert 0 < begun < 1000 - 20
    assert run.sampled([0.0, 9.0]).plot("path").axes[0].get_title("left") == "path; open circles: start"


def test_fixed_points_are_marks_of_their_own() -> None:
    (axis,) = shared_scene("kepler").run(2.0).plot("path").axes
    (sun,) = [line for line in axis.lines if line.get_label() == "sun"]
    assert sun.get_marker() == "P" and sun.get_linestyle() == "None"
    np.testing.assert_array_equal(np.asarray(sun.get_xydata()), [[0.0, 0.0]])


def test_units_stand_on_the_axes() -> None:
    run = oscillator(dimensions={m: "kg", k: "N/m", x: "m"})
    assert run.plot("energies").axes[0].get_title("left") == "energies (J)"
    axis = run.plot("velocities").axes[0]
    assert axis.get_ylabel() == "$\\dot{x}$ (m/s)" and axis.get_xlabel() == "t (s)"


def test_units_that_follow_from_others_stand_on_the_axes() -> None:
    g = lg.parameters("g")
    stated: dict[Any, Any] = {"kinetic": m * x.dot**2 / 2, "potential": m * g * x, "positions": {"ball": (x, 0)}}
    system = lg.System(**stated, parameters={m: 1, g: 981}, dimensions={m: "g", g: "cm/s**2"})
    figure = drawn(system.run(1.0), what=["coordinates", "velocities", "path"])
    labels = [axis.get_ylabel() for axis in figure.axes] + [axis.get_xlabel() for axis in figure.axes]
    assert {"$x$ (cm)", "$\\dot{x}$ (cm/s)", "x (cm)"} <= set(labels)


def test_a_jacobi_integral_has_its_own_letter() -> None:
    figure = drawn(shared_scene("bead-on-hoop").run(1.0), what="energies")
    assert [line.get_label() for line in figure.axes[0].get_lines()] == ["$T$", "$V$", "$J$"]


def test_it_draws_into_the_axes_of_a_user_and_returns_their_figure() -> None:
    figure = Figure(figsize=(6, 3), dpi=100)
    left, right = figure.subplots(1, 2)
    assert free(3).plot("coordinates", ax=left) is figure
    assert len(left.lines) == 3 and not right.lines
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["$x_1$", "$x_2$", "$x_3$"]
    free(3).plot(["coordinates", "velocities"], of="x3", ax=[left, right])
    assert len(left.lines) == 4 and len(right.lines) == 1


def test_the_size_and_the_style_are_those_asked_for() -> None:
    figure = oscillator().plot(size=(9, 4), style="dark")
    assert tuple(figure.get_size_inches()) == (9, 4)
    assert figure.get_facecolor() == figure.axes[0].get_facecolor() != oscillator().plot().get_facecolor()


def test_several_runs_share_panels_and_are_named_by_what_differs() -> None:
    first, second = oscillator(), oscillator(np.linspace(0.0, 3.0, 31))
    figure = lg.plot([first, second], labels=["long", "short"])
    assert [line.get_label() for line in figure.axes[0].lines] == ["long", "short"]
    assert len({line.get_color() for line in figure.axes[0].lines}) == 2
    assert figure.get_suptitle() == "oscillator   2 runs"
    energies = lg.plot([first, second], "energies").axes[0].lines
    assert [line.get_linestyle() for line in energies] == ["-"] * 3 + ["--"] * 3
    assert energies[3].get_label() == "$T$ run 2"
    pendulum = shared_scene("pendulum")
    by_method = lg.plot([pendulum.run(1.0, method=name) for name in ("taylor", "dop853")], "theta")
    assert [line.get_label() for line in by_method.axes[0].lines] == ["taylor", "dop853"]
    by_parameter = lg.plot([pendulum.run(1.0, parameters={"l": length}) for length in (1.0, 2.0)], "theta")
    assert [line.get_label() for line in by_parameter.axes[0].lines] == ["l = 1", "l = 2"]


def test_a_run_from_a_file_is_drawn_at_its_outputs_which_is_said(tmp_path: Any) -> None:
    run = lg.load(shared_scene("pendulum").run(2.0).to_npz(tmp_path / "run.npz"))
    axis = run.plot().axes[0]
    assert axis.get_title("left") == "the outputs, joined by straight lines"
    np.testing.assert_array_equal(axis.lines[0].get_xdata(), run.t)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"what": "energie"}, r"what = 'energie' is not a quantity to plot: give coordinates, .* a SymPy expression"),
        ({"what": []}, r"what = \[\] contains no quantity to plot"),
        ({"what": "path"}, "oscillator has no named points: state positions=.* with what='coordinates'"),
        ({"what": "multipliers"}, "oscillator has no constraints, and so no multipliers to plot"),
        ({"what": "violation"}, "oscillator has no constraints, and so no violation"),
        ({"what": lg.parameters("w")}, "the expression contains w, which this system does not have"),
        ({"of": "y"}, "of = 'y' is not a coordinate of this system; they are x"),
        ({"of": []}, r"of = \[\] chooses no coordinate; they are x"),
        ({"style": "blue"}, "style = 'blue' is not known: give one of light and dark"),
        ({"size": 3}, "size = 3: give"),
        ({"dpi": 0}, "dpi = 0: give a whole number from 10"),
        ({"ax": 3}, "ax is 3: give axes of Matplotlib, or leave it out"),
        ({"ax": Figure().subplots()}, "ax has 1 panel, but the figure needs 2: choose fewer with what= and of="),
        ({"what": "x", "ax": Figure().subplots(), "size": (3, 3)}, "size is for a new figure"),
    ],
)
def test_what_cannot_be_drawn_is_refused(given: Any, message: str) -> None:
    with pytest.raises(StatementError, match=message):
        oscillator().plot(**given)


def test_what_several_runs_cannot_have_is_refused() -> None:
    assert "oscillator has the coordinates x and free x1: runs in one fig" in refusal(lg.plot, [oscillator(), free(1)])
    with pytest.raises(StatementError, match=r"labels are \['one'\]: give a text for each of 2 runs"):
        lg.plot([oscillator(), oscillator()], labels=["one"])
    wrongs: tuple[Any, ...] = ([], [3], 3)
    for wrong in wrongs:
        assert "give one solution, or a list of solutions, such as" in refusal(lg.plot, wrong)
    assert "there are 10 phase planes, and a figure has up to 9: choose" in refusal(lambda: free(10).plot("phase"))
    still = declare(kinetic=x.dot**2 / 2, forces={x: cos(lg.t) - x.dot**3}, name="pushed")
    run = solved(still, np.linspace(0, 1, 3), lambda t: np.array([np.sin(t), np.cos(t)]))
    assert "no conserved quantity of pushed was found, so there are no invariants" in refusal(run.plot, "invariants")


def test_an_invariant_that_is_zero_is_said_to_be() -> None:
    x, y = lg.coordinates("x y")
    central = lg.System((x.dot**2 + y.dot**2) / 2, (x**2 + y**2) / 2, initial={x: 1.0}, name="central")
    figure = central.run(1.0).plot("invariants")
    assert "drift of angular momentum z, which is 0 at every output" in [a.get_title("left") for a in figure.axes]


def test_an_invariant_that_is_round_off_is_seen_beside_its_terms() -> None:
    y = lg.coordinate("y")
    charge = lg.System(
        lagrangian=(x.dot**2 + y.dot**2) / 2 + 1.5 * (x * y.dot - y * x.dot) + 0.7 * x,
        coordinates=[x, y],
        initial={x: 0.3, y.dot: 0.5},
        name="drifting charge",
    )
    figure = charge.run(6.0).plot("invariants")
    drifts = [np.abs(np.asarray(line.get_ydata())).max() for axis in figure.axes for line in axis.lines]
    assert len(drifts) == 3 and max(drifts) < 1e-9
    assert all("relative to the size of its terms" in axis.get_title("left") for axis in figure.axes)
    (energy,) = charge.run(1.0).plot("energies").axes
    assert len(energy.lines) == 1, "a Lagrangian alone has no kinetic and no potential energy"


def test_runs_with_several_points_are_told_apart_by_the_kind_of_their_lines() -> None:
    runs = [double_pendulum(), double_pendulum()]
    (axis,) = lg.plot(runs, "path", labels=["one", "two"]).axes
    kinds = {line.get_label(): line.get_linestyle() for line in axis.lines if str(line.get_label())[0] != "_"}
    assert sorted(set(kinds.values()) - {"None"}) == ["-", "--"] and len(kinds) == 4
    paths = [line.get_linestyle() for line in axis.lines if line.get_zorder() == 2]
    assert paths == ["-", "-", "--", "--"]


def test_a_figure_that_is_too_small_for_its_panels_is_refused() -> None:
    assert "size = (3, 2) leaves no room for 4 panels: give a " in refusal(lambda: double_pendulum().plot(size=(3, 2)))
    drawn(double_pendulum(), what="coordinates", size=(3, 2))
