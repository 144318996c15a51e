"""Every fault on every registered method: none in silence, none without an end.

There is a test for each kind of fault, so that each method meets each kind when few of the cases are taken.
"""

from __future__ import annotations

import pytest

from lagrange.trajectory.methods.registry import names
from tests.faults.constraints import BEGUN, CONSTRAINTS, MOVED, STATED
from tests.faults.fault import Fault, take
from tests.faults.matrix import FAULTS
from tests.faults.motions import MOTIONS
from tests.faults.occurrences import EVENTS
from tests.faults.requests import REQUESTS


def gets_what_it_deserves(fault: Fault, method: str) -> None:
    cell = take(fault, method)
    assert cell.sound, f"{cell.verdict}, {cell.status}: {cell.detail}"


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", MOTIONS, ids=lambda fault: fault.name)
def test_a_motion_that_is_hard_to_follow(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", EVENTS, ids=lambda fault: fault.name)
def test_an_event_that_is_hard_to_find(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", REQUESTS, ids=lambda fault: fault.name)
def test_a_request_that_is_hard_to_meet(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", STATED, ids=lambda fault: fault.name)
def test_a_constraint_that_cannot_be_meant(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", BEGUN, ids=lambda fault: fault.name)
def test_a_start_that_constraints_do_not_allow(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", MOVED, ids=lambda fault: fault.name)
def test_a_motion_that_constraints_make_hard(fault: Fault, method: str) -> None:
    gets_what_it_deserves(fault, method)


def test_every_fault_is_of_one_of_these_kinds() -> None:
    assert (*MOTIONS, *EVENTS, *REQUESTS, *CONSTRAINTS) == FAULTS
