"""Pictures and cards of dynamics show the computed results, also in a user's axes, light and dark."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from sympy import cos

import lagrange as lg
from lagrange.dynamics.axes import TURN
from lagrange.errors import StatementError
from lagrange.show.dynamics import Drawn
from lagrange.show.figures.dynamics_figures import MOST_MODES, PANEL_HEIGHT, PANEL_WIDTH
from lagrange.show.figures.style import DARK
from tests.dynamics.planar import damped_pendulum, duffing, hoop, pendulum, star, theta, x, y
from tests.models import shared_scene

RECORDS: dict[str, Callable[[], Any]] = {
    "portrait": lambda: lg.phase_portrait(damped_pendulum(), starts=[{theta: 2.0}]),
    "section": lambda: lg.poincare(
        star(), lg.event(x, direction=1), [{y: 0.3}], energy=0.1, solve_for=x.dot, crossings=20
    ),
    "sweep": lambda: lg.bifurcation(duffing(), "F", [0.2, 0.28], points=8, skip=100),
    "branches": lambda: lg.bifurcation(hoop(), "w", (2.0, 8.0, 10)),
}


@cache
def recorded(kind: str) -> Any:
    """Return a result of a kind, such as a phase portrait."""
    return RECORDS[kind]()


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", RECORDS)
def test_a_record_has_a_card_a_picture_and_a_file(kind: str, tmp_path: Path) -> None:
    record = recorded(kind)
    assert isinstance(record, Drawn)
    figure = record.plot(style="dark")
    assert isinstance(figure, Figure)
    assert figure.get_facecolor() == pytest.approx([*bytes.fromhex(DARK.paper[1:]), 255] / np.array(255.0))
    assert repr(record).startswith(f"{record.statement.name}: success\n")
    page = record._repr_html_()
    assert page.startswith("<table>")
    assert len(re.sub(r"base64,[^']*", "", page)) < 20_000
    assert 1000 < len(page) <= 400_000 + 20_000  # 300,000 bytes of a picture are four thirds as many letters
    written = record.to_png(tmp_path / "picture.png", dpi=50)
    assert written.read_bytes().startswith(b"\x89PNG")
    assert repr(pickle.loads(pickle.dumps(record))) == repr(record)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", RECORDS)
def test_a_picture_is_drawn_on_axes_of_the_users(kind: str) -> None:
    record = recorded(kind)
    figure = lg.figure(columns=2)
    left, right = figure.axes[:2]
    assert record.plot(ax=left) is figure
    assert left.has_data()
    assert not right.has_data()
    wrong: Any = "left"
    with pytest.raises(StatementError, match="ax is 'left': give axes of Matplotlib, or leave it out"):
        record.plot(ax=wrong)
    with pytest.raises(StatementError, match="style = 'blue' is not known"):
        record.plot(style="blue")


def lines_of(axis: Axes, colour: str) -> list[Any]:
    return [np.array(line.get_xydata()) for line in axis.get_lines() if line.get_color() == colour]


def test_orbits_are_drawn_within_a_pixel_and_wrapped() -> None:
    """Orbits are compared with the level curve of the energy. A pixel is window/WIDTH by window/HEIGHT."""
    result = lg.phase_portrait(pendulum(), starts=[{theta: 2.5}, {theta.dot: 2.5}])
    (axis,) = result.plot().axes
    drawn = lines_of(axis, "#0b6e99")
    assert len(drawn) == 2
    for line, energy in zip(drawn, (-np.cos(2.5), 2.5**2 / 2 - 1), strict=True):
        good = np.isfinite(line).all(axis=1)
        assert (np.abs(line[good, 0]) <= np.pi + 1e-12).all()
        both = good[1:] & good[:-1]
        middle = (line[1:][both] + line[:-1][both]) / 2
        gradient = np.column_stack(
            [np.sin(middle[:, 0]) * TURN / PANEL_WIDTH, middle[:, 1] * result.plane[1].width / PANEL_HEIGHT]
        )
        off = np.abs(middle[:, 1] ** 2 / 2 - np.cos(middle[:, 0]) - energy) / np.maximum(
            np.linalg.norm(gradient, axis=1), 1e-9
        )
        assert off.max() < 1.0
    # The one that turns over goes out on one side and in on the other.
    assert np.isnan(drawn[1]).any()
    assert np.nanmax(drawn[1][:, 0]) == pytest.approx(np.pi)
    assert np.nanmin(drawn[1][:, 0]) == pytest.approx(-np.pi)


def test_a_portrait_marks_equilibria_and_says_what_is_what() -> None:
    (axis,) = recorded("portrait").plot().axes
    legend = axis.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[2:] == ["separatrix from the saddle", "separatrix to the saddle", "saddle", "stable spiral"]
    assert texts[0] == r"$\dot{\theta} = 0$"
    assert [tick.get_text() for tick in axis.get_xticklabels()] == [r"$-\pi$", r"$-\pi/2$", "$0$", r"$\pi/2$", r"$\pi$"]
    assert axis.get_ylabel() == r"$\dot{\theta}$"


def test_a_section_draws_the_entries_that_are_asked_for() -> None:
    section = recorded("section")
    (axis,) = section.plot(x=y.dot, y="x_dot").axes
    (points,) = [line.get_xydata() for line in axis.get_lines()]
    assert points == pytest.approx(section.points[:, [3, 2]])
    (axis,) = section.plot().axes
    assert len(axis.get_lines()) == 2  # the border too
    with pytest.raises(StatementError, match="x names 'z', which is not a coordinate or velocity of this system"):
        section.plot(x="z")
    with pytest.raises(StatementError, match="entry names 'z'"):
        recorded("sweep").plot("z")
    with pytest.raises(StatementError, match="velocities are zero at equilibria: give a coordinate, such as theta"):
        recorded("branches").plot(theta.dot)


def test_branches_meet_where_they_bifurcate() -> None:
    (axis,) = recorded("branches").plot().axes
    ends = [line[np.isfinite(line).all(axis=1)][0] for line in lines_of(axis, "#0b6e99")]
    critical = np.sqrt(9.81 / 0.5)
    forks = [end for end in ends if end[0] > 2.1]
    assert len(forks) == 2
    assert np.array(forks) == pytest.approx(np.array([[critical, 0.0]] * 2), abs=1e-5)


def test_modes_are_drawn_as_bars_and_on_the_positions() -> None:
    modes = shared_scene("double-pendulum").modes()
    figure = modes.plot()
    assert len(figure.axes) == 4
    heights = [bar.get_height() for bar in figure.axes[0].patches if isinstance(bar, Rectangle)]
    shapes = modes.shapes_in_numbers()
    assert heights == pytest.approx(shapes.components[0])
    assert figure.axes[0].get_title("left").startswith("mode 1: $\\omega$ = ")
    # Where nothing is stated to draw there are bars alone, as on axes of the user's.
    bare = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=x**2 + 2 * y**2).modes()
    assert len(bare.plot().axes) == 2
    mine = lg.figure().axes[0]
    bare.plot(ax=mine)
    assert len(mine.patches) == 4
    assert repr(pickle.loads(pickle.dumps(bare))) == repr(bare)


def test_titles_of_modes_say_how_they_move_and_many_modes_are_left_out() -> None:
    several: Any = lg.coordinates(" ".join(f"q{k}" for k in range(10)))
    chain = lg.System(
        kinetic=sum(q.dot**2 / 2 for q in several),
        potential=sum((k + 1) * q**2 / 2 for k, q in enumerate(several)),
        forces={several[0]: -several[0].dot / 5},
    )
    figure = chain.modes().plot()
    assert len(figure.axes) == MOST_MODES
    assert figure.get_supxlabel() == "2 more modes not drawn."
    assert ", decay 0.1" in figure.axes[0].get_title("left")
    upright = lg.System(kinetic=theta.dot**2 / 2, potential=cos(theta) + y**2 * 0, coordinates=[theta]).modes()
    assert upright.plot().axes[0].get_title("left") == "mode 1: grows, rate 1"
    free = lg.System(kinetic=x.dot**2 / 2 + y.dot**2 / 2, potential=(x - y) ** 2 / 2).modes()
    assert free.plot().axes[0].get_title("left") == "mode 1: moves freely"
