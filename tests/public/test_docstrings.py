"""Docstrings of the public surface say what a call raises, and name nothing that is not there."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import pytest

import lagrange as lg
from lagrange import methods

CLASSES = (lg.System, lg.Solution, lg.Race)
"""Classes whose methods say it one by one; that of Model says once what all of its methods raise."""
LINKED = re.compile(r"`((?:System|Model|Solution|Race)\.\w+|lagrange\.\w+|lg\.\w+)(?:\(\w*\))?`")


def calls() -> Iterator[tuple[str, Any]]:
    """Yield every public function that takes something, and such methods of public classes, by name."""
    for module, names in ((lg, lg.__all__), (methods, methods.__all__)):
        for name in names:
            thing = getattr(module, name)
            if inspect.isfunction(thing) and name[0].islower():
                yield name, thing
    for kind in CLASSES:
        for name, thing in inspect.getmembers(kind, callable):
            if not name.startswith("_"):
                yield f"{kind.__name__}.{name}", thing


def takes_something(thing: Any) -> bool:
    return bool(set(inspect.signature(thing).parameters) - {"self", "cls"})


@pytest.mark.parametrize("thing", [pytest.param(thing, id=name) for name, thing in calls() if takes_something(thing)])
def test_a_call_that_takes_something_says_what_it_raises(thing: Any) -> None:
    assert re.search(r"\b[Rr]aise[sd]?\b|Error\b", inspect.getdoc(thing) or "")


def test_the_names_that_docstrings_refer_to_are_there() -> None:
    texts = [inspect.getdoc(thing) or "" for _, thing in calls()]
    named = {name for text in texts for name in LINKED.findall(text)}
    assert len(named) > 5
    for name in sorted(named):
        home, _, member = name.rpartition(".")
        assert hasattr(lg if home in ("lg", "lagrange") else getattr(lg, home), member), name
