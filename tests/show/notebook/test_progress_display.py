"""Progress in a notebook: few updates, the last of them where the work ended, and nothing where nobody sees it."""

from __future__ import annotations

import time
from typing import Any

import pytest
from sympy import cos

import lagrange as lg
from lagrange.statement import progress

pytest.importorskip("IPython", reason="IPython is not installed")


X = lg.coordinate("x")
PENDULUM = lg.System(
    kinetic=X.dot**2 / 2,
    potential=-cos(X),
    forces={X: -lg.parameters("c") * X.dot},
    parameters={"c": 0.1},
    initial={X: 1.0},
)


class Display:
    """What IPython's display() gives: a handle whose updates are kept."""

    def __init__(self) -> None:
        self.shown: list[Any] = []

    def __call__(self, value: Any, display_id: bool) -> Display:
        self.shown.append(value)
        return self

    def update(self, value: Any) -> None:
        self.shown.append(value)


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Display:
    made = Display()
    monkeypatch.setattr("IPython.display.display", made)
    monkeypatch.setattr(progress, "in_notebook", lambda: True)
    return made


def test_the_last_state_is_shown_however_quick_the_work_was(display: Display) -> None:
    with progress.progress_bar((2.0, 0.0), enabled=True) as report:
        assert report is not None
        for k in range(1000):
            report(2.0 - k / 1000)
    assert len(display.shown) < 100
    assert display.shown[-1].share == pytest.approx(0.4995) and display.shown[-1].text.startswith("t = 1.001, ")
    assert repr(display.shown[0]).startswith("  0%  t = 2, ")


def test_work_that_raises_leaves_the_bar_where_it_was(display: Display) -> None:
    def work() -> None:
        with progress.progress_bar((0.0, 4.0), enabled=True) as report:
            assert report is not None
            report(1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert "value='0.250'" in display.shown[-1]._repr_html_()


@pytest.mark.few
@pytest.mark.parametrize(
    ("call", "last"),
    [
        (lambda: lg.phase_portrait(PENDULUM, starts=[{"x": 1.0}, {"x": 2.0}], progress=True), "2 of 2 orbits, "),
        (lambda: lg.phase_portrait(PENDULUM, progress=True), "484 of 484 cells, "),
        (lambda: lg.poincare(PENDULUM, X, [{"x": 1.0}, {"x": 2.0}], crossings=3, progress=True), "2 of 2 orbits, "),
        (
            lambda: lg.bifurcation(PENDULUM, "c", [0.1, 0.2], section=X, points=2, skip=0, progress=True),
            "2 of 2 values, ",
        ),
        (lambda: lg.bifurcation(PENDULUM, "c", [0.1, 0.2], progress=True), "1 of 3 values, "),
    ],
)
def test_each_picture_of_dynamics_shows_how_far_it_is(call: Any, last: str, display: Display) -> None:
    call()
    assert last in display.shown[-1].text


def test_no_bar_is_shown_to_who_did_not_ask(display: Display) -> None:
    with progress.progress_bar((0.0, 4.0), enabled=False) as report:
        assert report is None
    assert display.shown == []


def test_a_long_compilation_is_a_line_and_a_short_one_is_none(
    display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    with progress.announced("compiling", "<b>", enabled=True):
        time.sleep(0.0)
    assert display.shown == []
    monkeypatch.setattr(progress, "SILENT_SECONDS", 0.01)
    with progress.announced("compiling", "<b>", enabled=True):
        time.sleep(0.2)
    assert repr(display.shown[-1]).startswith("compiled <b> in 0.") and "&lt;b&gt;" in display.shown[-1]._repr_html_()


def test_a_text_is_no_markup_and_outside_of_a_notebook_there_is_none() -> None:
    assert "&lt;b&gt;" in progress.ProgressState("<b>", 0.5)._repr_html_()
    assert not progress.in_notebook()
