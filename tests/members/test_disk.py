"""A disk that is full at some write: the call reports it, and the next call continues with the complete blocks."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange.members import jobs, store
from tests.members.store_files import files

zarr = pytest.importorskip("zarr")

PAGE = 4096
"""Bytes by which a file system in memory grows."""


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "LARGEST_BLOCK", 8)
    monkeypatch.setattr(jobs, "LARGEST_CHUNK", 8)


@cache
def model() -> Any:
    return lg.scene("henon-heiles").compile()


def run(target: Path) -> lg.Ensemble:
    """Run three blocks of members, some of which diverge."""
    return lg.ensemble(model(), 15.0, {"x": [0.05 * k for k in range(24)]}, store=target)


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


def goes_on_after(room: int, disk: Filling, target: Path, whole: dict[str, bytes]) -> None:
    """Run until a write fails, and then again with free space."""
    disk.room, disk.writes = room, 0
    with pytest.raises(lg.RunError, match="No space left on device") as error:
        run(target)
    assert "make the same call again" in str(error.value) and "\n" not in str(error.value)
    made = target.exists()
    written = {item.parent.name for item in (target / "checksum" / "c").glob("*/0")}
    disk.room, disk.writes = 10**9, 0
    result = run(target)
    assert lg.Status.INTERRUPTED not in result.status
    assert files(target) == whole
    assert not [item for item in target.parent.iterdir() if item.name.startswith(".")]
    if made:
        block = sum(name.endswith(("/c/0", "/c/0/0")) for name in whole)
        assert disk.writes == (3 - len(written)) * block, "what was stored was written again"


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, bytes]:
    run(tmp_path / "whole.zarr")
    return files(tmp_path / "whole.zarr")


def writes_of(disk: Filling, target: Path) -> int:
    disk.writes = 0
    run(target)
    return disk.writes


def test_some_writes_that_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes]) -> None:
    disk = Filling(monkeypatch)
    count = writes_of(disk, tmp_path / "counted.zarr")
    for room in (0, count // 3, count // 2, count - 1):
        goes_on_after(room, disk, tmp_path / f"{room}.zarr", whole)


@pytest.mark.slow
def test_every_write_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes]) -> None:
    disk = Filling(monkeypatch)
    for room in range(writes_of(disk, tmp_path / "counted.zarr")):
        goes_on_after(room, disk, tmp_path / f"{room}.zarr", whole)


def mount(*options: str) -> None:
    done = subprocess.run(["mount", *options], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")


@contextmanager
def small_disk(folder: Path, options: str) -> Iterator[Path]:
    """A small file system in memory."""
    folder.mkdir()
    mount("-t", "tmpfs", "-o", options, "tmpfs", str(folder))
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["size", "nr_inodes"])
def test_a_disk_of_every_size(tmp_path: Path, kind: str, whole: dict[str, bytes]) -> None:
    """The disk has one more page or file each time, until a call succeeds at once.

    A call that fails is repeated with free space.
    """
    unit, plenty = (PAGE, 64 * 2**20) if kind == "size" else (1, 10_000)
    fails = 0
    for count in range(1, 1000):
        with small_disk(tmp_path / f"{count}", f"{kind}={unit * (count + 1)}") as disk:
            target = disk / "runs.zarr"
            try:
                run(target)
                through = True
            except lg.RunError as error:
                said, through = str(error), False
            if not through:
                fails += 1
                assert "No space left on device" in said and "make the same call again" in said
                mount("-o", f"remount,{kind}={plenty}", str(disk))
                assert lg.Status.INTERRUPTED not in run(target).status
            assert files(target) == whole
        if through:
            break
    assert fails > 20
