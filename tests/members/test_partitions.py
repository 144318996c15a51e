"""One ensemble in many partitions: the bits of a member do not depend on the partition."""

from __future__ import annotations

import multiprocessing
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
from lagrange.members import jobs, store

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
    keep = ("end", "counts", "drift", ("max", x), ("min", x**2 - y), ("mean", y))
    runs = lg.ensemble(model(), 15.0, starts, keep=keep, t_eval=[1.0, 7.5, 15.0], **options)
    return {column.name: runs.results.column(column.name) for column in runs.columns}


@cache
def whole(method: str) -> Columns:
    return run(method=method, workers=1)


def ordered(order: Any, **options: Any) -> Columns:
    """Run members in another order, and return their results in the original order."""
    return {name: rows[np.argsort(order)] for name, rows in run(order, **options).items()}


def in_parts(parts: list[Any], **options: Any) -> Columns:
    """Run members in several smaller ensembles."""
    result = {name: np.empty_like(rows) for name, rows in whole(options["method"]).items()}
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
    with (
        distributed.LocalCluster(dashboard_address=None, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
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


def same(partition: tuple[int, Callable[..., Columns]], method: str, folder: Path, patch: pytest.MonkeyPatch) -> None:
    size, result = partition
    right = dict(whole(method))
    patch.setattr(jobs, "FIRST_CHUNK", min(size, 8))
    patch.setattr(jobs, "LARGEST_CHUNK", size)
    patch.setattr(store, "LARGEST_BLOCK", size)
    given = result(folder, method=method)
    assert set(given) == set(right)
    assert method != "taylor" or len(set(right["status"].tolist())) == 2, "all members end in the same way"
    for name, rows in right.items():
        assert given[name].tobytes() == rows.tobytes(), name


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("partition", PARTITIONS)
def test_a_partition(partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(PARTITIONS[partition], method, tmp_path, monkeypatch)


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
