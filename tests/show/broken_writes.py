"""A program for tests that stops a change of files at each operation in turn, and prints the remaining files as JSON.

Its arguments are an empty folder, the kind of change (together, single), and one or more causes: kill, full, SIGINT.
Each cause gets its own folder.
"""

import errno
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO
from unittest import mock

from lagrange.errors import LagrangeError
from lagrange.show.files.atomic_file import write_atomically, write_together

OPERATIONS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.listdir", "os.scandir")
NAMES = ("a.csv", "b.png", "c.json")


def new(file: BinaryIO) -> None:
    file.write(b"new")


def stop(how: str, folder: Path, number: int) -> Callable[[], None]:
    """Stop operation number `number` in the folder, counted from 0. Return the function that counts an operation."""
    count = 0

    def operation() -> None:
        nonlocal count
        count += 1
        if count - 1 != number:
            return
        if how == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.kill(os.getpid(), signal.SIGKILL if how == "kill" else signal.SIGINT)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in OPERATIONS and str(arguments[0]).startswith(str(folder)):
            operation()

    sync = os.fsync

    def fsync(descriptor: int) -> None:
        operation()
        sync(descriptor)

    mock.patch.object(os, "fsync", fsync).start()
    sys.addaudithook(hook)
    return lambda: leave(0 if count <= number else 9)


def leave(code: int) -> None:
    """End this process at once, without cleaning up."""
    sys.stderr.flush()
    os._exit(code)


def write(what: str, folder: Path) -> None:
    if what == "together":
        write_together(folder, {"a.csv": new, "b.png": None, "c.json": new})
    else:
        write_atomically(folder / "a.csv", new)


def child(how: str, what: str, folder: Path, number: int) -> None:
    """Write files, stopped at an operation; end with the exit code 0 if there was no such operation."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    over = stop(how, folder, number)
    try:
        write(what, folder)
    except LagrangeError as error:
        sys.stderr.write(f"{error}\n")
        leave(8)
    except KeyboardInterrupt:
        leave(7)
    over()


def state(folder: Path) -> dict[str, str]:
    """Return the texts of the files in the folder, and the names of hidden files."""
    return {path.name: "" if path.name.startswith(".") else path.read_text() for path in sorted(folder.iterdir())}


def main(folder: Path, how: str, what: str) -> list[dict[str, Any]]:
    """Return, for each stopped operation, the remaining files, and the files after the next write."""
    result = []
    for number in range(200):
        for name in (*NAMES, "mine.txt"):
            (folder / name).write_text("old")
        if (process := os.fork()) == 0:
            child(how, what, folder, number)
        _, status = os.waitpid(process, 0)
        code = os.waitstatus_to_exitcode(status)
        left = state(folder)
        for path in folder.glob(".*"):
            path.unlink()
        write(what, folder)
        result.append({"code": code, "left": left, "then": state(folder)})
        if code == 0:
            return result
    raise SystemExit("it never gets through")


def all_of(folder: Path, what: str, ways: list[str]) -> dict[str, list[dict[str, Any]]]:
    """Return the remaining files for each cause."""
    for how in ways:
        (folder / how).mkdir()
    return {how: main(folder / how, how, what) for how in ways}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(all_of(Path(sys.argv[1]).resolve(), sys.argv[2], sys.argv[3:])))
