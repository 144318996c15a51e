"""What may vanish on a Taylor step: nothing with a zero there is left out, and what is far from zero is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.taylor.event_series import doubtful_events
from lagrange.algorithm.taylor.memory import BLOCK, TaylorLayout
from lagrange.machine.llvm.called import compiled
from lagrange.machine.printed_run import called

MACHINES: dict[str, Callable[..., Any]] = {"printed as Python": called, "in machine code": compiled}


def asked(machine: str, columns: Any, s: float, *, every: bool = False) -> tuple[list[bool], bool]:
    """Return which of some series, (order + 1, k), are doubtful on a step, and whether any is."""
    order, count = len(columns) - 1, columns.shape[1]
    layout = TaylorLayout(2, 2 + count, count, 2, block=2)
    work, doubtful = np.zeros(layout.size(order)), np.full(count + BLOCK, np.nan)
    rows = work[layout.rows :][: (order + 1) * layout.width].reshape(order + 1, layout.width)
    rows[:, layout.watched_at :] = columns
    some = MACHINES[machine](doubtful_events.form(layout=layout))(s, every, doubtful, work, order)
    return doubtful[:count].astype(bool).tolist(), some


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("count", [1, 3, 5, 9])
def test_what_has_a_zero_on_the_step_is_doubtful(machine: str, count: int) -> None:
    chance = np.random.default_rng(count)
    for order in (4, 5, 6, 7, 20):
        for _ in range(20):
            columns = chance.normal(size=(order + 1, count)) * 0.3 ** np.arange(order + 1.0)[:, None]
            columns[0] *= 10.0 ** chance.integers(-2, 2, count)
            s = float(chance.uniform(0.1, 2.0))
            values = np.polynomial.polynomial.polyval(np.linspace(0.0, s, 400), columns)
            crosses = (values.min(axis=1) <= 0) & (values.max(axis=1) >= 0)
            # The rest of the series outweighs the smaller end of its linear part, or the part changes its sign.
            rest = np.abs(columns[2:] * s ** np.arange(2.0, order + 1)[:, None]).sum(axis=0)
            ends = columns[0], columns[0] + columns[1] * s
            expected = (np.minimum(*np.abs(ends)) <= rest) | (ends[0] * ends[1] <= 0)
            found, some = asked(machine, columns, s)
            assert found == expected.tolist() and some is bool(expected.any())
            assert not (crosses & ~expected).any()


@pytest.mark.parametrize("machine", MACHINES)
def test_all_are_doubtful_where_that_is_asked_for_and_where_nothing_is_known(machine: str) -> None:
    columns = np.zeros((6, 3))
    columns[0] = 1.0
    assert asked(machine, columns, 1.0) == ([False] * 3, False)
    assert asked(machine, columns, 1.0, every=True) == ([True] * 3, True)
    columns[4, 1] = np.nan
    assert asked(machine, columns, 1.0) == ([False, True, False], True)
