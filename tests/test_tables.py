"""The tables on the pages equal those made from the registries."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parent.parent / "docs"
SCRIPT = runpy.run_path(str(DOCS / "tables.py"))


@pytest.mark.parametrize("marker", ["scenes", "methods"])
def test_the_page_has_the_table_of_now(marker: str) -> None:
    name, make = SCRIPT["TABLES"][marker]
    page = (DOCS / name).read_text("utf-8")
    assert SCRIPT["filled"](page, marker, make()) == page, f"run docs/tables.py: {name} is out of date"
