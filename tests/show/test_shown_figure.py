"""Figures show themselves: the PNG that a notebook takes, its bounds, and that they are Matplotlib's in all else."""

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
from lagrange.show.figures.style import new_figure
from lagrange.show.files.picture import MOST_BYTES, bounded_png
from tests.show.examples import oscillator


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
