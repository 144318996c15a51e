"""The number of threads of an ensemble."""

from __future__ import annotations

import os

import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.members.work import processors, threads_of


def test_ensembles_run_on_the_processors_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 8}, raising=False)
    assert threads_of(None) == processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert threads_of(None) == 7
    with pytest.raises(StatementError, match="workers = 2000: give a whole number from 1 to 1024"):
        lg.ensemble(lg.scene("pendulum"), 1.0, {"theta": [1.0, 2.0]}, workers=2000)
