"""Sliders in a notebook: the page with the chosen ones first."""

from __future__ import annotations

from html import unescape
from typing import Any

import pytest

import lagrange as lg
from lagrange.errors import StatementError
from tests.page.test_page import data_of
from tests.refusals import refusal


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
        ({"thetta1": (0, 1)}, "Did you mean 'theta1'?"),
        ({"l1": (1, "x")}, "a bound of the slider of l1"),
        ({}, "no slider was asked for: give bounds such as explore(m1=(0, 2)), for one of m1, m2,"),
        ({"l1": (3, 3)}, "such as (1.5, 6.0)."),
        ({"l1": {0: 1, 2: 3}}, "the slider of l1 is {0: 1, 2: 3}: give its lower and its upper bound"),
    ],
)
def test_what_is_no_slider_is_refused(ranges: dict[str, Any], words: str) -> None:
    assert words in refusal(lg.scene("double-pendulum").explore, **ranges)


def test_there_is_room_for_so_many_sliders() -> None:
    names = [f"{q.func.__name__}{rate}" for q in lg.scene("pleiades").coordinates for rate in ("", "_dot")]
    with pytest.raises(StatementError, match="28 sliders were asked for: give bounds for at most 12"):
        lg.scene("pleiades").explore(dict.fromkeys(names, (0, 1)))


def test_ranges_by_symbol_and_by_keyword_are_taken_together() -> None:
    system = lg.scene("pendulum")
    (theta,) = system.coordinates
    page = system.explore({theta.dot: (-1, 1), theta: (3, 4)}, l=(2, 3)).html
    sliders = [(slider["kind"], slider["value"]) for slider in data_of(page)["sliders"][:3]]
    assert sliders == [("state", 0.0), ("state", 3.0), ("parameter", 2.0)]
    assert "sliders is [('l', (1, 2))]: give a dict" in refusal(system.explore, [("l", (1, 2))])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"style": "blue"}, "give one of light and dark"), ({"t_end": "x"}, "t_end")],
)
def test_wrong_options_are_refused_before_anything_is_drawn(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(StatementError, match=words):
        lg.scene("pendulum").explore(l=(0.5, 2), **wrong)
