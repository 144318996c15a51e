"""Rewritten functions stored beside byte code: the next process uses them, unless a source has changed."""

import importlib.util
import linecache
import sys
from pathlib import Path
from typing import Any

import pytest

from lagrange.procedure.front import decorators
from lagrange.procedure.interpreter import run

SOURCE = """
from lagrange.procedure.front.decorators import procedure

@procedure
def doubled(x: float) -> float:
    return x * 2.0
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a module in a new package, for which functions are stored."""
    monkeypatch.setattr(decorators, "PACKAGE", tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    path = tmp_path / "module.py"
    path.write_text(SOURCE)
    return path


def doubled(source: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the function of a module, imported as in a new process."""
    monkeypatch.setattr(decorators, "_STORED", {})
    linecache.clearcache()
    decorators._module.cache_clear()
    spec = importlib.util.spec_from_file_location(source.stem, source)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.doubled


def stored(source: Path) -> Path:
    return next((source.parent / "__pycache__").glob("*.plain"))


def test_the_next_process_reads_no_source(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = doubled(source, monkeypatch).form()
    function = doubled(source, monkeypatch)
    monkeypatch.setattr(decorators, "source_of", None)
    assert function.form().body == expected.body
    assert run(function.form(), 3.0) == (6.0,)


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: content[:40] + b"?" + content[41:]])
def test_a_damaged_file_is_ignored_and_replaced(damage: Any, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doubled(source, monkeypatch).form()
    content = stored(source).read_bytes()
    stored(source).write_bytes(damage(content))
    assert run(doubled(source, monkeypatch).form(), 3.0) == (6.0,)
    assert stored(source).read_bytes() == content


def test_a_change_of_the_source_counts(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doubled(source, monkeypatch).form()
    source.write_text(SOURCE.replace("2.0", "14.0"))
    assert run(doubled(source, monkeypatch).form(), 3.0) == (42.0,)


def test_a_folder_that_cannot_be_written_to_is_no_error(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (source.parent / "__pycache__").write_text("")
    assert doubled(source, monkeypatch).form().name == "doubled"
