"""Every registered method on every fault: no silent wrong answer, and no run without an end.

There is one test for each kind of fault, so that a default run, which takes a sample, contains all kinds.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import pytest

from lagrange.trajectory.methods.registry import names
from tests.faults.constraints import MOVED
from tests.faults.contacts import CONTACTS
from tests.faults.fault import Fault
from tests.faults.matrix import FAULTS, cells
from tests.faults.motions import MOTIONS
from tests.faults.occurrences import EVENTS
from tests.faults.requests import REQUESTS

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
