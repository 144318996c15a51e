"""Sliders in a notebook: the page with the chosen ones, or sliders that run in Python and say why."""

from __future__ import annotations

import sys
from html import unescape
from importlib.util import find_spec
from typing import Any

import pytest
from sympy import erf

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.page.explore import explored_sliders
from lagrange.page.sliders import PARAMETER
from tests.page.test_page import data_of
from tests.refusals import refusal
from tests.show.animations import in_page
from tests.show.notebook.shown import HOSTILE

needs_widgets = pytest.mark.skipif(find_spec("ipywidgets") is None, reason="ipywidgets is not installed")


def test_a_notebook_shows_the_page_with_the_chosen_sliders_first() -> None:
    system = lg.scene("double-pendulum")
    shown = system.explore(l1=(0.5, 0.8), theta2_dot=(-5, 5), t_end=4.0, play=False, style="dark")._repr_html_()
    assert shown.startswith('<iframe title="sliders of double-pendulum" sandbox="allow-scripts"')
    page = unescape(shown.partition('srcdoc="')[2])
    data = data_of(page)
    assert [(slider["kind"], slider["place"], slider["value"]) for slider in data["sliders"][:2]] == [
        ("parameter", 2, 0.8),
        ("state", 3, 0.0),
    ]
    assert (data["t_end"], data["play"]) == (4.0, False) and 'data-style="dark"' in page
    assert "class Motion" in page and "Equations of motion" not in page


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({"thetta1": (0, 1)}, "there is no slider of 'thetta1', which is not a parameter, coordinate or velocity of "),
        ({"thetta1": (0, 1)}, "Did you mean 'theta1'?"),
        ({"m3": (0, 1)}, "they are m1, m2, l1, l2, g, theta1, theta2, theta1_dot and theta2_dot."),
        ({"l1": (1, "x")}, "a bound of the slider of l1"),
        ({}, "no slider was asked for: give bounds such as explore(m1=(0, 2)), for one of m1, m2,"),
        ({"l1": (0, 0)}, "the slider of l1 goes from 0 to 0, and has no room to move: give a lower and an upper bound"),
        ({"l1": (3, 3)}, "such as (1.5, 6.0)."),
        ({"l1": (0, 1, 2)}, "the slider of l1 is (0, 1, 2): give its lower and its upper bound"),
        ({"l1": ()}, "the slider of l1 is (): give its lower and its upper bound"),
        ({"l1": {0: 1, 2: 3}}, "the slider of l1 is {0: 1, 2: 3}: give its lower and its upper bound"),
    ],
)
def test_what_is_no_slider_is_refused(ranges: dict[str, Any], words: str) -> None:
    assert words in refusal(lg.scene("double-pendulum").explore, **ranges)


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


def special(**more: Any) -> lg.System:
    """Return a system whose energy JavaScript cannot compute."""
    x = lg.coordinate("x")
    k = lg.parameters("k")
    statement = {"kinetic": x.dot**2 / 2, "potential": k * erf(x) ** 2, "parameters": {k: 1.0}, "initial": {x: 1.0}}
    return lg.System(**{**statement, "name": "special", **more})


def test_without_ipywidgets_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    assert refusal(special().explore, k=(0.5, 2)) == (
        "A page of special cannot be made: its rhs contains erf, which JavaScript has no function for. The sliders "
        "run in Python. They need ipywidgets, which is not installed: pip install ipywidgets, which the extra notebook "
        "has, and start the kernel again."
    )
    assert lg.scene("pendulum").explore(l=(0.5, 2)), "a page needs no widgets"


@needs_widgets
def test_where_no_page_can_be_made_sliders_run_in_python_and_say_why() -> None:
    box = special(name=HOSTILE).explore(k=(1, 2), x_dot=(-3, 3), t_end=2.0)
    title, k, speed, picture, message = box.children
    assert "<script" not in title.value and "which JavaScript has no function for" in title.value
    assert k.step is None, "a browser shows the next step and not the value"
    assert (speed.description, speed.value, speed.min, speed.max) == ("x_dot at t = 0", 0.0, -3.0, 3.0)
    before = in_page(unescape(picture.value.partition('srcdoc="')[2]))
    speed.value = 1.5
    after = in_page(unescape(picture.value.partition('srcdoc="')[2]))
    assert [data["rows"][1, 0] for data in (before, after)] == pytest.approx([0.0, 1.5], abs=1e-3)
    assert message.value == "taylor reached t = 2."


@needs_widgets
def test_another_method_runs_in_python() -> None:
    title, *_, message = lg.scene("pendulum").explore(l=(0.5, 2), t_end=1.0, method="verner9").children
    assert "A page computes with dop853, and method = &#x27;verner9&#x27; is asked for." in title.value
    assert message.value.startswith("verner9 reached t = 1")


@needs_widgets
def test_a_run_that_fails_says_so_and_the_picture_stays() -> None:
    x = lg.coordinate("x")
    falling = special(kinetic=x.dot**2 / 2, potential=lg.parameters("k") * erf(x) - 1 / x)
    *_, speed, picture, message = falling.explore(x_dot=(-9, 9), t_end=1.0).children
    speed.value = -9.0
    assert message.value.startswith("<b>The run did not get to its end.</b> ")
    assert picture.value
