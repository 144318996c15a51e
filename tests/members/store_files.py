"""The files of a store."""

from pathlib import Path


def files(folder: Path) -> dict[str, bytes]:
    """Return the content of each file of a store, by its path in the folder."""
    return {str(item.relative_to(folder)): item.read_bytes() for item in sorted(folder.rglob("*")) if item.is_file()}
