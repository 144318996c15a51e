"""Laws of all pictures and their parts: curves within a pixel, labels without overlap, springs, bodies."""

import io
import pickle
import re
import struct
from collections.abc import Callable
from functools import cache
from io import BytesIO
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image
from sympy import diag

import lagrange as lg
from lagrange.show.figures.curve import Pixels, first_times, in_plane, over_time
from lagrange.show.figures.paths import SPRING_TURNS, common_view, named_points, spring
from lagrange.show.figures.run_figure import labels_of
from lagrange.show.figures.style import DARK, LIGHT, STYLES, line_styles, new_figure
from lagrange.show.files.picture import MOST_BYTES, bounded_png
from lagrange.statement.statement import corners
from lagrange.trajectory.measures.times_and_points import moving_points, points_at
from lagrange.trajectory.trajectory import FloatArray
from tests.models import SCENE_NAMES, shared_scene
from tests.refusals import refusal
from tests.show.examples import farthest, moving, oscillator, x

DPI = 150
"""Dots to an inch of a file."""

SCENES = (
    *("pendulum", "double-pendulum", "kepler", "henon-heiles", "elastic-pendulum"),
    *("cartesian-pendulum", "bead-on-hoop", "spherical-pendulum", "four-bar", "swinging-atwood-machine"),
)


def drawn(figure: Any, dpi: int = DPI) -> Any:
    """Return the figure after it is drawn. Warnings count as errors."""
    figure.set_dpi(dpi)
    figure.savefig(io.BytesIO(), format="png", dpi=dpi)
    return figure


def seen(axis: Any, points: FloatArray) -> FloatArray:
    """Return points (2, K) of a panel, converted to pixels."""
    return np.asarray(axis.transData.transform(points.T).T)


