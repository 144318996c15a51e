"""Missing or changed files of a store, and full disks: the same call runs members again, or reports the damage."""

import errno
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.members import jobs, store
from tests.members.test_store import files
from tests.models import shared_scene
from tests.public.test_wrong_calls import Caught

zarr = pytest.importorskip("zarr")

STARTS = {"x": [0.05 * k for k in range(20)]}

CHANGES: dict[str, Callable[[bytes], bytes | None]] = {
    "missing": lambda old: None,
    "empty": lambda old: b"",
    "cut": lambda old: old[: len(old) // 2],
    "other text": lambda old: b"xx" * 40,
    "zeros": lambda old: bytes(len(old)),
    "one bit": lambda old: (
        old[: len(old) * 3 // 4] + bytes([old[len(old) * 3 // 4] ^ 1]) + old[len(old) * 3 // 4 + 1 :]
    ),
}


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "LARGEST_BLOCK", 8)
    monkeypatch.setattr(jobs, "LARGEST_CHUNK", 8)


def run(folder: Path) -> lg.Ensemble:
    return lg.ensemble(
        shared_scene("henon-heiles"), 2.0, STARTS, t_eval=[1.0, 2.0], keep=("end", "counts"), workers=1, store=folder
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as small:
        small.setattr(store, "LARGEST_BLOCK", 8)
        folder = tmp_path_factory.mktemp("whole") / "runs.zarr"
        run(folder)
    return folder


def read(folder: Path) -> dict[str, Any]:
    runs = run(folder)
    return {column.name: runs.results.column(column.name) for column in runs.columns}


def damage(folder: Path, file: str, change: str) -> None:
    path = folder / file
    content = CHANGES[change](path.read_bytes())
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)


def is_right_or_refused(make: Callable[[], dict[str, Any]], right: dict[str, Any]) -> bool:
    """Return True if all results are right, or if the store is refused. A member without results counts as not run."""
    caught = Caught()
    with caught:
        result = make()
    if caught.error is not None:
        said = str(caught.error)
        assert isinstance(caught.error, lg.LagrangeError) and said.isprintable() and 20 < len(said) <= 400
        # A second call finds the same file.
        assert "same call again" not in said
        return False
    done = result["status"] == right["status"]
    for name, rows in result.items():
        assert np.array_equal(rows[done], right[name][done], equal_nan=True), name
    return bool(done.all())


@pytest.mark.slow
def test_every_file_of_a_store_that_is_damaged_in_every_way(tmp_path: Path, whole: Path, everything: bool) -> None:
    """Damaged files of a block are written again. Damaged files that describe the store may be refused."""
    right = read(whole)
    kinds = ("checksum/", "status/", "t/", "x/", "x_end/", "x_start/", "steps/", "zarr.json")
    chosen = [
        item
        for item in files(whole)
        if item.startswith(kinds) and ("/c/" not in item or "/c/1" in item or item[0] == "t")
    ]
    changes = [*CHANGES]
    for number, file in list(enumerate(chosen))[:: 1 if everything else 5]:
        for change in (changes[number % len(changes)], changes[-1 - number // 2 % len(changes)]):
            target = tmp_path / "runs.zarr"
            shutil.copytree(whole, target)
            damage(target, file, change)
            healed = is_right_or_refused(partial(read, target), right)
            assert healed or file.endswith("zarr.json"), (file, change)
            shutil.rmtree(target)


@pytest.mark.slow
def test_damage_that_comes_after_the_call_is_seen_when_results_are_read(
    tmp_path: Path, whole: Path, everything: bool
) -> None:
    right = read(whole)
    for change in CHANGES if everything else ("one bit",):
        target = tmp_path / change.replace(" ", "-")
        shutil.copytree(whole, target)
        runs = run(target)
        damage(target, "x_end/c/1", change)
        with pytest.raises(lg.RunError, match=r"is damaged .* make the same call again, which runs the members of dam"):
            runs["x_end"]
        assert is_right_or_refused(partial(read, target), right), change


# --- full disk ------------------------------------------------------------------------------------------------
# The call reports a disk that is full at some write, and the next call continues with the complete blocks.


class Filling:
    """A replacement for writing to files that fails at some write, perhaps after a part of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room, self.writes = 10**9, 0
        for module, name in ((zarr.storage._local, "_put"), (store, "write_file")):
            monkeypatch.setattr(module, name, partial(self.write, getattr(module, name)))

    def write(self, put: Callable[..., Any], path: Path, value: Any, *args: Any, **options: Any) -> Any:
        self.writes += 1
        if self.writes > self.room:
            path.parent.mkdir(parents=True, exist_ok=True)
            (path.parent / f"{path.name}.{self.writes}.partial").write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        return put(path, value, *args, **options)


@pytest.mark.slow
def test_some_writes_that_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Path) -> None:
    disk, right = Filling(monkeypatch), files(whole)
    run(tmp_path / "counted.zarr")
    count, block = disk.writes, sum("/c/1" in name for name in right)
    for room in (0, count // 2, count - 1):
        target, disk.room, disk.writes = tmp_path / f"{room}.zarr", room, 0
        with pytest.raises(lg.RunError, match="No space left on device") as error:
            run(target)
        assert "make the same call again" in str(error.value) and "\n" not in str(error.value)
        made, written = target.exists(), {item.parent.name for item in (target / "checksum" / "c").glob("*/0")}
        disk.room, disk.writes = 10**9, 0
        assert lg.Status.INTERRUPTED not in run(target).status
        assert files(target) == right
        assert not [item for item in tmp_path.iterdir() if item.name.startswith(".")]
        if made:
            assert disk.writes == (3 - len(written)) * block, "what was stored was written again"
