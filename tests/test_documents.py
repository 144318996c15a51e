"""What the pages say can be done: their Python runs, their links lead somewhere, the files that they name exist."""

from __future__ import annotations

import ast
import re
import runpy
from importlib.util import find_spec
from pathlib import Path

import pytest

from lagrange.trajectory.methods import registry

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)#\s]+)[^)]*\)")
NAMED = re.compile(r"`((?:lagrange|tests|examples|docs)/[\w./-]+)`")


RECIPES = ("casadi", "cffi", "jax", "numba")
OPTIONAL = (*RECIPES, "fmpy")
"""Packages that a page may import and that need not be installed; each of the first has a page of its own."""


def snippets() -> list[tuple[str, str]]:
    """The Python blocks that stand alone, because they import what they use."""
    blocks = (
        (page, body) for page in PAGES for kind, body in FENCE.findall(page.read_text("utf-8")) if kind == "python"
    )
    return [(page.relative_to(ROOT).as_posix(), body) for page, body in blocks if "import lagrange" in body]


def missing(body: str) -> list[str]:
    """Return the packages of extras that a block imports and that are not installed."""
    taken = [name for node in ast.walk(ast.parse(body)) if isinstance(node, ast.Import) for name in node.names]
    return [name.name for name in taken if name.name in OPTIONAL and find_spec(name.name) is None]


def test_a_block_whose_package_is_missing_is_skipped_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.find_spec", lambda name: None)
    assert missing("import jax\nimport numpy as np\nimport lagrange as lg\n") == ["jax"]


def test_every_recipe_has_a_page_with_a_block_that_runs() -> None:
    pages = [page for page, _ in snippets()]
    assert [name for name in (*RECIPES, "scipy", "sympy") if not any(f"recipes/{name}." in page for page in pages)] == [
        "cffi"
    ]
    assert pages.count("docs/recipes/c.md") == 2


def test_the_readme_has_a_first_result_in_six_lines() -> None:
    first = next(body for page, body in snippets() if page == "README.md")
    assert len([line for line in first.splitlines() if line.strip()]) <= 6


@pytest.mark.parametrize("body", [pytest.param(body, id=page) for page, body in snippets()])
def test_the_python_on_the_page_runs(body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if lacking := missing(body):
        pytest.skip(f"not installed: {', '.join(lacking)}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_registered", {})  # what a page registers is not there for the next
    script = tmp_path / "snippet.py"
    script.write_text(body, encoding="utf-8")
    runpy.run_path(str(script))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = [target for target in LINK.findall(page.read_text("utf-8")) if "://" not in target]
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_file_that_is_named_exists(page: Path) -> None:
    assert [name for name in NAMED.findall(page.read_text("utf-8")) if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("words", ["-m pytest", "lagrange run"])
def test_the_readme_has_each_command_once(words: str) -> None:
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len([line for line in lines if line.startswith("python3 -m venv ") and words in line]) == 1
