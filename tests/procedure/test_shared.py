"""Procedures are built once, by threads that ask for one at the same time too."""

from __future__ import annotations

import ast
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import lagrange.procedure
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import Procedure
from lagrange.procedure.shared import shared

ROOM = Path(lagrange.procedure.__file__).parent


def test_threads_that_ask_at_once_get_one_procedure() -> None:
    gate, built = threading.Barrier(4), list[str]()

    @shared
    def small(name: str) -> Procedure:
        built.append(name)
        time.sleep(0.05)
        p = Builder(name, "Nothing.")
        return p.finish()

    def ask(name: str) -> Procedure:
        gate.wait()
        return small(name)

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(ask, ["one", "one", "two", "one"]))
    assert sorted(built) == ["one", "two"]
    assert len({*found}) == 2 and found[0] is found[1] is found[3]


def test_every_procedure_that_is_remembered_is_shared() -> None:
    """`functools.cache` lets two threads build two procedures of one name, which no procedure may call both."""
    for path in ROOM.rglob("*.py"):
        if path.parent.name == "front":
            continue  # it remembers syntax trees, which may be read twice
        tree = ast.parse(path.read_text("utf-8"))
        names = [one.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for one in node.names]
        assert "cache" not in names, f"{path.name}: remember what is built with @shared"
