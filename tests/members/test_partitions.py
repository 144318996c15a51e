"""One ensemble in many partitions: the bits of a member do not depend on the partition."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.machine.llvm import engine
from lagrange.members import jobs, lanes, store
from lagrange.members.jobs import processors, threads_of

count = engine.CompiledCall.count
"""Counts steps of compiled code, and returns True if optimized code replaces it."""

COUNT = 53
"""Members: lanes run out of them at different times, and some leave."""
ORDER = np.random.default_rng(1).permutation(COUNT)
VALUES = np.linspace(-1.0, 1.0, COUNT)

Columns = dict[str, Any]


@cache
def model() -> Any:
    return lg.scene("henon-heiles").compile()


def run(which: Any = slice(None), **options: Any) -> Columns:
    """Return the results of some members."""
    starts = {"x": VALUES[which], "y": 0.3 * VALUES[::-1][which]}
    x, y = model().statement.coordinates
    keep: tuple[Any, ...] = ("end", "drift", ("max", x), ("min", x**2 - y), ("mean", y))
    # Members with events may leave their lanes, where evaluations are counted in another way.
    if watched := options.pop("watched", False):
        options["events"] = [lg.event(x, terminal=2), y]
    keep = (*keep, ("events", 3) if watched else "counts")
    runs = lg.ensemble(model(), 15.0, starts, keep=keep, t_eval=[1.0, 7.5, 15.0], **options)
    return {column.name: runs.results.column(column.name) for column in runs.columns}


@cache
def whole(method: str, *, watched: bool) -> Columns:
    return run(method=method, workers=1, watched=watched)


def ordered(order: Any, **options: Any) -> Columns:
    """Run members in another order, and return their results in the original order."""
    return {name: rows[np.argsort(order)] for name, rows in run(order, **options).items()}


def in_parts(parts: list[Any], **options: Any) -> Columns:
    """Run members in several smaller ensembles."""
    right = whole(options["method"], watched=options["watched"])
    result = {name: np.empty_like(rows) for name, rows in right.items()}
    for part in parts:
        for name, rows in run(part, **options).items():
            result[name][part] = rows
    return result


@contextmanager
def spawned() -> Iterator[Any]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


@contextmanager
def clustered(**options: Any) -> Iterator[Any]:
    distributed: Any = pytest.importorskip("distributed")
    with distributed.LocalCluster(dashboard_address=None, **options) as cluster, distributed.Client(cluster) as client:
        yield client


def executed(made: Callable[[], Any], **options: Any) -> Columns:
    with made() as executor:
        return run(executor=executor, **options)


def stored(folder: Path, **options: Any) -> Columns:
    pytest.importorskip("zarr")
    run(store=folder / "runs.zarr", **options)
    return run(store=folder / "runs.zarr", **options)


EVERY = list(range(COUNT))
PARTITIONS: Mapping[str, tuple[int, Callable[..., Columns]]] = {
    **{
        f"chunks of {size} on {workers} threads": (size, lambda folder, w=workers, **o: run(workers=w, **o))
        for size, workers in ((1, 1), (1, 3), (5, 2), (8, 1), (8, 3), (11, 2), (64, 2))
    },
    "last first": (64, lambda folder, **o: ordered(np.array(EVERY[::-1]), **o)),
    "any order": (64, lambda folder, **o: ordered(ORDER, **o)),
    "any order in small chunks": (3, lambda folder, **o: ordered(ORDER, workers=2, **o)),
    "every other one": (64, lambda folder, **o: in_parts([EVERY[::2], EVERY[1::2]], **o)),
    "one by one": (64, lambda folder, **o: in_parts([[i] for i in EVERY], workers=1, **o)),
    "parts of different lengths": (64, lambda folder, **o: in_parts([EVERY[:3], EVERY[3:20], EVERY[20:]], **o)),
    "a pool of threads": (7, lambda folder, **o: executed(lambda: ThreadPoolExecutor(3), **o)),
    "a store": (64, stored),
    "a store of small blocks": (5, lambda folder, **o: stored(folder, workers=2, **o)),
}
ELSEWHERE: Mapping[str, tuple[int, Callable[..., Columns]]] = {
    "processes": (7, lambda folder, **o: executed(spawned, **o)),
    "processes and a store": (7, lambda folder, **o: executed(spawned, store=folder / "runs.zarr", **o)),
    "a cluster": (7, lambda folder, **o: executed(lambda: clustered(n_workers=2, threads_per_worker=1), **o)),
    "a cluster of threads": (9, lambda folder, **o: executed(lambda: clustered(n_workers=1, processes=False), **o)),
}
"""Partitions whose workers take seconds to start."""

METHODS = ("taylor", "dop853", "rk4", "verlet", pytest.param("radau5", marks=pytest.mark.slow))


def same(
    partition: tuple[int, Callable[..., Columns]],
    method: str,
    folder: Path,
    patch: pytest.MonkeyPatch,
    *,
    watched: bool = False,
) -> None:
    size, result = partition
    right = whole(method, watched=watched)
    patch.setattr(jobs, "FIRST_CHUNK", min(size, 8))
    patch.setattr(jobs, "LARGEST_CHUNK", size)
    patch.setattr(store, "LARGEST_BLOCK", size)
    given = result(folder, method=method, watched=watched)
    assert set(given) == set(right)
    assert method != "taylor" or len(set(right["status"].tolist())) >= 2, "all members end in the same way"
    for name, rows in right.items():
        assert given[name].tobytes() == rows.tobytes(), name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("partition", PARTITIONS)
def test_a_partition(partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(PARTITIONS[partition], method, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "verlet"])
@pytest.mark.parametrize("partition", ["chunks of 1 on 3 threads", "any order in small chunks"])
def test_a_partition_of_runs_with_events(
    partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same(PARTITIONS[partition], method, tmp_path, monkeypatch, watched=True)


@pytest.mark.parametrize("method", ["taylor", pytest.param("dop853", marks=pytest.mark.slow)])
@pytest.mark.parametrize("watched", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_optimized_code_gives_the_bits_of_the_quick_code(
    method: str, watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first chunk of the second run uses quickly compiled code, all later ones optimized code."""
    right = whole(method, watched=watched)
    compiled: list[Any] = []
    monkeypatch.setattr(engine, "STEPS_BEFORE_LATE_OPTIMIZING", 1)
    monkeypatch.setattr(lanes, "_COMPILED", {})
    monkeypatch.setattr(engine.CompiledCall, "count", lambda call, steps: compiled.append(count(call, steps)))
    rows = run(method=method, workers=1, watched=watched)
    assert compiled[:3] == [True, False, False]
    assert all(rows[name].tobytes() == right[name].tobytes() for name in right)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["taylor", "radau5"])