@pytest.mark.few(1)
@pytest.mark.parametrize("end", [None, 100.0])
@pytest.mark.parametrize("name", SCENES)
def test_curves_are_within_a_pixel_of_the_exact_ones(name: str, end: float | None) -> None:
    """All curves of a picture are within a pixel of states at 50 times as many times."""
    run = shared_scene(name).run(end)
    figure = drawn(run.plot())
    first = first_times(run.trajectory)
    fine = np.linspace(run.t[0], run.t[-1], min(50 * len(first), 200_000))
    names = run.model.statement.names
    states = run.at(fine)
    for axis, row in list(zip(figure.axes, states[: len(names)], strict=False))[: 1 if len(first) > 50_000 else 2]:
        (line,) = axis.lines
        assert farthest(seen(axis, np.array([fine, row])), [seen(axis, line.get_xydata().T)]) < 1.0
    path = figure.axes[-1]
    lines = [line for line in path.lines if 2.0 <= line.get_zorder() < 3.0]
    begun = float(path.get_title("left").partition("from t = ")[2].partition(" ")[0] or run.t[0])
    drawn_from = begun + 5e-4 * abs(begun - run.t[0])  # the title rounds it to four digits
    late = fine[fine >= drawn_from]
    view = common_view((run,))
    assert view is not None
    moving = moving_points(run.model.statement)
    exact = [view.of(points) for name, points in named_points(run, late).items() if name in moving]
    where = np.concatenate([seen(path, points) for points in exact], axis=1)
    assert (
        farthest(where[:, :: max(1, where.shape[1] // 200_000)], [seen(path, line.get_xydata().T) for line in lines])
        < 1
    )


def test_a_drift_of_the_dense_output_is_told_apart_from_the_steps() -> None:
    run = shared_scene("pendulum").run(10.0, method=lg.methods.Gauss3(step=0.2))
    axis = run.plot().axes[1]
    assert "at the steps (the dense output between them: up to" in axis.get_title("left")
    (line,) = axis.lines
    assert (
        line.get_linestyle() == "None" and line.get_marker() == "o" and np.shape(line.get_xydata()) == (len(run.t), 2)
    )
    smooth = shared_scene("pendulum").run(10.0, rtol=1e-6).plot().axes[1]
    assert "at the steps" not in smooth.get_title("left") and smooth.lines[0].get_linestyle() == "-"


def written(figure: Any) -> list[tuple[str, Any]]:
    """Return each text that a figure shows, with its box in pixels."""
    result = [text for text in [figure._suptitle, figure._supxlabel] if text is not None]
    for axis in figure.axes:
        result += [*axis.texts, axis.title, axis._left_title, axis._right_title, axis.xaxis.label, axis.yaxis.label]
        for line in (axis.xaxis, axis.yaxis):
            low, high = sorted(line.get_view_interval())
            slack = 1e-9 * (high - low)
            result += [
                tick.label1
                for tick in line.get_major_ticks()
                if low - slack <= tick.get_loc() <= high + slack and tick.label1.get_visible()
            ]
            assert line.get_offset_text().get_text() == "", "no number stands for what is beside a mark"
        legend = axis.get_legend()
        result += legend.get_texts() if legend else []
    shown = [text for text in result if text.get_text().strip() and text.get_visible()]
    return [(text.get_text(), text.get_window_extent().padded(-0.5)) for text in shown]


def nothing_overlaps(figure: Any) -> None:
    texts = written(drawn(figure))
    assert len(texts) > 5
    assert [(a, b) for (a, box), (b, other) in combinations(texts, 2) if box.overlaps(other)] == []
    width, height = figure.get_size_inches() * DPI
    beyond = [a for a, box in texts if box.x0 < -1 or box.y0 < -1 or box.x1 > width + 1 or box.y1 > height + 1]
    assert beyond == [], "no text is cut"


CROWDED = ("pleiades", "sun-earth-moon")
"""Scenes with many names, and with long numbers."""


@pytest.mark.few(1)
@pytest.mark.parametrize("name", [*CROWDED, *[name for name in SCENE_NAMES if name not in CROWDED]])
def test_no_text_overlaps_another_or_is_cut(name: str) -> None:
    nothing_overlaps(shared_scene(name).run(max_steps=2000).plot())


def test_texts_of_unusual_numbers_do_not_overlap_and_have_no_offset() -> None:
    late = oscillator(1e7 + np.linspace(0.0, 5.0, 51))
    figure = late.plot()
    nothing_overlaps(figure)
    tiny = oscillator(np.linspace(0.0, 5e-9, 51)).plot(["velocities", "energies"])
    nothing_overlaps(tiny)
    assert {text for text, _ in written(tiny)} >= {"1·10⁻⁹", "5·10⁻⁹"}


def test_values_that_are_almost_alike_have_all_the_digits_that_tell_them_apart() -> None:
    nothing_overlaps(oscillator().plot(x * 1e-7 + 10.46350336))


def test_all_methods_of_the_registry_are_told_apart() -> None:
    count = len(lg.methods.names())
    for style in STYLES.values():
        result = line_styles(count, style)
        assert len(set(result)) == len({(item.colour, item.marker) for item in result}) == count > 38


def brightness(colour: str) -> float:
    parts = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in to_rgb(colour)]
    return float(np.dot([0.2126, 0.7152, 0.0722], parts))


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours as WCAG 2.1 defines it, from 1 to 21."""
    low, high = sorted((brightness(one), brightness(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("style", [LIGHT, DARK], ids=lambda style: style.name)
def test_text_and_lines_have_contrast_with_their_paper(style: Any) -> None:
    """WCAG 2.1 demands a contrast of 4.5 for small letters, better 7, and 3 for lines."""
    assert contrast(style.ink, style.paper) > 7.0
    assert contrast(style.quiet, style.paper) > 4.5
    assert min(contrast(colour, style.paper) for colour in style.colours) > 3.0


def test_a_dark_figure_is_dark_in_all_its_parts() -> None:
    run = moving(lambda a, b: a, lambda a, b: b, lambda a, b: a * b)
    figure = drawn(run.plot(["coordinates", "path", "phase"], style="dark"))
    paper = to_rgb(DARK.paper)
    assert to_rgb(figure.get_facecolor()) == paper
    for axis in figure.axes:
        assert to_rgb(axis.get_facecolor()) == paper
        texts = [*axis.texts, axis._left_title, axis.xaxis.label, axis.yaxis.label, *axis.get_xticklabels()]
        assert all(contrast(text.get_color(), DARK.paper) > 7 for text in texts if text.get_text())


# --- polylines are within a pixel of the curve that they draw, for known functions and for runs ----------------


PIXELS = Pixels(700.0, 300.0)


def off(values: Callable[[FloatArray], FloatArray], start: FloatArray, exact: FloatArray) -> float:
    """Return the distance in pixels of the exact values of one row from its drawn line."""
    ((t, row),) = over_time(lambda t: values(t)[None], start, PIXELS)
    shown = values(exact)
    scale = np.array([[PIXELS.width / np.ptp(exact)], [PIXELS.height / np.ptp(shown)]])
    return farthest(scale * [exact, shown], [scale * [t, row]])


@pytest.mark.few(1)
@pytest.mark.parametrize("end", [1.0, -40.0, 1000.0])
def test_swings_and_sharp_turns_are_within_a_pixel(end: float) -> None:
    start = np.linspace(0.0, end, 1 + int(20 * abs(end)))
    exact = np.linspace(0.0, end, 60_000)
    assert off(lambda t: np.sin(2 * np.pi * t), start, exact) < 0.5
    assert off(lambda t: 1 / (1.05 - np.cos(2 * np.pi * t)), start, exact) < 0.5
    assert off(lambda t: np.abs(np.sin(np.pi * t)), start, exact) < 0.5


def test_few_samples_are_enough_of_a_line_and_many_share_columns() -> None:
    start = np.linspace(0.0, 1.0, 50)
    (line,) = over_time(lambda t: 3 * t[None], start, PIXELS)
    assert line.shape[1] < 100
    (dense,) = over_time(lambda t: np.sin(2e4 * t)[None], np.linspace(0.0, 1.0, 50_000), PIXELS)
    assert dense.shape[1] <= 4 * 2 * PIXELS.width + 2
    columns = (PIXELS.width * dense[0]).astype(int)
    for column in (0, 100, 500):
        heights = dense[1][columns == column]
        assert heights.max() > 0.999 and heights.min() < -0.999


@pytest.mark.parametrize("each", [4, 6, 11])
def test_ends_of_oscillations_that_share_a_column_are_drawn_whatever_the_first_samples(each: int) -> None:
    count = 2000
    start = np.linspace(0.0, count, each * count + 1)
    (line,) = over_time(lambda t: (np.cos(np.pi * (t - 0.23)) ** 2)[None], start, PIXELS)
    column = np.minimum((PIXELS.width * line[0] / count).astype(int), 699)
    for end in (np.minimum, np.maximum):
        result = np.full(700, 0.5)
        end.at(result, column, line[1])
        assert PIXELS.height * np.abs(result[1:-1] - (0.0 if end is np.minimum else 1.0)).max() < 0.5


def test_the_end_of_a_swing_to_and_fro_on_one_line_is_drawn() -> None:
    def points(t: FloatArray) -> FloatArray:
        return np.array([[np.cos(t - 0.4), 0.5 * np.cos(t - 0.4)]])

    line = in_plane(points, np.linspace(0.0, 2 * np.pi, 6), PIXELS)[1][0]
    assert PIXELS.width * (2 - np.ptp(line[0])) / 2 < 1.0


def test_a_jump_is_found_to_the_pixel_and_a_level_row_is_left_alone() -> None:
    ((t, row),) = over_time(lambda t: np.where(t < 0.7123, 0.0, 1.0)[None], np.linspace(0.0, 1.0, 20), PIXELS)
    assert len(t) < 400
    pixel = 1 / PIXELS.width
    assert 0.7123 - 0.5 * pixel < t[row == 0][-1] < 0.7123 <= t[row == 1][0] < 0.7123 + 0.5 * pixel
    (level,) = over_time(lambda t: 5.0 + 1e-12 * np.sin(1e9 * t)[None], np.linspace(0.0, 1.0, 20), PIXELS)
    assert level.shape[1] < 40


def test_what_is_not_finite_stays_a_gap() -> None:
    with np.errstate(all="ignore"):
        ((t, row),) = over_time(lambda t: np.log(t - 0.5)[None], np.linspace(0.0, 1.0, 20_000), PIXELS)
    assert np.isnan(row[t < 0.5]).all() and np.isfinite(row[t > 0.5]).all()


@pytest.mark.slow
def test_first_times_are_the_outputs_and_those_between() -> None:
    run = oscillator(np.linspace(0.0, 5.0, 11)).trajectory
    assert set(run.t) <= set(first_times(run)) and len(first_times(run)) >= 500
    many = oscillator(np.linspace(0.0, 5.0, 600_001)).trajectory
    few = first_times(many)
    assert set(few) <= set(many.t) and (few[0], few[-1]) == (0.0, 5.0) and 2e5 < len(few) < 3e5
    assert len(set(np.diff(np.searchsorted(many.t, few)).tolist())) > 2, "the distances are irregular"


# --- parts of figures: empty panels for what a user draws, springs, colours ------------------------------------


def test_panels_are_in_order_and_in_the_style_of_the_figure() -> None:
    figure = lg.figure(2, 3, style="dark")
    assert len(figure.axes) == 6
    places = [place.colspan.start for axis in figure.axes if (place := axis.get_subplotspec()) is not None]
    assert places == [0, 1, 2, 0, 1, 2]
    line = figure.axes[0].plot([0, 1], [1, 0])[0]
    assert line.get_color() == DARK.colours[0]
    assert figure.get_facecolor() == figure.axes[5].get_facecolor() != lg.figure().get_facecolor()
    assert lg.figure().axes[0].plot([0, 1])[0].get_color() == LIGHT.colours[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"style": "drak"}, r"style = 'drak' is not known: give one of light and dark\. Did you mean 'dark'\?"),
        ({"rows": 0}, r"rows = 0: give a whole number from 1 to 8\."),
        ({"size": (7, 0.5)}, r"size = \(7, 0\.5\): give \(width, height\) in inches, each from 1 to 40\."),
        ({"size": (7, float("nan"))}, r"size = \(7, nan\): give \(width, height\) in inches"),
    ],
)
def test_what_cannot_be_drawn_on_is_refused(options: dict[str, Any], message: str) -> None:
    assert re.search(message, refusal(lg.figure, **options))


# --- The shape of a spring, whatever its length ---


@pytest.mark.parametrize("length", [0.3, 1.0, 40.0])
def test_a_spring_goes_from_end_to_end_and_is_as_wide_as_asked(length: float) -> None:
    start, direction = np.array([0.5, -1.0]), np.array([0.6, 0.8])
    line = spring(start, start + length * direction, 0.1)
    assert np.allclose(line[:, 0], start) and np.allclose(line[:, -1], start + length * direction)
    aside = np.array([-0.8, 0.6]) @ (line - start[:, None])
    assert np.isclose(np.ptp(aside), 0.1)
    assert np.count_nonzero(np.diff(np.sign(aside[np.abs(aside) > 1e-9]))) == 2 * SPRING_TURNS - 2


def test_a_spring_of_no_length_is_a_point() -> None:
    point = np.array([1.0, 2.0])
    assert np.array_equal(spring(point, point, 0.1), np.repeat(point[:, None], 2 * SPRING_TURNS + 3, axis=1))


# --- Figures show themselves ---


def size(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


def png_of(figure: Any) -> tuple[bytes, dict[str, int]]:
    png, metadata = figure._repr_png_()
    return png, metadata


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "figure",
    [
        lambda: oscillator().plot(),
        lambda: lg.methods.plot_stability("rk4"),
        lambda: shared_scene("pendulum").plot_eigenvalues("l", np.linspace(0.5, 2.0, 5), {"theta": 0}),
    ],
    ids=["run", "stability", "eigenvalues"],
)
def test_a_figure_shows_itself_with_two_dots_to_a_pixel(figure: Any) -> None:
    made = figure()
    assert isinstance(made, Figure)
    png, metadata = png_of(made)
    assert size(png) == (2 * metadata["width"], 2 * metadata["height"])
    assert len(png) <= MOST_BYTES == 300_000
    assert repr(made).startswith("<figure '") and "Figure size" not in repr(made)


@pytest.mark.slow
def test_a_figure_of_noise_is_bounded_and_stays_a_picture() -> None:
    figure = new_figure(figsize=(8, 5))
    rng = np.random.default_rng(1)
    figure.add_subplot().imshow(rng.random((1000, 1600, 3)), interpolation="none", aspect="auto")
    png, metadata = png_of(figure)
    assert 30_000 < len(png) <= MOST_BYTES and metadata["width"] == 640
    with Image.open(BytesIO(png)) as image:
        assert np.asarray(image.convert("RGBA"))[..., :3].std() > 20


def test_few_colours_come_before_few_dots() -> None:
    figure = new_figure(figsize=(6, 4))
    axis = figure.add_subplot()
    for k in range(100):
        axis.plot(np.random.default_rng(k).random(30), linewidth=0.5)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=160)
    assert len(file.getvalue()) > MOST_BYTES
    png = bounded_png(figure, 160)
    assert size(png) == (960, 640) and len(png) <= MOST_BYTES


def test_a_figure_pickles() -> None:
    figure = oscillator().plot()
    again = pickle.loads(pickle.dumps(figure))
    assert type(again) is type(figure) and png_of(again)[0] == png_of(figure)[0]


# --- drawn bodies: corners turn with the rotation, edges connect them, and corners have no marks ---------------


R = lg.rotation("R")

y, z = lg.coordinates("y z")


def thrown(**positions: Any) -> lg.System:
    kinetic = R.body.dot(diag(1, 2, 2.5) * R.body) / 2 + lg.kinetic_energy(1, (x, y, z))
    return lg.System(kinetic, z, initial={R.body: (1, 3, 2), x.dot: 1}, positions=positions, name="thrown")


@cache
def boxed() -> lg.System:
    """Return a thrown box whose centre has a name."""
    return thrown(box=lg.shape("box", R, (4, 2, 1), at=(x, y, z)), centre=(x, y, z))


def test_corners_of_a_box_turn_about_its_place() -> None:
    run = boxed().run(1.0)
    result = points_at(run.model, run.t, run.y, run.parameters_at(run.t))
    corner = np.array(lg.shape("box", None, (4, 2, 1)).corners, dtype=float)
    assert {*map(tuple, corner.tolist())} == {(i, j, k) for i in (-2, 2) for j in (-1, 1) for k in (-0.5, 0.5)}
    centre = np.array([run[q] for q in (x, y, z)])
    expected = np.einsum("nij,cj->cin", run[R], corner) + centre
    links = boxed().statement.links
    assert np.abs(np.array([result[name] for name in result if name != "centre"]) - expected).max() < 1e-14
    sizes = [np.linalg.norm(result[a] - result[b], axis=0) for a, b, _ in links]
    assert sorted(np.round(size[-1], 9) for size in sizes) == [1] * 4 + [2] * 4 + [4] * 4


@pytest.mark.parametrize(("kind", "size", "count"), [("ellipsoid", (3, 2, 1), 72), ("disc", 2, 26), ("axes", 2, 3)])
def test_outlines_lie_on_their_surface(kind: str, size: Any, count: int) -> None:
    made = lg.shape(kind, None, size)
    places = np.array(made.corners, dtype=float)
    sizes = np.array(size) * np.ones(3)
    assert len(made.edges) == count
    on = np.linalg.norm(places / sizes, axis=1)
    assert np.all((np.abs(on - 1) < 1e-5) | (on == 0))
    assert (kind == "disc") == bool((places[:, 2] == 0).all())


def test_corners_have_neither_a_mark_nor_a_path() -> None:
    hidden = corners(boxed().statement.links)
    assert len(hidden) == 8 and "centre" not in hidden
    axis = boxed().run(1.0).plot("path").axes[0]
    marks = [line for line in axis.lines if line.get_marker() == "o"]
    assert len(marks) == 2  # the start and the end of the centre


def test_a_picture_of_a_body_alone_has_its_time_as_title() -> None:
    figure = thrown(box=lg.shape("box", R, 1)).run(1.0).plot("path")
    assert figure.axes[0].get_title(loc="left") == "at t = 1"


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a kind": (lambda: lg.shape("cube", R, 1), "the shape 'cube' is not known: give one of box, ellipsoid, disc"),
    "no rotation": (lambda: lg.shape("box", R.T, 1), "the rotation of a shape is .*: give a rotation R, or None"),
    "two sides": (lambda: lg.shape("box", R, (1, 2)), r"the size of a shape is \(1, 2\): give three values, or one"),
    "a place in the plane": (lambda: lg.shape("box", R, 1, at=(x, y)), "the place of a shape is .*: give three values"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_a_shape_is_refused(case: str) -> None:
    attempt, sentence = REFUSED[case]
    assert re.search(sentence, refusal(attempt))


def test_a_scene_states_a_body_by_its_shape(tmp_path: Path) -> None:
    system = thrown(disc=lg.shape("disc", R, (1, 2, 0), at=(x, y, z)), still=lg.shape("box", None, 2))
    path = tmp_path / "body.toml"
    path.write_text(STATED.replace("[1, 2, 0]", "[1, 'R_xx*0 + 2', 0]"))
    result = lg.System.from_scene(path).statement
    assert result.links == system.statement.links
    assert result.positions == system.statement.positions


STATED = """
coordinates = ["x", "y", "z"]
rotations = ["R"]
kinetic = "(x_dot**2 + y_dot**2 + z_dot**2 + R_body_x**2 + R_body_y**2 + R_body_z**2)/2"
potential = "z"
[positions]
disc = { shape = "disc", size = [1, 2, 0], rotation = "R", at = ["x", "y", "z"] }
still = { shape = "box", size = 2 }
"""

REFUSED_SCENES: dict[str, tuple[str, str, str]] = {
    "another key": ('shape = "box"', 'shape = "box", side = 2', "side.*is not a key of a shape"),
    "no size": ('shape = "box", size = 2', 'shape = "box"', 'has no shape or no size: write shape = "disc" and size'),
    "another rotation": ('rotation = "R"', 'rotation = "S"', "the rotation of a shape must be one of this scene: R"),
    "in the plane": ("[positions]", '[positions]\\ntip = ["x", "y"]', "positions mixes points in the plane"),
}


@pytest.mark.parametrize("case", REFUSED_SCENES)
def test_what_is_not_a_shape_in_a_scene_is_refused_at_its_line(case: str, tmp_path: Path) -> None:
    old, new, sentence = REFUSED_SCENES[case]
    path = tmp_path / "body.toml"
    path.write_text(STATED.replace(old, new.replace("\\n", "\n")))
    with pytest.raises(lg.SceneError, match=sentence) as refusal:
        lg.System.from_scene(path)
    assert refusal.value.line is not None


def test_an_overview_has_the_rates_of_bodies() -> None:
    run = boxed().run(1.0)
    figure = run.plot()
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert sum("R_{" in title for title in titles) == 3
    shown = [np.asarray(axis.lines[0].get_ydata())[0] for axis in figure.axes[3:6]]
    assert np.allclose(shown, run[R.body][:, 0])


def test_runs_are_named_by_the_rates_that_they_start_with() -> None:
    runs = [boxed().run(1.0, {R.body: (rate, 0, 0)}) for rate in (1, 2)]
    assert labels_of(runs, None) == ["R_body_x = 1", "R_body_x = 2"]
