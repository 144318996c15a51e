"""Write the notebooks of examples/ in the form of the repository: no outputs, no counts, the same metadata in each.

    python docs/notebooks.py

Run it after a notebook was edited in Jupyter. A test checks this form.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "examples"
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def stored(text: str) -> str:
    """Return a notebook in the form of the repository. Cells keep their order, their names and their source."""
    cells = [_stored_cell(cell) for cell in json.loads(text)["cells"]]
    notebook = {"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(notebook, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _stored_cell(cell: dict[str, Any]) -> dict[str, Any]:
    lines = cell["source"]
    source = (lines if isinstance(lines, str) else "".join(lines)).strip("\n")
    plain_cell = {
        "cell_type": cell["cell_type"],
        "id": cell["id"],
        "metadata": {},
        "source": source.splitlines(keepends=True),
    }
    return plain_cell | ({"execution_count": None, "outputs": []} if cell["cell_type"] == "code" else {})


def digest(paths: Sequence[Path]) -> str:
    """Return a hash of the contents of files."""
    result = hashlib.sha256()
    for path in paths:
        if path.suffix not in (".pyc", ".pyo"):
            result.update(path.read_bytes())
    return result.hexdigest()


def outputs_path(path: Path) -> Path:
    """Return the path of a notebook's stored outputs for the present cells and the present package."""
    version = digest([path, *sorted((ROOT / "lagrange").rglob("*.*"))])
    return ROOT / "build" / "notebooks" / f"{path.stem}-{version[:16]}.ipynb"


def store_outputs(path: Path, text: str) -> None:
    """Store a notebook with its outputs for the site, in place of earlier ones."""
    target = outputs_path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    for old in target.parent.glob(f"{path.stem}-*.ipynb"):
        old.unlink(missing_ok=True)
    temporary = target.with_suffix(f".{os.getpid()}")
    temporary.write_text(text, "utf-8")
    temporary.replace(target)


def main() -> None:
    """Write each notebook that is not in that form."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        text = path.read_text("utf-8")
        if (plain := stored(text)) != text:
            path.write_text(plain, "utf-8")
            print(f"wrote {path.name}")


if __name__ == "__main__":
    main()
