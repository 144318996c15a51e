"""Progress in a notebook: few updates, the last of them where the work ended, and nothing where nobody sees it."""

from __future__ import annotations

import io
import time
from typing import Any

import pytest
from sympy import cos

import lagrange as lg
from lagrange.statement import display as displayed
from tests.refusals import refusal

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
    monkeypatch.setattr(displayed, "in_notebook", lambda: True)
    return made


def test_the_last_state_is_shown_however_quick_the_work_was(display: Display) -> None:
    with displayed.progress_bar((2.0, 0.0), enabled=True) as report:
        assert report is not None
        for k in range(1000):
            report(2.0 - k / 1000)
    assert len(display.shown) < 100
    assert display.shown[-1].share == pytest.approx(0.4995) and display.shown[-1].text.startswith("t = 1.001, ")
    assert repr(display.shown[0]).startswith("  0%  t = 2, ")


def test_work_that_raises_leaves_the_bar_where_it_was(display: Display) -> None:
    def work() -> None:
        with displayed.progress_bar((0.0, 4.0), enabled=True) as report:
            assert report is not None
            report(1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert "value='0.250'" in display.shown[-1]._repr_html_()


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("call", "last"),
    [
        (lambda: lg.phase_portrait(PENDULUM, starts=[{"x": 1.0}, {"x": 2.0}], progress=True), "2 of 2 orbits, "),
        pytest.param(lambda: lg.phase_portrait(PENDULUM, progress=True), "484 of 484 cells, ", marks=pytest.mark.slow),
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
    with displayed.progress_bar((0.0, 4.0), enabled=False) as report:
        assert report is None
    assert display.shown == []


def test_a_long_compilation_is_a_line_and_a_short_one_is_none(
    display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    with displayed.announced("compiling", "<b>", enabled=True):
        time.sleep(0.0)
    assert display.shown == []
    monkeypatch.setattr(displayed, "SILENT_SECONDS", 0.01)
    with displayed.announced("compiling", "<b>", enabled=True):
        time.sleep(0.2)
    assert repr(display.shown[-1]).startswith("compiled <b> in 0.") and "&lt;b&gt;" in display.shown[-1]._repr_html_()


def test_a_text_is_no_markup_and_outside_of_a_notebook_there_is_none() -> None:
    assert "&lt;b&gt;" in displayed.ProgressState("<b>", 0.5)._repr_html_()
    assert not displayed.in_notebook()


# --- Progress of many runs ---


class Terminal(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds that pass when a test says so."""
    now = [100.0]
    monkeypatch.setattr("lagrange.statement.display.time.perf_counter", lambda: now[0])
    return now


def test_the_rate_is_that_of_what_was_done_now(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    """3,000 of 10,000 were stored before; 2,000 in 20 s are 100 a second, and 5,000 more take 50 s."""
    with displayed.counter(10_000, "member", enabled="lines", before=3000) as report:
        assert report is not None
        clock[0] += 20.0
        report(5000.0)
        clock[0] += 1.0
        report(5100.0)
        clock[0] += 19.0
        report(10_000.0)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "5,000 of 10,000 members, 100 a second, 50 s left",
        "10,000 of 10,000 members, 175 a second",
        "10,000 of 10,000 members, 175 a second",
    ]


@pytest.mark.parametrize(
    ("done", "seconds", "said"),
    [
        (1, 40.0, "1 of 1,000 members, 1.5 a minute, 11 h left"),
        (2, 1.0, "2 of 1,000 members, 2 a second, 8 min left"),
        (1, 86400.0, "1 of 1,000 members, 0.00069 a minute, 999 days left"),
        (0, 5.0, "0 of 1,000 members"),
    ],
)
def test_slow_members_are_counted_by_the_minute(
    done: int, seconds: float, said: str, clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with displayed.counter(1000, "member", enabled="lines") as report:
        assert report is not None
        clock[0] += seconds
        report(done)
    assert capsys.readouterr().err.splitlines()[-1] == said


def test_on_a_terminal_the_last_line_stays_and_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("COLUMNS", "80")
    lg.ensemble(lg.scene("pendulum"), 0.1, {"theta": [0.1, 0.2, 0.3]}, progress=True)
    said = terminal.getvalue()
    assert "3 of 3 members" in said and said.endswith("\n")


@pytest.mark.slow
def test_in_a_pipe_there_is_nothing_unless_lines_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    x = lg.coordinate("x")
    ball = lg.System(kinetic=x.dot**2 / 2, potential=9.81 * x, forces={x: -x.dot}, name="ball")
    calls: list[Any] = [
        lambda how: lg.ensemble(ball, 0.1, {"x": [0.1, 0.2]}, progress=how),
        lambda how: lg.phase_portrait(ball, {x: (1, 2), x.dot: (0, 1)}, starts=[{x: 1.5}], progress=how),
    ]
    for call, last in zip(calls, ("2 of 2 members", "1 of 1 orbit"), strict=True):
        call(how=True)
        assert capsys.readouterr() == ("", "")
        call(how="lines")
        assert capsys.readouterr().err.splitlines()[-1].startswith(last)
        assert "progress = 'line': give True, False or lines. Did you mean" in refusal(call, how="line")
