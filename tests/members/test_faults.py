"""A member with a fault beside healthy ones: it ends as its single run does, with the same message.

A lane that is stuck or full of NaN executes the same instructions as its neighbours, and then takes other members.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.members.faulty import FAULTY, FAULTY_CONSTRAINTS, FAULTY_EVENTS, HEALTHY, Faulty

METHODS = ("taylor", "dop853", "rk4", "verlet")
QUEUE = 3 * HEALTHY + 4
"""So many healthy members that lanes take members before and behind those with a fault."""
PLACES = [(HEALTHY, (0,)), (HEALTHY, (3,)), (HEALTHY, (HEALTHY,)), (QUEUE, (0, 9, 9, 10, QUEUE))]
NUMBERS = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?|x(_dot)? is [^ ]+")


def options(fault: Faulty, method: str) -> dict[str, Any]:
    fixed = not find(method).claims.adaptive
    return {"method": method, **fault.options, **({"step": fault.step} if fixed else {})}


def run(fault: Faulty, method: str, *places: int, count: int) -> lg.Ensemble:
    given = {**fault.starts(*places, count=count), **options(fault, method)}
    kept = ("end", "counts", "drift", *([("events", 2)] if "events" in given else []))
    return lg.ensemble(fault.model(), fault.end, keep=kept, workers=1, **given)


def alone(fault: Faulty, method: str, value: float) -> Trajectory | str:
    """Return the single run of a member, or the message of its refusal."""
    given, asked = fault.given(np.float64(value)), options(fault, method)
    chosen = RunOptions(asked.pop("method"), parameters=given.get("parameters"), **asked)
    try:
        return trajectory_of(fault.model(), (0.0, fault.end), given["initial"], chosen)[0]
    except lg.StatementError as refusal:
        return str(refusal)


def check_member(runs: lg.Ensemble, i: int, own: Trajectory | str) -> None:
    """Assert that a member ended as its single run, with the same message, and has no numbers if it was refused."""
    if isinstance(own, str):
        assert (runs.status[i], runs.messages[i], runs.t[i]) == (Status.NON_FINITE, own, 0.0)
        assert np.isnan(runs.y[:, i]).all()
        return
    assert runs.status[i] is own.status
    assert np.isfinite(runs.y[:, i]).all()
    if own.status is Status.MAX_STEPS:  # so many steps lead, by other rounding, to another time
        assert NUMBERS.sub("", runs.messages[i]) == NUMBERS.sub("", own.message)
        return
    assert runs.messages.get(i, own.message) == own.message
    assert runs.t[i] == pytest.approx(own.span[1], rel=1e-5)
    for times, result in zip(runs.t_events, own.t_events, strict=True):
        assert times[i][: len(result)] == pytest.approx(result[:2], rel=1e-9)
        assert np.isnan(times[i][len(result) :]).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fault", [*FAULTY, *FAULTY_CONSTRAINTS, *FAULTY_EVENTS], ids=lambda fault: fault.name)
def test_a_fault_beside_healthy_members(fault: Faulty, method: str) -> None:
    own, sound = (alone(fault, method, value) for value in (fault.fault, fault.healthy[0]))
    if isinstance(sound, str):  # the method is not made for the system
        with pytest.raises(lg.StatementError, match=re.escape(sound)):
            run(fault, method, 0, count=HEALTHY)
        return
    status = Status.NON_FINITE if isinstance(own, str) else own.status
    assert status in fault.statuses
    healthy = {count: run(fault, method, count=count) for count in (HEALTHY, QUEUE)}
    assert all(set(runs.status) == {Status.SUCCESS} for runs in healthy.values())
    for count, places in PLACES:
        runs = run(fault, method, *places, count=count)
        faulty = np.array(places) + np.arange(len(places))
        for column in (column.name for column in runs.columns):
            others = np.delete(runs.results.column(column), faulty, axis=0)
            if column != "evaluations" or "side by side" in runs.form:  # a run with a new driver makes one more
                assert others.tobytes() == healthy[count].results.column(column).tobytes(), column
        assert list(runs.messages) == ([] if status is Status.SUCCESS else faulty.tolist())
        for i in faulty.tolist():
            check_member(runs, i, own)


@pytest.mark.slow
def test_a_store_has_the_sentences_of_memory(tmp_path: Any) -> None:
    pytest.importorskip("zarr")
    galaxy, starts = lg.scene("henon-heiles").compile(), {"x": [0.1, 1.0, 0.2, 1.1]}
    for method in ("taylor", "radau5"):
        memory = lg.ensemble(galaxy, 15.0, starts, method=method)
        stored = lg.ensemble(galaxy, 15.0, starts, method=method, store=tmp_path / method)
        assert dict(stored.messages) == dict(memory.messages) and set(memory.messages) == {1, 3}
