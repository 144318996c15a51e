"""Workers on other hardware: they run members by other code, and the result says that digits may differ."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.members.jobs import processors, threads_of

STARTS = {"x": np.linspace(-0.3, 0.3, 13)}


def without_llvmlite() -> None:
    """Make imports of llvmlite fail, as if it were not installed."""
    gone: Any = None
    sys.modules.update({"llvmlite": gone, "llvmlite.binding": gone})


def on_a_smaller_processor() -> None:
    """Compile code for vectors of four numbers."""
    llvm: Any = pytest.importorskip("llvmlite.binding")
    features = llvm.get_host_cpu_features()
    features.update({name: False for name in features if name.startswith("avx512")})
    llvm.get_host_cpu_name, llvm.get_host_cpu_features = lambda: "haswell", lambda: features


def ran(begin: Callable[[], None]) -> lg.Ensemble:
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=begin) as executor:
        return lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS, executor=executor)


@pytest.mark.slow
def test_a_worker_without_a_compiler_runs_by_numpy() -> None:
    runs = ran(without_llvmlite)
    assert runs.form.startswith("runs one after the other by numpy; a worker has no llvmlite: the last digits may")
    here = lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS)
    assert np.allclose(runs.y, here.y, rtol=1e-9, atol=1e-10) and "digits" not in here.form


@pytest.mark.slow
def test_a_worker_of_another_processor_compiles_for_it() -> None:
    pytest.importorskip("llvmlite")
    runs = ran(on_a_smaller_processor)
    assert "4 members side by side; workers compiled for haswell with vectors of 4, not for" in runs.form
    assert "the last digits may differ from those of this machine" in runs.form
    assert np.allclose(runs.y, lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS).y, rtol=1e-12, atol=1e-13)


def test_a_machine_without_a_compiler_runs_ensembles_by_numpy() -> None:
    model = lg.scene("pendulum").compile(target="numpy")
    runs = lg.ensemble(model, 1.0, {"theta": [0.1, 0.2]}, method="rk4", step=0.1)
    assert runs.form == "runs one after the other by numpy"


# --- threads --------------------------------------------------------------------------------------------------
# The number of threads of an ensemble.


def test_ensembles_run_on_the_processors_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 8}, raising=False)
    assert threads_of(None) == processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert threads_of(None) == 7
    with pytest.raises(StatementError, match="workers = 2000: give a whole number from 1 to 1024"):
        lg.ensemble(lg.scene("pendulum"), 1.0, {"theta": [1.0, 2.0]}, workers=2000)
