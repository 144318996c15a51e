"""The tutorials: the notebooks of examples/ with their outputs, and the scripts of examples/.

A notebook is run once for each version of its cells and of the package. Tests of notebooks store the outputs for this
module.
"""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stage import ROOT, with_links, write_changed

EXAMPLES = ROOT / "examples"
STORED = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
"""The functions of docs/notebooks.py, by name."""

INTRODUCTION = """\
# Tutorials

Lessons as notebooks, with what they print and draw. Each runs in under a minute; the files are in `examples`.

"""


def executed(path: Path) -> str:
    """Return a notebook with its outputs, which is run unless they are stored. An error in a cell is raised."""
    outputs: Path = STORED["outputs_path"](path)
    if not outputs.exists():
        import nbformat
        from nbclient import NotebookClient

        notebook: Any = nbformat.read(path, as_version=4)
        with TemporaryDirectory() as folder:
            resources = {"metadata": {"path": folder}}
            NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
        STORED["store_outputs"](path, nbformat.writes(notebook))
    return outputs.read_text("utf-8")


def on_site(path: Path, text: str) -> str:
    """Return a notebook with its links changed to those of the site."""
    notebook = json.loads(text)
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = with_links(path, "".join(cell["source"]))
    return json.dumps(notebook)


def script_page() -> str:
    """Return the page of the scripts: the topic of each, and its source."""
    parts = ["# Scripts\n\nLonger programs that print and draw; each is one file of `examples/`.\n"]
    for path in sorted(EXAMPLES.glob("*.py")):
        text = path.read_text("utf-8")
        about = (ast.get_docstring(ast.parse(text)) or "").split("\n")[0]
        parts.append(f"## {path.stem}\n\n{about}\n\n```python\n{text}```\n")
    return "\n".join(parts)


def title_and_line(notebook: Path) -> tuple[str, str]:
    """Return the title of a notebook and the first paragraph under it."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    text = "".join(next(cell["source"] for cell in cells if cell["cell_type"] == "markdown"))
    title, _, rest = text.partition("\n")
    paragraph = rest.strip().split("\n\n")[0].replace("\n", " ")
    return title.lstrip("# ").strip(), paragraph


def write(folder: Path) -> None:
    """Write the executed notebooks, the page of scripts, and the page that lists them."""
    notebooks = sorted(EXAMPLES.glob("*.ipynb"))
    lines = []
    for path in notebooks:
        write_changed(folder / path.name, on_site(path, executed(path)))
        title, line = title_and_line(path)
        lines.append(f"1. [{title}]({path.name}): {line}\n" if line else f"1. [{title}]({path.name})\n")
    write_changed(folder / "scripts.md", script_page())
    entries = "\n".join([path.stem for path in notebooks] + ["scripts"])
    lines.append("\n[Scripts](scripts.md) are longer programs that print and draw.\n")
    write_changed(folder / "index.md", f"{INTRODUCTION}{''.join(lines)}\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n")
