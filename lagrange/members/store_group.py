"""The folder of a store: made whole or not at all, never written to if it holds anything else, and its variables."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.members.chunk import INTERRUPTED, STATUSES
from lagrange.members.job import Job
from lagrange.members.keep import OUTPUT_TIME, OUTPUTS, STATE, STATUS
from lagrange.members.names import BLOCK, CHECKSUM, MEMBER, VARIABLE, start_name, stored_names
from lagrange.members.origin import difference
from lagrange.members.results import Results
from lagrange.members.store_blocks import DAMAGE, StoreBlocks, reading, same_array, same_values
from lagrange.members.table import MemberTable

ATTRIBUTES = "lagrange"
"""The attributes that say what was run."""


def folder_of(store: Any) -> Path:
    """Return the path of a store. Raises StatementError for what no folder can be called."""
    if not isinstance(store, (str, os.PathLike)) or not str(store):
        raise StatementError(f'store is {shown(store)}: give the name of a folder, such as "runs.zarr".')
    if "://" in str(store):
        raise StatementError(f"store is {shown(store)}: give the name of a folder of this machine, such as runs.zarr.")
    if "\0" in str(store):
        raise StatementError(f"store is {shown(store)}, which no folder can be called: give a name, such as runs.zarr.")
    return Path(store).expanduser()


def find_store(path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> None:
    """Make a store where there is none; refuse one of anything else. See `lagrange.members.store.kept_in_store`."""
    zarr = _zarr()
    if not os.path.lexists(path):
        _make(zarr, path, job, table, made_of)
    _check(zarr, path, made_of)


def open_store(path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> StoreBlocks:
    """Return the blocks of a store that is there, without what a call that was killed left of a file.

    What describes its arrays is written again where it is missing or has changed.
    """
    zarr = _zarr()
    with writing(path):
        for rest in path.rglob("*.partial"):
            rest.unlink(missing_ok=True)
        files = _files(zarr, job, table, made_of)
        _restore(zarr, path, files)
    with reading(path):
        group = zarr.open_group(str(path), mode="r+")
    names = tuple(variables_of(job, table, 0, 0, Results.empty(0, job.columns)))
    return StoreBlocks(path, group, names, len(table), made_of["block"])


def _restore(zarr: Any, path: Path, files: Mapping[str, bytes]) -> None:
    """Write the files that describe an array, where it is missing or differs from the one that was made."""
    buffer = zarr.core.buffer.default_buffer_prototype().buffer.from_bytes
    made = zarr.open_group(zarr.storage.MemoryStore({name: buffer(text) for name, text in files.items()}), mode="r")
    for name, wanted in made.arrays():
        try:
            found = zarr.open_array(str(path / name), mode="r")
            same = same_array(found, wanted) and (name != OUTPUT_TIME or same_values(found, wanted[:]))
        except DAMAGE:
            same = False
        for file in () if same else files:
            if file.startswith(f"{name}/"):
                write_file(path / file, files[file])


def _zarr() -> Any:
    try:
        import zarr
    except ModuleNotFoundError as error:
        raise StatementError(
            "store= needs zarr, which is not installed: pip install zarr xarray, or in a checkout "
            "pip install '.[store]'."
        ) from error
    return zarr


def _check(zarr: Any, path: Path, made_of: Mapping[str, Any]) -> None:
    """Refuse a folder that holds anything but this ensemble."""
    try:
        found = dict(zarr.open_group(str(path), mode="r").attrs).get(ATTRIBUTES)
    except PermissionError as error:
        raise StatementError(f"{path} may not be read: give another store, or the right to read it.") from error
    except DAMAGE:
        found = None
    if not isinstance(found, dict):
        raise StatementError(f"{path} exists and is no store of an ensemble: give another name. It was left as it is.")
    if differs := difference(found, made_of):
        raise StatementError(
            f"{path} holds another ensemble, which differs in {differs}. It was left as it is: give another store, or "
            "make the call that it was made by."
        )


def _make(zarr: Any, path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> None:
    """Make a store whose blocks are all to be written; it has its name when it is whole."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except (OSError, ValueError) as error:  # a name that no file system takes is a ValueError
        raise _not_made(path, error) from error
    try:
        for name, content in _files(zarr, job, table, made_of).items():
            write_file(folder / name, content)
        folder.chmod(0o755)
        folder.rename(path)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError) and error.errno in (errno.ENOTEMPTY, errno.EEXIST) and path.is_dir():
            return  # another call has made it since
        if isinstance(error, OSError):
            raise _not_made(path, error) from error
        raise


def _files(zarr: Any, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the files of a store without results.

    They are made in memory: zarr writes files from several threads, some of which go on after one of them failed.
    """
    members, block = len(table), made_of["block"]
    attributes = {ATTRIBUTES: dict(made_of), "statuses": [one.value for one in STATUSES]}
    held: dict[str, Any] = {}
    group = zarr.open_group(zarr.storage.MemoryStore(held), mode="w", attributes=attributes)
    names = job.problem.model.layout.names()
    dimensions = {part: column.dimensions for column in job.columns for part in stored_names(column.name, names)}
    variables = variables_of(job, table, 0, 0, Results.empty(0, job.columns))
    for name, rows in variables.items():
        rest = rows.shape[1:]
        group.create_array(
            name,
            shape=(members, *rest),
            chunks=(min(block, members), *rest),
            dtype=rows.dtype,
            fill_value=INTERRUPTED if name == STATUS else np.nan if rows.dtype.kind == "f" else 0,
            dimension_names=(MEMBER, *dimensions.get(name, ())),
        )
    count = len(variables)
    group.create_array(
        CHECKSUM,
        shape=(-(-members // block), count),
        chunks=(1, count),
        dtype="u8",
        fill_value=0,
        dimension_names=(BLOCK, VARIABLE),
    )
    if job.problem.t_eval is not None:
        shape = job.problem.t_eval.shape
        times = group.create_array(OUTPUT_TIME, shape=shape, dtype="f8", dimension_names=(OUTPUT_TIME,))
        times[:] = job.problem.t_eval
    return {name: content.to_bytes() for name, content in held.items()}


def write_file(path: Path, content: bytes) -> None:
    """Write a file and the folder that it is in."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _not_made(path: Path, error: OSError | ValueError) -> StatementError | RunError:
    """Return what to say of a store that could not be made: of a full disk, or of a place that cannot have it."""
    number, reason = (error.errno, error.strerror) if isinstance(error, OSError) else (None, None)
    reason = reason or str(error)
    if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
        return RunError(f"{path} could not be made ({reason}): make room, and make the same call again.")
    return StatementError(f"{path} cannot be made ({reason}): give a folder that can be written to, such as runs.zarr.")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say what a disk that fails means for the ensemble."""
    try:
        yield
    except OSError as error:
        raise RunError(
            f"{path} could not be written ({error.strerror or error}). The blocks of members that were written before "
            "are kept: make room, or mend what is wrong, and make the same call again; it goes on from there."
        ) from error


def variables_of(job: Job, table: MemberTable, begin: int, end: int, results: Results) -> dict[str, Any]:
    """Return the variables of members by name, each with a row for every member."""
    names = job.problem.model.layout.names()
    found: dict[str, Any] = {}
    for column in job.columns:
        rows, parts = results.column(column.name), stored_names(column.name, names)
        apart = column.name in (STATE, OUTPUTS)
        found |= {one: rows[..., i] for i, one in enumerate(parts)} if apart else {parts[0]: rows}
    which = np.arange(begin, end)
    for key, label in zip(table.varied.keys, table.labels, strict=True):
        found[start_name(label, names)] = table.varied.values(key, which)
    return found
