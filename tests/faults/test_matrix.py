"""Every fault on every registered method: none in silence, none without an end."""

from __future__ import annotations

import pytest

from lagrange.trajectory.methods.registry import names
from tests.faults.fault import Fault, take
from tests.faults.matrix import FAULTS

TOO_COARSE = (
    *("bs3", "dopri5", "tsit5", "radau3", "radau5", "cvode"),
    *(f"scipy-{name}" for name in ("bdf", "lsoda", "radau", "rk23", "rk45")),
)
"""Methods that an atol of 1e-12 leaves no digit of a state of 1e-300: they warn, and end with SUCCESS."""


@pytest.mark.parametrize("method", names())
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_gets_what_it_deserves(fault: Fault, method: str, request: pytest.FixtureRequest) -> None:
    if fault.name == "tiny" and method in TOO_COARSE:
        request.applymarker(pytest.mark.xfail(strict=True, reason="the default atol does not follow the scale"))
    cell = take(fault, method)
    assert cell.sound, f"{cell.verdict}, {cell.status}: {cell.detail}"
