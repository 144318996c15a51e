"""The notebooks run, their statements hold, and they are stored in one format."""

import ast
import json
import os
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)[^)]*\)")
ALLOWED = frozenset(("lagrange", "sympy", "numpy", *sys.stdlib_module_names))
LONGEST = 60.0
"""Seconds of the processor that a notebook may take: the longest takes five."""
HANGS = 600
"""Seconds after which a cell counts as one that does not end."""

notebooks = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells(path: Path, kind: str) -> list[tuple[str, str]]:
    """Return the names and sources of the cells of one kind."""
    result = json.loads(path.read_text("utf-8"))["cells"]
    return [(cell["id"], "".join(cell["source"])) for cell in result if cell["cell_type"] == kind]


def imported(source: str) -> set[str]:
    """Return the packages that a cell imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=aliases):
                names |= {alias.name.partition(".")[0] for alias in aliases}
            case ast.ImportFrom(module=str(module)):
                names.add(module.partition(".")[0])
    return names


def tolerances_without_a_reason(source: str) -> list[int]:
    """Return the lines of a cell that assert a numerical bound without a comment."""
    lines = source.splitlines()
    bounds = [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Assert)
        and any(isinstance(part, ast.Constant) and isinstance(part.value, float) for part in ast.walk(node.test))
    ]
    return [line for line in bounds if "# " not in lines[line - 1] and not _explained(lines[: line - 1])]


def _explained(above: list[str]) -> bool:
    """Return True if a comment precedes a line in its group of lines."""
    while above and above[-1].strip():
        if above[-1].strip().startswith("#"):
            return True
        above = above[:-1]
    return False


def is_shown(data: dict[str, str]) -> bool:
    """Return True if the output of a cell is a picture, a page, a formula, or readable text."""
    return len(data) > 1 or not re.search(r"<Figure size| object at 0x|^\w+\(", data["text/plain"])


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the name of a kernel that runs the Python of this test."""
    folder = tmp_path_factory.mktemp("jupyter")
    (folder / "kernels" / "this-python").mkdir(parents=True)
    argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    spec = {"argv": argv, "display_name": "this Python", "language": "python", "env": {"PYTHONPATH": str(ROOT)}}
    (folder / "kernels" / "this-python" / "kernel.json").write_text(json.dumps(spec), "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JUPYTER_PATH", str(folder))
        yield "this-python"


def time_of_processes() -> float:
    """Return the processor time of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


@pytest.mark.slow
@notebooks
def test_the_notebook_runs(path: Path, kernel: str, tmp_path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    began = time_of_processes()
    NotebookClient(
        notebook, timeout=HANGS, kernel_name=kernel, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    taken = time_of_processes() - began
    outputs = [(cell.id, output) for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert [(name, output.text) for name, output in outputs if output.get("name") == "stderr"] == []
    assert [(name, output.data) for name, output in outputs if "data" in output and not is_shown(output.data)] == []
    assert (
        sum("image/png" in output.data or "text/html" in output.data for _, output in outputs if "data" in output) >= 1
    )
    assert taken < LONGEST
    SCRIPT["store_outputs"](
        path, nbformat.writes(notebook)
    )  # the documentation site shows it, and need not run it again


@notebooks
def test_the_notebook_is_stored_in_one_form(path: Path) -> None:
    text = path.read_text("utf-8")
    assert SCRIPT["stored"](text) == text, f"run docs/notebooks.py: {path.name} has outputs or metadata of its own"
    nbformat.validate(nbformat.reads(text, as_version=4))


@notebooks
def test_cells_have_names_that_stay(path: Path) -> None:
    names = [cell["id"] for cell in json.loads(path.read_text("utf-8"))["cells"]]
    assert len(names) == len(set(names))
    assert [name for name in names if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name)] == []


@notebooks
def test_the_notebook_needs_nothing_but_the_package_and_what_it_is_made_of(path: Path) -> None:
    assert set().union(*(imported(source) for _, source in cells(path, "code"))) - ALLOWED == set()


@notebooks
def test_every_tolerance_has_a_reason(path: Path) -> None:
    asserted = [name for name, source in cells(path, "code") if "assert " in source]
    assert len(asserted) >= 3
    assert {name: lines for name, source in cells(path, "code") if (lines := tolerances_without_a_reason(source))} == {}


@notebooks
def test_every_link_of_the_notebook_leads_somewhere(path: Path) -> None:
    targets = [target for _, source in cells(path, "markdown") for target in LINK.findall(source)]
    assert [target for target in targets if "://" not in target and not (path.parent / target).exists()] == []


def test_what_a_notebook_gave_is_kept_for_its_text_and_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
    monkeypatch.setitem(script["outputs_path"].__globals__, "ROOT", tmp_path)
    notebook = tmp_path / "a.ipynb"
    for text in ("1", "2"):
        notebook.write_text(text, "utf-8")
        assert not script["outputs_path"](notebook).exists()
        script["store_outputs"](notebook, f"outputs of {text}")
        assert script["outputs_path"](notebook).read_text("utf-8") == f"outputs of {text}"
    assert len(list((tmp_path / "build" / "notebooks").iterdir())) == 1
