"""Sliders: what they move is the run for their values, the picture shows it, and what cannot be is said."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from importlib.util import find_spec
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from PIL import Image
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.show.figures.style import DARK, LIGHT, Style
from lagrange.show.notebook.explore import Exploration, explored_sliders
from lagrange.show.sliders import PARAMETER
from tests.show.notebook.shown import HOSTILE

needs_widgets = pytest.mark.skipif(find_spec("ipywidgets") is None, reason="ipywidgets is not installed")


def points(line: Any) -> Any:
    """Return the points of a line, (N, 2)."""
    return line.get_xydata()


def pixels(png: bytes) -> Any:
    with Image.open(BytesIO(png)) as image:
        return np.asarray(image.convert("RGB"))


def exploration(system: lg.System, ranges: Any, style: Style = LIGHT, t_end: float = 2.0) -> Exploration:
    sliders = explored_sliders(system.statement, ranges, {})

    def run(initial: Mapping[str, float], parameters: Mapping[str, float]) -> lg.Solution:
        return system.run(t_end, initial, parameters=parameters)

    return Exploration(system.statement, sliders, run, style)


def drawn(made: Exploration) -> dict[str, Any]:
    """Return where the points are in the panel of positions, by name."""
    picture = made._drawn
    return {name: points(dot)[0] for name, dot in zip(picture._names, picture._dots, strict=True)}


def seen(made: Exploration, colour: str) -> int:
    """Return how many pixels of the left panel have about the hue of a colour, the dot at the time apart."""
    image = pixels(made.picture).astype(int)
    image = image[:, : image.shape[1] // 2]
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    faint = (0.6 * wanted + 0.4 * 255).astype(int)
    return int((np.abs(image - faint).max(axis=2) < 12).sum())


def test_the_picture_has_the_points_of_the_run_for_the_values_of_the_sliders() -> None:
    system = lg.scene("double-pendulum")
    made = exploration(system, {"l1": (0.1, 2.0), "theta1": (0.0, 3.0), "theta2_dot": (-5.0, 5.0)})
    assert made.values == {"l1": 1.0, "theta1": pytest.approx(np.pi / 6), "theta2_dot": 0.0}
    made.change({"l1": 1.5, "theta1": 2.0})
    made.change({"theta2_dot": 1.0})
    made.move(0.5)
    solution = system.run(2.0, {"theta1": 2.0, "theta2_dot": 1.0}, parameters={"l1": 1.5})
    a, b = solution.at(made._drawn._times[len(made._drawn._times) // 2])[:2]
    bob1 = np.array([1.5 * np.sin(a), -1.5 * np.cos(a)])
    np.testing.assert_allclose(drawn(made)["bob1"], bob1, rtol=1e-9)
    np.testing.assert_allclose(drawn(made)["bob2"], bob1 + np.array([np.sin(b), -np.cos(b)]), rtol=1e-9)
    path = points(made._drawn._paths[0])
    np.testing.assert_allclose(np.hypot(*path.T), 1.5, rtol=1e-9)
    assert seen(made, str(made._drawn._paths[0].get_color())) > 100
    link = points(made._drawn._links[1])
    np.testing.assert_allclose(link, [drawn(made)["bob1"], drawn(made)["bob2"]])
    curve = made._drawn._curve.get_ydata()
    assert np.abs(curve).max() == pytest.approx(solution.drift.relative, rel=0.5)
    assert made.complete and made.message.startswith("taylor reached t = 2. Energy drift ")


def test_every_change_is_seen_and_time_moves_points_alone() -> None:
    made = exploration(lg.scene("double-pendulum"), {"l1": (0.1, 2.0)})
    first = made.picture
    made.move(0.7)
    moved = made.picture
    made.change({"l1": 1.1})
    assert len({first, moved, made.picture}) == 3
    left, right = np.hsplit(np.abs(pixels(first).astype(int) - pixels(moved)).sum(axis=2) > 0, 2)
    assert 0 < left.mean() < 0.05 and 0 < right.mean() < 0.02
    made.change({"l1": 1.0})
    made.move(0.0)
    again = made.picture
    assert np.mean(pixels(again) != pixels(first)) < 0.06, "limits may have changed, what is drawn has not"


def test_limits_stay_while_they_fit() -> None:
    made = exploration(lg.scene("double-pendulum"), {"l1": (0.1, 9.0)})
    axis = made._drawn._place
    before = axis.get_xlim()
    made.change({"l1": 0.95})
    assert axis.get_xlim() == before
    numbers = pixels(made.picture)[:, :80]
    made.change({"l1": 9.0})
    assert axis.get_xlim()[1] > before[1]
    assert (pixels(made.picture)[:, :80] != numbers).any(), "new limits have new numbers"
    x, y = np.ptp(axis.get_xlim()), np.ptp(axis.get_ylim())
    box = axis.get_window_extent()
    assert x / box.width == pytest.approx(y / box.height), "lengths are equal in both directions"


def test_without_positions_the_coordinates_are_drawn_and_it_is_said() -> None:
    x, y = lg.coordinates("x y")
    k = lg.parameters("k")
    system = lg.System(x.dot**2 / 2 + y.dot**2 / 2, k * x**2 / 2 + y**2 / 2, parameters={k: 4.0}, initial={x: 1.0})
    made = exploration(system, {"k": (1.0, 9.0)}, t_end=np.pi)
    assert made.message.endswith("No positions are stated: the coordinates are drawn.")
    made.change({"k": 9.0})
    line = points(made._drawn._paths[0])
    np.testing.assert_allclose(line[:, 1], np.cos(3.0 * line[:, 0]), atol=1e-7)
    made.move(1.0)
    np.testing.assert_allclose(drawn(made)["x"], [np.pi, -1.0], atol=1e-7)


@pytest.mark.parametrize("scene", ["spherical-pendulum", "chain-of-springs", "falling-ball", "mass-on-spring"])
def test_space_springs_and_straight_lines_are_drawn(scene: str) -> None:
    system = lg.scene(scene)
    name = system.statement.parameters[0].name
    made = exploration(system, {name: (0.5, 3.0)}, DARK)
    made.change({name: 2.0})
    made.move(0.6)
    image = pixels(made.picture)
    paper = tuple(int(DARK.paper[k : k + 2], 16) for k in (1, 3, 5))
    assert tuple(image[0, 0]) == paper and 0.7 < np.mean((image == paper).all(axis=2)) < 0.99


def test_a_run_that_fails_says_so_and_the_picture_stays() -> None:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    system = lg.System(m * theta.dot**2 / 2, k * theta**2 / 2, parameters={m: 1.0}, initial={theta: 1.0})
    made = exploration(system, {"m": (1.0, 2.0)})
    assert not made.complete and "k" in made.message and pixels(made.picture).shape[2] == 3
    open_ended = exploration(system, {"k": (1.0, 2.0)})
    assert open_ended.complete and open_ended.values == {"k": 1.5}

    falling = lg.System(theta.dot**2 / 2, -k / theta, parameters={k: 1.0}, initial={theta: 1.0})
    collision = exploration(falling, {"k": (1.0, 2.0), "theta_dot": (-3.0, 3.0)})
    before = collision.picture
    assert not collision.complete and "theta" in collision.message
    collision.change({"theta_dot": 3.0})
    assert collision.complete and collision.picture != before


def test_a_change_takes_less_than_a_tenth_of_a_second() -> None:
    made = exploration(lg.scene("double-pendulum"), {"l1": (0.1, 2.0)}, t_end=10.0)
    times = []
    for k in range(8):
        began = time.thread_time()
        made.change({"l1": 0.9 + 0.02 * k})
        times.append(time.thread_time() - began)
    assert min(times) < 0.1


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        (
            {"thetta1": (0, 1)},
            "there is no slider of 'thetta1', which is no parameter, coordinate or velocity of ",
        ),
        ({"thetta1": (0, 1)}, "Did you mean 'theta1'?"),
        ({"m3": (0, 1)}, "they are m1, m2, l1, l2, g, theta1, theta2, theta1_dot and theta2_dot."),
        ({"l1": 2.0}, "the slider of l1 is 2.0: give its lower and its upper bound, such as (0.5, 2.0)."),
        ({"l1": "ab"}, "the slider of l1 is 'ab': give its lower and its upper bound, such as (0.5, 2.0)."),
        ({"l1": (2, 1)}, "the slider of l1 goes from 2 to 1: give the lower bound first, (1, 2)."),
        ({"l1": (1, "x")}, "a bound of the slider of l1"),
        ({}, "no slider was asked for: give bounds such as explore(m1=(0, 2)), of m1, m2,"),
        ({"l1": (0, 0)}, "the slider of l1 goes from 0 to 0, and has no room to move: give a lower and an upper bound"),
        ({"l1": (3, 3)}, "such as (1.5, 6.0)."),
        ({"l1": (0, 1, 2)}, "the slider of l1 is (0, 1, 2): give its lower and its upper bound"),
        ({"l1": ()}, "the slider of l1 is (): give its lower and its upper bound"),
        ({"l1": {0: 1, 2: 3}}, "the slider of l1 is {0: 1, 2: 3}: give its lower and its upper bound"),
        ({"l1": (0, math.nan)}, "a bound of the slider of l1 is nan"),
    ],
)
def test_what_is_no_slider_is_refused(ranges: dict[str, Any], words: str) -> None:
    with pytest.raises(StatementError) as refusal:
        lg.scene("double-pendulum").explore(**ranges)
    assert words in str(refusal.value)


def test_there_is_room_for_so_many_sliders() -> None:
    names = [f"{q.func.__name__}{rate}" for q in lg.scene("pleiades").coordinates for rate in ("", "_dot")]
    with pytest.raises(StatementError, match="28 sliders were asked for, and there is room for 12"):
        lg.scene("pleiades").explore(dict.fromkeys(names, (0, 1)))


def test_ranges_by_symbol_and_by_keyword_are_taken_together() -> None:
    system = lg.scene("pendulum")
    (theta,) = system.coordinates
    found = explored_sliders(system.statement, {theta.dot: (-1, 1), theta: (3, 4)}, {"l": (2, 3)})
    assert [(one.name, one.value, one.kind == PARAMETER) for one in found] == [
        ("theta_dot", 0.0, False),
        ("theta", 3.0, False),
        ("l", 2.0, True),
    ]
    with pytest.raises(StatementError, match="says no sliders: give a dict"):
        explored_sliders(system.statement, [("l", (1, 2))], {})


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"style": "blue"}, "give one of light and dark"), ({"t_end": "x"}, "t_end"), ({"method": "rk5"}, "rk5")],
)
def test_wrong_options_are_refused_before_anything_is_drawn(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(StatementError, match=words):
        lg.scene("pendulum").explore(l=(0.5, 2), **wrong)


def test_without_ipywidgets_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(StatementError, match="pip install ipywidgets, which the extra notebook has"):
        lg.scene("pendulum").explore(l=(0.5, 2))


@needs_widgets
def test_widgets_move_the_picture_and_show_the_message() -> None:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    start = {theta: 1.0, theta.dot: 3.0}
    system = lg.System(m * theta.dot**2 / 2, -k / theta, parameters={m: 1.0, k: 1.0}, initial=start, name=HOSTILE)
    box = system.explore({theta.dot: (-3, 3)}, k=(1, 2), t_end=1.0)
    title, speed, k_slider, row, picture, message = box.children
    player, place = row.children
    assert "<script" not in title.value and "&lt;script&gt;" in title.value
    assert speed.step is None, "a browser shows the next step and not the value"
    assert (speed.description, k_slider.description) == ("theta_dot at t = 0", "k")
    assert (speed.value, speed.min, speed.max, k_slider.value) == (3.0, -3.0, 3.0, 1.0)
    seen = [picture.value]
    k_slider.value = 2.0
    seen.append(picture.value)
    assert message.value.startswith("taylor reached t = 1.")
    place.value = place.max // 2
    seen.append(picture.value)
    assert len(set(seen)) == 3 and player.max == place.max
    speed.value = -3.0
    assert message.value.startswith("<b>The run did not get to its end.</b> ")
    assert len(system.explore(k=(1, 2), play=False).children[2].children) == 1


def test_a_first_run_that_is_refused_leaves_an_empty_picture_and_says_why() -> None:
    system = lg.scene("henon-heiles")

    def refused(*_: Any) -> Any:
        raise StatementError("no run today.")

    sliders = explored_sliders(system.statement, {"x": (0.0, 1.0)}, {})
    made = Exploration(system.statement, sliders, refused, LIGHT)
    assert (made.complete, made.message) == (False, "no run today.") and made.picture.startswith(b"\x89PNG")
    made.move(0.5)


def test_fixed_points_are_marks_without_a_colour_and_a_legend_entry() -> None:
    theta, l = lg.coordinate("theta"), lg.parameters("l")
    system = lg.System(
        l**2 * theta.dot**2 / 2,
        -l * cos(theta),
        parameters={l: 1},
        initial={theta: 1},
        positions={"pivot": (0, l), "bob": (l * sin(theta), l - l * cos(theta)), "tip": (2 * l * sin(theta), l)},
    )
    drawn = exploration(system, {"l": (0.5, 2)})._drawn
    legend = drawn._place.get_legend()
    assert legend is not None and [text.get_text() for text in legend.get_texts()] == ["bob", "tip"]


def test_a_level_energy_of_any_size_has_limits() -> None:
    x = lg.coordinate("x")
    system = lg.System(lagrangian=x.dot**2 / 2 + 1e12 * x.dot - sin(lg.t) * 1e-9, initial={x: 0, x.dot: 1e6})
    assert exploration(system, {"x": (0.0, 1.0)}).picture
