"""Progress of many runs: how many are done, their rate and the time left, and silence where nobody asked."""

from __future__ import annotations

import io
from typing import Any

import pytest

import lagrange as lg
from lagrange.statement import progress


class Terminal(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds that pass when a test says so."""
    now = [100.0]
    monkeypatch.setattr("lagrange.statement.progress.time.perf_counter", lambda: now[0])
    return now


def test_the_rate_is_that_of_what_was_done_now(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    """3,000 of 10,000 were stored before; 2,000 in 20 s are 100 a second, and 5,000 more take 50 s."""
    with progress.counter(10_000, "member", enabled="lines", before=3000) as report:
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
    with progress.counter(1000, "member", enabled="lines") as report:
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
        with pytest.raises(lg.StatementError, match=r"progress = 'line': give True, False or lines\. Did you mean"):
            call(how="line")
