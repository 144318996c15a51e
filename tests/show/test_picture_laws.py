"""Laws of all pictures: curves within a pixel, labels without overlap, no offsets, distinguishable lines."""

from __future__ import annotations

import io
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import lagrange as lg
from lagrange.show.figures.curve import first_times
from lagrange.show.figures.paths import common_view, named_points
from lagrange.show.figures.style import DARK, LIGHT, STYLES, line_styles
from lagrange.trajectory.measures.times_and_points import fixed_points
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray
from tests.models import SCENE_NAMES
from tests.show.examples import oscillator, x
from tests.show.polylines import farthest

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


def curves_are_exact(run: Solution) -> None:
    """Assert that all curves of a picture are within a pixel of states at 50 times as many times."""
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
    fixed = fixed_points(run.model.statement)
    exact = [view.of(points) for name, points in named_points(run, late).items() if not fixed[name]]
    where = np.concatenate([seen(path, points) for points in exact], axis=1)
    assert (
        farthest(where[:, :: max(1, where.shape[1] // 200_000)], [seen(path, line.get_xydata().T) for line in lines])
        < 1
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("end", [None, 100.0])
@pytest.mark.parametrize("name", SCENES)
def test_curves_are_within_a_pixel_of_the_exact_ones(name: str, end: float | None) -> None:
    scene = lg.scene(name)
    curves_are_exact(scene.run() if end is None else scene.run(end))


def test_a_drift_of_the_dense_output_is_told_apart_from_the_steps() -> None:
    run = lg.scene("pendulum").run(10.0, method=lg.methods.Gauss3(step=0.2))
    axis = run.plot().axes[1]
    assert "at the steps (the dense output between them: up to" in axis.get_title("left")
    (line,) = axis.lines
    assert (
        line.get_linestyle() == "None" and line.get_marker() == "o" and np.shape(line.get_xydata()) == (len(run.t), 2)
    )
    smooth = lg.scene("pendulum").run(10.0, rtol=1e-6).plot().axes[1]
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
    nothing_overlaps(lg.scene(name).run(max_steps=2000).plot())


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
    figure = drawn(lg.scene("spherical-pendulum").run(3.0).plot(["coordinates", "path", "phase"], style="dark"))
    paper = to_rgb(DARK.paper)
    assert to_rgb(figure.get_facecolor()) == paper
    for axis in figure.axes:
        assert to_rgb(axis.get_facecolor()) == paper
        texts = [*axis.texts, axis._left_title, axis.xaxis.label, axis.yaxis.label, *axis.get_xticklabels()]
        assert all(contrast(text.get_color(), DARK.paper) > 7 for text in texts if text.get_text())
