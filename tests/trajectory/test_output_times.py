"""Output times of every method: the same bits from the run and from its path, and a run that keeps nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.statement.event import event
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.models import TARGETS, model, y
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, SPLITTINGS, run
from tests.trajectory.watched import ball, floor

RNG = np.random.default_rng(5)
OURS = [name for name in NAMES if not name.startswith(("scipy-", "cvode"))]
"""The methods that may keep their outputs alone."""


def options(name: str, step: float = 0.1) -> dict[str, Any]:
    return {"step": step} if name in FIXED else {}


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", [2.0, -2.0])
def test_the_states_of_a_run_are_those_of_its_path_to_the_last_bit(name: str, end: float, target: str) -> None:
    compiled = model("Henon-Heiles" if name in SPLITTINGS else "cart and pole", target)
    inner = np.sort(RNG.uniform(0.0, abs(end), 40))
    times = np.sign(end) * np.concatenate([[0.0, 0.0], inner, [abs(end), abs(end)]])
    found = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, **options(name))
    assert (found.at(times) == found.y).all()
    assert all((found.at(time) == state).all() for time, state in zip(times[:9], found.y.T[:9], strict=True))
    mixed = RNG.permutation(np.concatenate([times, times / 2]))
    among = np.isin(mixed, times)
    assert (found.at(mixed)[:, among] == found.y[:, np.searchsorted(np.abs(times), np.abs(mixed[among]))]).all()
    assert found.at(mixed[~among]) == pytest.approx(found.at(mixed)[:, ~among], abs=1e-13)
    none = lg.integrate(compiled, (0.0, end), method=name, t_eval=[], **options(name))
    assert none.y.shape == (len(found.y), 0) and none.status is Status.SUCCESS
    assert none.steps == found.steps and none.at(times) == pytest.approx(found.y, abs=1e-13)


@pytest.mark.parametrize("name", ["taylor", "dop853", "radau5", "scipy-dop853"])
def test_across_resets_too(name: str) -> None:
    """At the time of a reset the state behind it counts."""
    compiled = ball("llvm")
    plain = run(compiled, 3.0, name, events=[floor(0.8)])
    times = np.sort(np.concatenate([np.linspace(0.0, 3.0, 333), plain.t_events[0]]))
    found = run(compiled, 3.0, name, events=[floor(0.8)], t_eval=times)
    assert (found.dense(times) == found.y).all()
    assert found.y == pytest.approx(plain.dense(times), abs=1e-12)
    assert len(plain.t_events[0]) > 3
    at_resets = found.y[1, np.searchsorted(times, plain.t_events[0])]
    assert (at_resets > 0).all()


@pytest.mark.parametrize("name", ["dop853", "radau5", "verlet", "taylor"])
@pytest.mark.parametrize("end", [40.0, -40.0])
def test_outputs_are_evaluated_as_the_run_goes(name: str, end: float) -> None:
    """Many calls of the driver, and what the outputs of one need of the steps of the call before."""
    compiled = model("Henon-Heiles")
    plain = run(compiled, end, name, **options(name, 0.02))
    times = np.linspace(0.0, end, 1009)
    found = run(compiled, end, name, t_eval=times, **options(name, 0.02))
    assert found.steps == plain.steps
    assert found.y == pytest.approx(plain.dense(times), abs=1e-13)


def test_a_terminal_event_is_the_last_output() -> None:
    compiled = ball("llvm")
    plain = run(compiled, 5.0, "dop853", events=[event(y, terminal=True)])
    times = np.append(np.linspace(0.0, plain.t[-1], 50), [4.0, 5.0])
    found = run(compiled, 5.0, "dop853", events=[event(y, terminal=True)], t_eval=times)
    assert found.status is Status.EVENT and len(found.t) == 50
    assert (found.y[:, -1] == plain.y[:, -1]).all()
    assert found.y == pytest.approx(plain.dense(times[:50]), abs=1e-14)


def few_bytes(count: int) -> int:
    """Return what so many outputs of two coordinates take, and some steps."""
    return 8 * 5 * count + 3000


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("end", [30.0, -30.0])
def test_a_run_may_keep_its_outputs_alone(name: str, end: float, target: str) -> None:
    compiled, times = model("Henon-Heiles", target), np.linspace(0.0, end, 61)
    steps = options(name, 0.03)
    if name in ADAPTIVE:
        # More steps than the memory has room for, and no more: interpreted ones of radau3 take a millisecond.
        steps = {"rtol": 1e-7 if name in ("bs3", "radau3", "radau5", "radau5-index2") else 1e-10}
    whole = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, **steps)
    limit = few_bytes(61) if name != "taylor" else 8 * 5 * 61 + 1
    found = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, max_memory=limit, **steps)
    assert whole.status is found.status and found.status.at_end
    assert found.steps == whole.steps and found.trajectory.span == whole.trajectory.span
    assert found.y == pytest.approx(whole.y, abs=1e-12) and (found.at(times) == found.y).all()
    if 40 * found.steps > 2 * limit:
        assert isinstance(found.trajectory.dense, OutputPath) and found.trajectory.dense.path is None
        with pytest.raises(lg.RunError, match=r"there is no state at t = .*max_memory = .* bytes, so it kept only"):
            found.at(end / 3.1)
        assert "ask for others in t_eval, or raise max_memory" in found.message
        assert found.stiff is None and found.drift.absolute == pytest.approx(whole.drift.absolute, abs=1e-12)
    else:
        assert name in ("taylor", "verner9", "dop853")


def test_memory_is_bounded_by_the_outputs() -> None:
    """Some 80,000 steps of 40 bytes, in a tenth of their memory."""
    compiled, times = model("Henon-Heiles"), np.linspace(0.0, 4000.0, 1001)
    found = run(compiled, 4000.0, "verlet", step=0.05, t_eval=times)
    assert found.steps == 80_000
    bounded = lg.integrate(compiled, (0.0, 4000.0), method="verlet", step=0.05, t_eval=times, max_memory=300_000)
    assert (bounded.y == found.y).all()


def resets(times: FloatArray, **given: Any) -> lg.Solution:
    given |= {"method": "verlet", "step": 1e-3, "events": [floor(1.0)]}
    return lg.integrate(ball("llvm"), (0.0, 30.0), t_eval=times, **given)


def test_outputs_alone_across_resets() -> None:
    """The motion begins anew at each of some twenty resets, with its steps dropped again and again."""
    times = np.linspace(0.0, 30.0, 777)
    whole, found = resets(times), resets(times, max_memory=8 * 777 * 3 + 20_000)
    assert isinstance(found.trajectory.dense, OutputPath) and found.trajectory.dense.path is None
    assert len(found.t_events[0]) > 10 and (found.t_events[0] == whole.t_events[0]).all()
    assert found.y == pytest.approx(whole.y, abs=1e-12)


def test_output_times_that_do_not_fit_are_refused() -> None:
    compiled = model("Henon-Heiles")
    with pytest.raises(
        lg.StatementError,
        match="t_eval has 1000 times, which take 4e\\+04 bytes with their states, more than max_memory = 39999 bytes",
    ):
        lg.integrate(compiled, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 1000), max_memory=39_999)
    found = lg.integrate(compiled, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 1000), max_memory=40_000)
    assert found.y.shape == (4, 1000)


def test_without_output_times_a_run_ends_where_memory_does() -> None:
    found = lg.integrate(model("Henon-Heiles"), (0.0, 1e4), method="verlet", step=0.01, max_memory=20_000)
    assert found.status is Status.MAX_MEMORY and "give t_eval, which is kept without the steps" in found.message


def test_notes_on_the_sizes_of_a_run_need_no_steps() -> None:
    """The coarse tolerance is seen by the largest entries of states that are not kept any more."""
    given: dict[str, Any] = {"method": "dop853", "rtol": 1e-9, "atol": 1e-2, "t_eval": np.linspace(0.0, 2000.0, 11)}
    whole = lg.integrate(model("Henon-Heiles"), (0.0, 2000.0), **given)
    found = lg.integrate(model("Henon-Heiles"), (0.0, 2000.0), **given, max_memory=2000)
    assert "leaves it fewer digits" in whole.message
    assert found.message.startswith(whole.message + " The steps of the run took more than max_memory = 2000 bytes")
