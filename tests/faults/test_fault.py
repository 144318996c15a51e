"""The judge of faults, and every registered method on every fault."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from lagrange.errors import StatementError
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.registry import names
from lagrange.trajectory.methods.runge_kutta import DOP853
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.faults.fault import Fault, take
from tests.faults.matrix import FAULTS, cells
from tests.faults.motions import CONTACTS, MOTIONS, MOVED, cosine
from tests.faults.requests import EVENTS, REQUESTS, bob

PLAIN = Fault("plain", "no fault", bob, truth=cosine, step=None)
POLE = next(fault for fault in FAULTS if fault.name == "double pole")


class Changed:
    """DOP853 whose trajectory is changed before it is returned."""

    name, claims = "changed", Claims(order=8, adaptive=True)

    def __init__(self, change: Callable[[Trajectory], Trajectory]) -> None:
        self.change = change

    def integrate(self, problem: Problem) -> Trajectory:
        result = DOP853().integrate(problem)
        return self.change(replace(result, message=result.message.replace("dop853", "changed")))


def off(result: Trajectory) -> Trajectory:
    return replace(result, y=result.y * 1.001)


def hopeful(result: Trajectory) -> Trajectory:
    return replace(result, status=Status.SUCCESS)


def fall(result: Trajectory) -> Trajectory:
    raise RuntimeError("no idea")


def refuse(result: Trajectory) -> Trajectory:
    raise StatementError("changed is not made for particles.")


def tire(result: Trajectory) -> Trajectory:
    return refuse(result) if result.span[1] > result.span[0] else result


def doubtful(result: Trajectory) -> Trajectory:
    note = "The run does not follow the motion. Shorten the step."
    return replace(result, status=Status.UNRELIABLE, message=f"{result.message} {note}")


def excused(result: Trajectory) -> Trajectory:
    return replace(doubtful(result), status=Status.SUCCESS)


def mute(result: Trajectory) -> Trajectory:
    return replace(result, message="changed stopped.")


def other(result: Trajectory) -> Trajectory:
    return replace(result, status=Status.DIVERGED if result.status is Status.SUCCESS else Status.INTERRUPTED)


@pytest.mark.parametrize(
    ("fault", "change", "verdict"),
    [
        (PLAIN, lambda found: found, "right"),
        (PLAIN, off, "silent"),
        (PLAIN, doubtful, "wrong"),
        (PLAIN, lambda found: doubtful(off(found)), "unreliable"),
        (PLAIN, lambda found: replace(off(found), status=Status.UNRELIABLE), "wrong"),
        (PLAIN, lambda found: excused(off(found)), "warned"),
        (PLAIN, fall, "wrong"),
        (PLAIN, refuse, "refused"),
        (PLAIN, tire, "wrong"),
        (PLAIN, other, "wrong"),
        (POLE, lambda found: found, "ended"),
        (POLE, hopeful, "silent"),
        (POLE, excused, "warned"),
        (POLE, doubtful, "unreliable"),
        (POLE, mute, "wrong"),
        (POLE, other, "wrong"),
        (POLE, off, "wrong"),
    ],
)
def test_the_verdict(fault: Fault, change: Callable[[Trajectory], Trajectory], verdict: str) -> None:
    cell = take(fault, Changed(change))
    assert cell.verdict == verdict, cell.detail
    assert cell.sound == (verdict in ("right", "ended", "refused", "unreliable"))


# --- every registered method on every fault: no silent wrong answer, and no run without an end -----------------
# There is one test for each kind of fault, so that a default run, which takes a sample, contains all kinds.


pytestmark = pytest.mark.few


def each(faults: Sequence[Fault]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("fault", faults, ids=lambda fault: fault.name)


def every_method_gets_what_is_due(fault: Fault, everything: bool) -> None:
    methods = names()
    if not everything:
        methods = [methods[zlib.crc32(fault.name.encode()) % len(methods)]]
    wrong = [cell for cell in cells(methods, [fault]) if not cell.sound]
    assert not wrong, "\n".join(f"{cell.method}: {cell.verdict}, {cell.status}: {cell.detail}" for cell in wrong)


@each(MOTIONS)
def test_a_motion_that_is_hard_to_follow(fault: Fault, everything: bool) -> None:
    every_method_gets_what_is_due(fault, everything)


@each(EVENTS)
def test_an_event_that_is_hard_to_find(fault: Fault, everything: bool) -> None:
    every_method_gets_what_is_due(fault, everything)


@each(REQUESTS)
def test_a_request_that_is_hard_to_meet(fault: Fault, everything: bool) -> None:
    every_method_gets_what_is_due(fault, everything)


@each(MOVED)
def test_a_motion_that_constraints_make_hard(fault: Fault, everything: bool) -> None:
    every_method_gets_what_is_due(fault, everything)


@each(CONTACTS)
def test_a_contact_that_is_hard_to_meet(fault: Fault, everything: bool) -> None:
    every_method_gets_what_is_due(fault, everything)


def test_every_fault_is_of_one_of_these_kinds() -> None:
    assert (*MOTIONS, *EVENTS, *REQUESTS, *MOVED, *CONTACTS) == FAULTS
