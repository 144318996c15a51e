"""Parts of figures: empty panels for what a user draws, springs, colours."""

from __future__ import annotations

import pickle
import struct
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import lagrange as lg
from lagrange.show.figures.paths import SPRING_TURNS, spring
from lagrange.show.figures.style import DARK, LIGHT, new_figure
from lagrange.show.files.picture import MOST_BYTES, bounded_png
from tests.show.examples import oscillator


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
    with pytest.raises(lg.StatementError, match=message):
        lg.figure(**options)


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
        lambda: lg.scene("pendulum").plot_eigenvalues("l", np.linspace(0.5, 2.0, 5), {"theta": 0}),
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
    assert len(written(figure)) > MOST_BYTES
    png = bounded_png(figure, 160)
    assert size(png) == (960, 640) and len(png) <= MOST_BYTES


def written(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=160)
    return file.getvalue()


def test_a_figure_pickles() -> None:
    figure = oscillator().plot()
    again = pickle.loads(pickle.dumps(figure))
    assert type(again) is type(figure) and png_of(again)[0] == png_of(figure)[0]


def test_an_empty_figure_has_a_name() -> None:
    assert repr(new_figure()) == "<figure, 0 panels: .savefig(path) writes it to a file>"
