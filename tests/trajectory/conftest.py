"""What tests of runs share."""

from __future__ import annotations

import pytest

from lagrange.algorithm.events.roots import roots
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine


@pytest.fixture(params=[LlvmMachine(), NumpyMachine()], ids=["llvm", "numpy"])
def isolation(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What isolates roots where no machine is given."""
    monkeypatch.setattr("lagrange.trajectory.events.zeros_on_step.printed", lambda: request.param.called(roots.form()))
