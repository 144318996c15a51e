"""Write a model as source files of a target."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from lagrange.errors import StatementError, shown
from lagrange.export.contents import module_of, wanted
from lagrange.export.target import check_operations, find
from lagrange.machine.model import Model
from lagrange.show.files.atomic_file import real_path, write_together
from lagrange.statement.event import declare_events
from lagrange.statement.expression import refusing_deep


@dataclass(frozen=True)
class Exported:
    """The result of an export: paths of the written files, and shell lines to run in their folder.

    `commands` build and run the self-test; its exit status is 0 if all results are right. `run_commands` build and run
    `main`, which writes its table; empty if `main` is not among the contents.
    """

    files: tuple[Path, ...]
    commands: tuple[str, ...]
    run_commands: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        lines = [f"wrote {path}" for path in self.files]
        return "\n".join(
            [*lines, f"to test them, in {self.files[0].parent}:", *(f"  {command}" for command in self.commands)]
        )


@refusing_deep
def export(
    model: Model,
    target: str,
    path: str | os.PathLike[str],
    contents: Sequence[str] | None,
    events: Any,
    parameters: Mapping[Any, Any] | None,
) -> Exported:
    """Write a model as source files of a target into the folder `path`, which is created if it is missing.

    `contents` are the names of quantities and methods to export, None for the default ones. `events` are the events
    to export, and `parameters` values that replace the stated ones. If this fails, folders that were created are
    removed.
    """
    chosen = find(target)
    declared = () if events is None else declare_events(events, model.statement, constant="an export")
    folder = real_path(path)
    try:
        created = [ancestor for ancestor in (folder, *folder.parents) if not ancestor.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StatementError(
            f"the folder {shown(str(folder), 120)} cannot be made ({error.strerror}): name another folder for the "
            "files."
        ) from error
    try:
        module = module_of(model, wanted(chosen, model, contents, declared, parameters), declared, parameters)
        check_operations(chosen, module)
        files = chosen.files(module)
        data = {name: text.encode("ascii") if isinstance(text, str) else text for name, text in files.items()}
        written = write_together(folder, {name: partial(_put, content) for name, content in data.items()})
    except BaseException:
        for new_folder in created:
            new_folder.rmdir()
        raise
    runs = [] if module.run is None else chosen.run_commands(module)
    return Exported(tuple(written), tuple(chosen.commands(module)), tuple(runs))


def _put(data: bytes, file: BinaryIO) -> None:
    file.write(data)
