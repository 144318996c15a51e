"""The pages that are made for the documentation site: every public name has a place, every link its target there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

Module = Callable[[str], ModuleType]
ROOT = Path(__file__).resolve().parents[2]


def test_every_public_name_has_a_place_in_the_reference(module: Module) -> None:
    api = module("api")
    assert api.homeless() == []
    assert set(api.CLASSES) <= set(api.placed())


def test_a_name_without_a_place_is_an_error(module: Module, monkeypatch: pytest.MonkeyPatch) -> None:
    api = module("api")
    monkeypatch.setattr(api, "ERRORS", ())
    with pytest.raises(ValueError, match=r"without a place in docs/site/api.py: LagrangeError, RunError"):
        api.pages()


def test_docstrings_keep_their_marks_and_get_links(module: Module) -> None:
    pytest.importorskip("sphinx")
    marked = module("docstrings").marked
    links = {"System.conserved": "lagrange.System.conserved"}
    assert marked("m*l**2 of as_... is `theta_dot`; see `System.conserved`s.", links) == (
        r"m\*l\*\*2 of as\_... is ``theta_dot``\ ; see "
        r":py:obj:`System.conserved <lagrange.System.conserved>`\ s."
    )
    lines = module("docstrings").lines_of(["One line.", "", "    x = 1", "    y = 2"], {})
    assert lines == ["One line.", "", "::", "", "    x = 1", "    y = 2", ""]


def test_links_are_those_of_the_site(module: Module) -> None:
    stage = module("stage")
    page, text = (
        ROOT / "docs" / "howto" / "teaching.md",
        "[a](../../examples/) [b](../benchmarks/#x) [c](https://a.org/b)",
    )
    assert stage.with_links(page, text) == (
        "[a](../tutorials/index.md) [b](../benchmarks/README.md#x) [c](https://a.org/b)"
    )
    changes = stage.with_links(ROOT / "CHANGELOG.md", "[a](docs/limits.md)\n```\n[b](docs/limits.md)\n```\n")
    assert changes == "[a](limits.md)\n```\n[b](docs/limits.md)\n```\n"
    notebook = stage.with_links(ROOT / "examples" / "01-first-steps.ipynb", "[a](../docs/dev/theory.md) [b](x.ipynb)")
    assert notebook == "[a](../dev/theory.md) [b](x.ipynb)"
    with pytest.raises(ValueError, match=r"pyproject.toml is not on the site"):
        stage.with_links(page, "[a](../../pyproject.toml)")


def test_every_page_of_the_documentation_has_a_place(module: Module) -> None:
    navigation = module("navigation")
    entries = [entry for entries in navigation.SECTIONS.values() for entry in entries]
    named = {re.sub(r".*<(.*)>", r"\1", entry) for entry in entries}
    pages = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    beside = {name for name in pages if name.split("/")[0] in navigation.FOLDERS and not name.endswith("/README")}
    made = {name for name in named if name.endswith(("/index", "commands", "changes"))}
    assert pages - beside - {"index"} == named - made


def test_pictures_that_code_saves_stand_behind_it(module: Module) -> None:
    shown = module("shown")
    page = '```python\nimport lagrange\n```\n```python\na.savefig("b.png"); c.to_png("d.png")\n```\nEnd.\n'
    assert shown.with_pictures("howto/x", page) == page.replace(
        "```\nEnd.", "```\n\n![b](x-b.png)\n\n![d](x-d.png)\nEnd."
    )
    assert [len(blocks) for blocks in shown.groups(page)] == [2]
    for name in module("navigation").PAGES_WITH_PICTURES:
        assert shown.SAVED.search((ROOT / "docs" / f"{name}.md").read_text("utf-8")), name
