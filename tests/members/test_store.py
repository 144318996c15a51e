"""Stores and executors: the same bytes wherever members run, and however often a call is stopped and repeated."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.members import store
from tests.refusals import refusal

zarr = pytest.importorskip("zarr")

GRID = lg.grid({"x": (-0.6, 0.6, 12), "y": (-0.3, 0.3, 8)})


def files(folder: Path) -> dict[str, bytes]:
    """Return the content of each file of a store, by its path in the folder."""
    return {str(item.relative_to(folder)): item.read_bytes() for item in sorted(folder.rglob("*")) if item.is_file()}


def run(**options: Any) -> lg.Ensemble:
    return lg.ensemble(lg.scene("henon-heiles"), 8.0, GRID, keep=("end", "counts"), **options)


def columns(runs: lg.Ensemble) -> list[bytes]:
    return [runs.results.column(column.name).tobytes() for column in runs.columns]


@pytest.fixture(scope="module")
def whole() -> lg.Ensemble:
    return run()


@pytest.fixture(autouse=True, scope="module")
def _small_blocks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as small:
        small.setattr(store, "LARGEST_BLOCK", 37)
        yield


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the store of all members. Tests must not change it."""
    folder = tmp_path_factory.mktemp("stored") / "runs.zarr"
    run(store=folder)
    return folder


def test_a_store_has_what_memory_has(whole: lg.Ensemble, stored: Path) -> None:
    again = run(store=stored)
    assert columns(again) == columns(whole) and again.form == "all members were stored"
    assert np.array_equal(again.y, whole.y)
    last = len(GRID) - 1  # its block is not the first one
    assert np.array_equal(again.results.row("state", last), whole.results.row("state", last))
    group = zarr.open_group(str(stored), mode="r")
    assert np.array_equal(group["x_end"][:], whole.y[0]) and np.array_equal(group["x_start"][:], whole.given("x"))
    assert group.attrs["statuses"][int(group["status"][0])] == whole.status[0].value


def test_xarray_opens_a_store(stored: Path, whole: lg.Ensemble) -> None:
    xarray = pytest.importorskip("xarray")
    with xarray.open_zarr(str(stored), consolidated=False) as data:
        assert np.array_equal(data["y_end"].to_numpy(), whole.y[1]) and data["y_end"].dims == ("member",)


def test_a_call_goes_on_where_another_one_stopped(
    tmp_path: Path, stored: Path, monkeypatch: pytest.MonkeyPatch, everything: bool
) -> None:
    """Stored members do not run again, and the files are the same."""
    blocks = -(-len(GRID) // 37)
    written: list[int] = []
    write = store.StoredResults.write

    def stops(storage: Any, k: int, *rest: Any) -> None:
        if len(written) == stops_at:
            raise KeyboardInterrupt
        written.append(k)
        write(storage, k, *rest)

    monkeypatch.setattr(store.StoredResults, "write", stops)
    for stops_at in range(1, blocks + 1) if everything else (2, blocks):
        partial = run(store=tmp_path / "runs.zarr", workers=1)
        assert len(written) == stops_at and len(set(written)) == stops_at
        assert sum(item is lg.Status.INTERRUPTED for item in partial.status) == max(len(GRID) - 37 * stops_at, 0)
    stops_at = -1
    run(store=tmp_path / "runs.zarr")
    assert sorted(written) == list(range(blocks))
    assert files(tmp_path / "runs.zarr") == files(stored)


def test_a_store_of_something_else_is_left_as_it_is(tmp_path: Path, stored: Path) -> None:
    before = files(stored)
    remedy = "It was left as it is: give another store, or repeat the call that made it."
    for options, text in (
        ({"rtol": 1e-8}, "differs in rtol: rtol was None and is 1e-08"),
        ({"method": "rk4"}, "differs in method and steps: method was"),
        ({"parameters": {}, "t_eval": [1.0]}, "differs in t_eval"),
    ):
        message = refusal(run, store=stored, **options)
        assert text in message and message.endswith(remedy)
    with pytest.raises(lg.StatementError, match=r"differs in statement \(its name, about, .*potential"):
        lg.ensemble(lg.scene("kepler"), 8.0, GRID, keep=("end", "counts"), store=stored)
    (tmp_path / "other").mkdir()
    for other in (tmp_path / "other", Path(__file__)):
        assert "is not a store of an ensemble" in refusal(run, store=other)
    assert files(stored) == before


def test_arrays_that_differ_late_are_another_ensemble(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "LARGEST_BLOCK", 2**16)
    values = np.zeros(70_000)

    def store_members() -> None:
        lg.ensemble(lg.scene("pendulum"), 1e-3, {"theta": values}, method="euler", step=1e-3, store=tmp_path / "a.zarr")

    store_members()
    values[-1] = 1.0
    assert "differs in values" in refusal(store_members)


def test_a_worker_that_is_killed_is_told() -> None:
    with ProcessPoolExecutor(1) as processes:
        pid = processes.submit(os.getpid).result()
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(lg.RunError, match="the executor failed"):
            run(executor=processes)


def test_what_cannot_be_sent_is_refused() -> None:
    method = lg.methods.step_method(lambda f, t, y, h: y + h * f(t, y), order=1, name="mine", step=0.1)
    with (
        ProcessPoolExecutor(1) as processes,
        pytest.raises(lg.StatementError, match="cannot be sent to other processes"),
    ):
        lg.ensemble(lg.scene("pendulum"), 1.0, {"theta": [1.0]}, method=method, executor=processes)


def test_a_store_says_how_its_sample_was_drawn(tmp_path: Path) -> None:
    drawn = lg.sample({"theta": (0.1, 0.2)}, 4, seed=2**60 + 1, method="latin")
    for given in ({"initial": drawn}, {"initial": drawn, "parameters": {"l": [1.0, 1.1, 1.2, 1.3]}}):
        path = tmp_path / f"{len(given)}.zarr"
        lg.ensemble(lg.scene("pendulum"), 1.0, **given, store=path)
        made = zarr.open_group(str(path), mode="r").attrs["lagrange"]
        assert made["drawn"] == [{"sample": "latin", "seed": 2**60 + 1, "of": ["theta"]}]
