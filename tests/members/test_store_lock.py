"""Only one call at a time writes to a store. A killed call does not block later ones."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.members import store
from lagrange.members.store import LOCK, StoreLock

pytest.importorskip("zarr")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the system has no such locks")

HOLDER = """
import sys
from pathlib import Path
from lagrange.members.store import StoreLock
lock = StoreLock(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


PLAIN = """
import fcntl, os, sys
descriptor = os.open(sys.argv[1] + "/" + sys.argv[2], os.O_RDWR | os.O_CREAT)
fcntl.lockf(descriptor, fcntl.LOCK_EX)
os.write(descriptor, f"process {os.getpid()} on this machine".encode())
print("held", flush=True)
sys.stdin.read()
"""
"""The same by the calls of the system alone, without the import of the package, which takes a second."""


def run(folder: Path, **options: Any) -> lg.Ensemble:
    return lg.ensemble(lg.scene("pendulum"), 1.0, {"theta": [0.1, 0.2]}, store=folder, **options)


@pytest.mark.parametrize("text", [pytest.param(HOLDER, marks=pytest.mark.slow), PLAIN], ids=["StoreLock", "plain"])
def test_a_store_that_another_process_writes_to_is_refused_until_that_ends(tmp_path: Path, text: str) -> None:
    folder = tmp_path / "runs.zarr"
    run(folder)
    assert not (folder / LOCK).exists()
    holder = subprocess.Popen([sys.executable, "-c", text, str(folder), LOCK], stdin=-1, stdout=-1, text=True)
    try:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with pytest.raises(lg.RunError, match=f"is written to by process {holder.pid} on .*: wait until that is done"):
            run(folder)
    finally:
        os.kill(holder.pid, signal.SIGKILL)
        holder.communicate()
    assert (folder / LOCK).exists(), "a killed process removes nothing"
    assert run(folder).form == "all members were stored"
    assert not (folder / LOCK).exists()


def test_a_store_that_another_thread_writes_to_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, told = tmp_path / "runs.zarr", list[str]()
    write = store.StoredResults.write

    def second() -> None:
        with pytest.raises(lg.RunError) as refusal:
            run(folder)
        told.append(str(refusal.value))

    def slow(storage: Any, *block: Any) -> None:
        monkeypatch.setattr(store.StoredResults, "write", write)
        thread = threading.Thread(target=second)
        thread.start()
        thread.join()
        write(storage, *block)

    monkeypatch.setattr(store.StoredResults, "write", slow)
    runs = run(folder)
    assert len(told) == 1 and "is written to by another thread of this process" in told[0]
    assert np.isfinite(runs.y).all()
    assert run(folder).form == "all members were stored"


def test_a_store_that_another_call_has_made_meanwhile_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, first = tmp_path / "runs.zarr", list[lg.Ensemble]()
    write_file = store.write_file

    def late(*file: Any) -> None:
        if not first:
            monkeypatch.setattr(store, "write_file", write_file)
            first.append(run(folder))
        write_file(*file)

    monkeypatch.setattr(store, "write_file", late)
    assert run(folder).form == "all members were stored"
    assert first[0].ran == 2 and [item.name for item in tmp_path.iterdir()] == ["runs.zarr"]


def test_a_call_that_fails_lets_the_next_one_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "runs.zarr"

    def full(*_: Any) -> None:
        raise lg.RunError("full")

    with monkeypatch.context() as patched:
        patched.setattr(store.StoredResults, "write", full)
        with pytest.raises(lg.RunError, match="full"):
            run(folder)
    assert run(folder).ran == 2


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_child_of_a_killed_process_keeps_no_lock(tmp_path: Path) -> None:
    """Workers of a process pool may outlive the killed program."""
    forking = HOLDER.replace(
        "print(", "import os, time\nif os.fork() == 0:\n    time.sleep(60)\n    os._exit(0)\nprint("
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", forking, str(tmp_path)], stdin=-1, stdout=-1, text=True, start_new_session=True
    )
    try:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        StoreLock(tmp_path).close()
    finally:
        os.killpg(holder.pid, signal.SIGKILL)
        holder.communicate()