@pytest.mark.parametrize("partition", ELSEWHERE)
def test_a_partition_elsewhere(partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(ELSEWHERE[partition], method, tmp_path, monkeypatch)


# The largest memory since this program began; that of `getrusage` counts what the process had that started it.
MEMORY = """
import sys
import lagrange as lg
model = lg.scene("double-pendulum").compile()
grid = lg.grid({"theta1": (-3, 3, 1000), "theta2": (-3, 3, int(sys.argv[1]) // 1000)})
options = {"store": sys.argv[2]} if len(sys.argv) > 2 else {}
runs = lg.ensemble(model, 0.05, grid, **options)
lines = open("/proc/self/status").read().splitlines()
peak = next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
kept = 0 if options else sum(column.bytes for column in runs.columns) * len(runs)
print(peak - kept)
"""


def peak(*arguments: str) -> int:
    done = subprocess.run([sys.executable, "-c", MEMORY, *arguments], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells the memory of a program alone")
def test_memory_is_bounded(tmp_path: Path) -> None:
    """A million members need less than 500 MB beside their results, a store with five times as many no more."""
    pytest.importorskip("zarr")
    assert peak("1000000") < 500e6
    few, many = (peak(str(count), str(tmp_path / f"{count}.zarr")) for count in (400_000, 2_000_000))
    # An allocator keeps some of what it was given back.
    assert many < 500e6 and many - few < 50e6


# --- workers --------------------------------------------------------------------------------------------------
# Workers on other hardware: they run members by other code, and the result says that digits may differ.


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
