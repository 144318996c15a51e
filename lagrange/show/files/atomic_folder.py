"""Several files of one folder that change together: all of them, or none.

A rename is atomic, three are not. So the new files are written into a folder beside them first, which is where a full
disk shows. Then the old files move into that folder, and after them the new ones out of it. At no time is a file of
one run beside a file of another; the last file of the list is there only while all of them are. The folder's name says
how far it got, and whoever writes here next completes or takes back what a killed process left.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from lagrange.errors import RunError, StatementError, listing
from lagrange.show.files.atomic_file import Writer, fill, in_words, old_mode, real_path
from lagrange.show.files.temporary import abandoned, lock, locked, sync_folder, uninterrupted

WRITING, LEAVING, ARRIVING = "writing", "leaving", "arriving"
"""The three states, the endings of the folder's name: new files are written; old files leave; new files arrive."""

_STEM = ".lagrange-"


def write_together(folder: str | os.PathLike[str], files: Mapping[str, Writer | None]) -> list[Path]:
    """Write files into a folder, all or none, and return their paths; one without a writer is removed if it is there.

    Whatever stops it, the folder holds what was there before or the whole of what is new. Other files in it stay as
    they are. Links are followed, existing files keep their permissions. Raises StatementError for what cannot be
    written, RunError if the disk is full or fails.
    """
    home = real_path(folder)
    targets = {name: real_path(home / name) for name in files}
    try:
        modes = {name: old_mode(target) for name, target in targets.items()}
        _check_links(home, targets)
        recover(home)
        return _Transaction(home, targets).run(files, modes)
    except OSError as error:
        raise in_words(home, error) from error


def recover(folder: str | os.PathLike[str]) -> None:
    """Complete or take back what a killed process left of `write_together` in a folder."""
    home = real_path(folder)
    try:
        with locked(home), uninterrupted():
            for stage in sorted(home.glob(f"{_STEM}*")):
                if abandoned(stage):
                    _recover(home, stage)
    except OSError as error:
        raise in_words(home, error) from error


def _recover(home: Path, stage: Path) -> None:
    part = stage / {LEAVING: "old", ARRIVING: "new"}.get(stage.name.rpartition(".")[2], "nothing")
    for path in sorted(part.iterdir()) if part.is_dir() else []:
        path.replace(real_path(home / path.name.partition("-")[2]))
    sync_folder(home)
    shutil.rmtree(stage)


def _check_links(home: Path, targets: Mapping[str, Path]) -> None:
    for name, target in targets.items():
        if target.parent.stat().st_dev != home.stat().st_dev:
            raise StatementError(
                f"Cannot write {home / name}: it is a link to another file system, {target}. Remove the link or name "
                "another folder."
            )
        if list(targets.values()).count(target) > 1:
            same = listing(other for other, path in targets.items() if path == target)
            raise StatementError(f"Cannot write {home}: {same} are links to one file, {target}. Remove the links.")


class _Transaction:
    """One change of the files of a folder."""

    def __init__(self, home: Path, targets: dict[str, Path]) -> None:
        self.home = home
        self.targets = targets
        self.parts = {name: f"{number:02}-{name}" for number, name in enumerate(targets)}  # in the order of arrival
        self.key = f"{_STEM}{os.urandom(8).hex()}"
        self.state = ""
        self.left: list[str] = []
        self.arrived: list[str] = []

    @property
    def stage(self) -> Path:
        """The folder of the transaction, whose name tells its state."""
        return self.home / f"{self.key}.{self.state}"

    def run(self, files: Mapping[str, Writer | None], modes: Mapping[str, int | None]) -> list[Path]:
        """Write, exchange and clean up; return the paths of what was written."""
        descriptor = None
        try:
            with locked(self.home), uninterrupted():
                self.state = WRITING
                self.stage.mkdir()
                if os.name == "posix":
                    descriptor = os.open(self.stage, os.O_RDONLY)
                    lock(descriptor)
            for part in ("old", "new"):
                (self.stage / part).mkdir()
            new = [self._fill(name, write, modes[name]) for name, write in files.items() if write is not None]
            sync_folder(self.stage / "new")
            with locked(self.home), uninterrupted():
                self._exchange(new)
        finally:
            with uninterrupted():
                if self.state:  # what cannot be removed now, the next transaction here removes
                    shutil.rmtree(self.stage, ignore_errors=True)
                if descriptor is not None:
                    os.close(descriptor)
        return [self.targets[name] for name in new]

    def _fill(self, name: str, write: Writer, mode: int | None) -> str:
        part = self.stage / "new" / self.parts[name]
        try:
            with part.open("xb") as file:
                fill(file, write)
            if mode is not None:
                part.chmod(mode)
        except OSError as error:
            raise in_words(self.targets[name], error) from error
        return name

    def _exchange(self, new: list[str]) -> None:
        """Let the old files leave, the last one first, and the new ones arrive; take all back if that fails."""
        try:
            self._turn(LEAVING)
            for name in reversed(self.targets):
                if self.targets[name].exists():
                    self.targets[name].replace(self.stage / "old" / self.parts[name])
                    self.left.append(name)
            sync_folder(self.home)
            self._turn(ARRIVING)
            for name in new:
                (self.stage / "new" / self.parts[name]).replace(self.targets[name])
                self.arrived.append(name)
            sync_folder(self.home)
        except BaseException as error:
            self._take_back(error)
            raise

    def _turn(self, state: str) -> None:
        self.stage.rename(self.home / f"{self.key}.{state}")
        self.state = state

    def _take_back(self, cause: BaseException) -> None:
        try:
            for name in reversed(self.arrived):
                self.targets[name].replace(self.stage / "new" / self.parts[name])
            if self.state == ARRIVING:
                self._turn(LEAVING)
            for name in reversed(self.left):
                (self.stage / "old" / self.parts[name]).replace(self.targets[name])
        except OSError:
            kept, self.state = self.stage, ""
            raise RunError(
                f"Cannot write {self.home}: {cause}. What was there could not be put back and is in {kept}: the next "
                "run that writes to this folder puts it back or completes the change."
            ) from cause
