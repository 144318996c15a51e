"""A notebook that imports nothing but lagrange and SymPy, run by a kernel: each cell that shows something shows it."""

from functools import cache
from importlib.util import find_spec
from typing import Any

import pytest

from tests.show.notebook.shown import held

pytestmark = pytest.mark.slow
"""A kernel takes seconds; `test_results.py` shows the same results without one."""

NEEDED = ("nbclient", "nbformat", "ipykernel")

BEGIN = """
import lagrange as lg
from sympy import cos
theta = lg.coordinate("theta")
m, g, l = lg.parameters("m g l")
pendulum = lg.System(m*l**2*theta.dot**2/2, -m*g*l*cos(theta), parameters={m: 1, g: 9.81, l: 1}, initial={theta: 2.0})
model = pendulum.compile()  # which may take long enough to be announced
"""

CELLS: dict[str, tuple[str, str]] = {
    "printed derivation": ("print(pendulum.derivation())", ""),
    "derivation": ("pendulum.derivation()", "text/markdown"),
    "run": ("solution = pendulum.run(5.0, progress=True)\nsolution", "text/html"),
    "failed run": ("pendulum.run(5.0, max_steps=3, progress=True)", "text/html"),
    "plot": ("solution.plot()", "image/png"),
    "modules": ("import sys\nprint([name for name in ('ipywidgets', 'rich') if name in sys.modules])", ""),
    "explore": ("pendulum.explore(l=(0.5, 2.0), theta=(0, 3))", "text/html"),
    "after pyplot": ("import matplotlib.pyplot as plt\nsolution.plot()", "image/png"),
}
"""Cells, each with the type of what it shows in the first place."""


@cache
def executed() -> dict[str, list[dict[str, Any]]]:
    """Return the outputs of each cell, run in one kernel; a cell that raises fails the test."""
    import nbformat
    from nbclient import NotebookClient

    sources = {"begin": BEGIN, **{name: source for name, (source, _) in CELLS.items()}}
    cells = [nbformat.v4.new_code_cell(source) for source in sources.values()]
    notebook = nbformat.v4.new_notebook(cells=cells)
    NotebookClient(notebook, timeout=600, kernel_name="python3").execute()
    nbformat.validate(notebook)
    return {name: cell["outputs"] for name, cell in zip(sources, notebook.cells, strict=True)}


@pytest.fixture(autouse=True)
def outputs(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[dict[str, Any]]]:
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: no notebook is run")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # a kernel has Matplotlib's inline backend unless it is told
    return executed()


def results(outputs: list[dict[str, Any]]) -> list[dict[str, str]]:
    return [item["data"] for item in outputs if item["output_type"] in ("execute_result", "display_data")]


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_shows_what_it_ends_with(name: str, outputs: dict[str, list[dict[str, Any]]]) -> None:
    kind = CELLS[name][1]
    errors = [item for item in outputs[name] if item.get("name") == "stderr"]
    assert errors == []
    shown = results(outputs[name])
    assert bool(shown) == bool(kind)
    for data in shown:
        assert "Figure size" not in data["text/plain"] and len(data["text/plain"]) <= 20_000
        assert set(data) <= {"text/plain", "text/html", "text/markdown", "image/png"}
        for mime, what in data.items():
            if mime != "text/plain":
                held(mime.split("/")[1], what)
    if kind:
        assert kind in shown[-1]


def test_progress_stays_in_the_output_as_it_was_last(outputs: dict[str, list[dict[str, Any]]]) -> None:
    bar, card = results(outputs["run"])
    assert "<progress value='1.000' max='1'" in bar["text/html"] and "t = 5, " in bar["text/html"]
    assert bar["text/plain"].startswith("100%  t = 5, ") and "<img src='data:image/png" in card["text/html"]
    bar, card = results(outputs["failed run"])
    assert "<progress value='1.000'" not in bar["text/html"] and "max_steps" in card["text/html"]


def test_what_is_printed_stays_text(outputs: dict[str, list[dict[str, Any]]]) -> None:
    assert "Equations of motion\n    m*l**2*theta_ddot" in "".join(
        item["text"] for item in outputs["printed derivation"]
    )
    assert "".join(item["text"] for item in outputs["modules"]).strip() == "[]"
