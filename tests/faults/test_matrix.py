"""Every fault on every registered method: none in silence, none without an end."""

from __future__ import annotations

import pytest

from lagrange.trajectory.methods.registry import names
from tests.faults.fault import Fault, take
from tests.faults.matrix import FAULTS


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_gets_what_it_deserves(fault: Fault, method: str) -> None:
    cell = take(fault, method)
    assert cell.sound, f"{cell.verdict}, {cell.status}: {cell.detail}"
