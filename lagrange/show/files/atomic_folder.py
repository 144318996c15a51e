"""Several files of one folder that belong together: the last of them exists only while all of them do.

All new files are first written beside their targets, where a full disk is detected. Then the last file of the old set
is removed, the others are replaced one by one, and the last file of the new set is moved into place at the end.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from lagrange.errors import RunError
from lagrange.show.files.atomic_file import Writer, filled_part, in_words, old_mode, real_path, sync_folder


def write_together(folder: str | os.PathLike[str], files: Mapping[str, Writer | None]) -> list[Path]:
    """Write files into a folder and return their paths; a file without a writer is removed if it exists.

    An error while the new files are written changes nothing. If the replacement is interrupted, every file is whole,
    and the last one is missing or belongs to the others. Other files of the folder stay. Links are followed, existing
    files keep their permissions. Raises StatementError for a place that cannot be written, RunError if the disk is full
    or fails.
    """
    home = real_path(folder)
    targets = {name: real_path(home / name) for name in files}
    parts: dict[str, Path] = {}
    place = home
    try:
        modes = {name: old_mode(target) for name, target in targets.items()}
        for name, write in files.items():
            place = targets[name]
            if write is not None:
                parts[name] = filled_part(place, write, modes[name])
        _exchange(home, targets, parts)
    except BaseException as error:
        for part in parts.values():
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise in_words(place, error) from error
        raise
    return [targets[name] for name in parts]


def _exchange(home: Path, targets: Mapping[str, Path], parts: Mapping[str, Path]) -> None:
    """Remove the last target, then those without a new file; move the new files to their targets, the last one last."""
    *_, last = targets
    try:
        for name in reversed([*targets]):
            if name == last or name not in parts:
                targets[name].unlink(missing_ok=True)
        for name, part in parts.items():
            part.replace(targets[name])
    except OSError as error:
        raise RunError(
            f"Cannot exchange the files of {home}: {error.strerror}. They are incomplete without {last}: write them "
            "again, or to another folder."
        ) from error
    for folder in {target.parent for target in targets.values()}:
        sync_folder(folder)
