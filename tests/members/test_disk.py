"""A disk that is full at some write: the call reports it, and the next call continues with the complete blocks."""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange.members import jobs, store
from tests.members.store_files import files

zarr = pytest.importorskip("zarr")


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
