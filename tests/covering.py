"""Which cases of a product of parameters a default run takes: every value of every parameter, not every combination.

A test over methods, machines and systems has hundreds of cases, most of which say what their neighbours said. A default
run takes as many cases as the longest parameter has values. The others are dealt over them such that each value occurs,
and as many pairs of values as fit; the reference machine occurs once, since tests of its own hold the two machines
together. Tests whose parameters are one list keep all of it.
"""

from __future__ import annotations

import itertools
import zlib
from collections import Counter
from collections.abc import Container, Hashable, Iterable, Sequence
from typing import Any

import pytest

ALL = False
"""Whether more than a default run was asked for; `conftest.py` says so before tests are collected."""

LARGER: bool | None = None
"""Whether the test that runs is marked `larger`; None between tests, and while they are collected."""

PART, LEAST = 6, 2
"""Of what is drawn at random a default run takes one in `PART`, and so many at least."""

Value = tuple[str, Hashable]
"""The names of what is given together, and which of the values it is."""
Case = tuple[Value, ...]

SELDOM = ("target", "numpy")
"""The value that is taken once only: the interpreted machine, which runs a step some hundred times as long."""


def covering(cases: Sequence[Case], start: int = 0) -> list[int]:
    """Return which cases to take, sorted: every value occurs. `start` says at which value of the longest to begin."""
    if not cases or len(cases[0]) < 2:
        return list(range(len(cases)))
    columns = [list(dict.fromkeys(column)) for column in zip(*cases, strict=True)]
    leading = max(range(len(columns)), key=lambda k: len(columns[k]))
    order, start = columns[leading], start % len(columns[leading])
    taken: list[int] = []
    used: Counter[Hashable] = Counter()
    for value in (*order[start:], *order[:start]):
        taken.append(_best((k for k, case in enumerate(cases) if case[leading] == value), cases, used))
        used.update((*cases[taken[-1]], *_pairs(cases[taken[-1]])))
    for k, case in enumerate(cases):
        if not all(used[value] for value in case):  # of a product with gaps
            taken.append(k)
            used.update(case)
    return sorted(taken)


def _best(choices: Iterable[int], cases: Sequence[Case], used: Counter[Hashable]) -> int:
    """Return the case with the most values that are new, then not the slow machine, then with the most new pairs.

    Of those that are left it is the one whose values were taken least often.
    """

    def gain(k: int) -> tuple[int, bool, int, int]:
        case = cases[k]
        new, pairs = (sum(not used[what] for what in found) for found in (case, _pairs(case)))
        return new, SELDOM not in case, pairs, -sum(used[value] for value in case)

    return max(choices, key=gain)


def _pairs(case: Case) -> list[tuple[Value, Value]]:
    return list(itertools.combinations(case, 2))


def waiting(*rows: object) -> list[Any]:
    """Return parameters that a default run leaves out."""
    return [pytest.param(*(row if isinstance(row, tuple) else (row,)), marks=pytest.mark.exhaustive) for row in rows]


def spread(rows: Sequence[object], count: int) -> list[Any]:
    """Return parameters, of which a default run takes `count`, at equal distances from the first to the last."""
    taken = {k * (len(rows) - 1) // (count - 1) for k in range(count)} if len(rows) > count else range(len(rows))
    return parameters(rows, taken)


def dealt(rows: Sequence[tuple[Hashable, ...]]) -> list[Any]:
    """Return the rows of a product that has gaps as parameters, of which a default run takes every value."""
    return parameters(rows, places(rows))


def places(rows: Sequence[tuple[Hashable, ...]]) -> list[int]:
    """Return which rows of a product that has gaps a default run takes: every value occurs."""
    return covering([tuple((str(k), value) for k, value in enumerate(row)) for row in rows])


def drawn(count: int) -> list[Any]:
    """Return the seeds of random cases as parameters, of which a default run takes its share."""
    return parameters(range(count), range(_share(count)))


def parameters(rows: Sequence[object], taken: Container[int]) -> list[Any]:
    """Return rows as parameters, of which a default run takes those at the given places."""
    return [one for k, row in enumerate(rows) for one in ([row] if k in taken else waiting(row))]


def examples(count: int) -> int:
    """Return the number of examples of a law that Hypothesis draws, which runs in both parts of a run of all."""
    return count if ALL else _share(count)


def whole() -> bool:
    """Return whether a test does all that it can, inside a test that is marked `larger`."""
    if LARGER is None:
        raise RuntimeError("How much is tested is asked inside a test; a list of parameters is spread, dealt or drawn.")
    if not LARGER:
        raise RuntimeError("This test does more in a run of all: mark it as `@pytest.mark.larger`.")
    return ALL


def share(count: int) -> int:
    """Return how often a test repeats what it does `count` times in a run of all, with other random numbers."""
    return count if whole() else _share(count)


def _share(count: int) -> int:
    return min(count, max(LEAST, count // PART))


def case_of(item: pytest.Item) -> Case:
    """Return the values that a test is given, one for each list of parameters that it has."""
    given = getattr(item, "callspec", None)
    if given is None:
        return ()
    marks = [mark.args[0] if mark.args else mark.kwargs["argnames"] for mark in item.iter_markers("parametrize")]
    together = [
        tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else tuple(names) for names in marks
    ]
    return tuple((",".join(names), _identity([given.params[name] for name in names])) for names in together)


def _identity(values: Sequence[object]) -> Hashable:
    """Return which values these are: a text itself, anything else by the object, which all cases of a product share."""
    return values[0] if len(values) == 1 and isinstance(values[0], str) else tuple(id(value) for value in values)


def thinned(items: Sequence[pytest.Item]) -> tuple[list[pytest.Item], list[pytest.Item]]:
    """Return the tests that a default run takes, in their order, and the rest."""
    tests: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("exhaustive") is None:
            tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    kept: set[pytest.Item] = set()
    for name, cases in tests.items():
        # The text decides where to begin, so that not all tests pair the same method with the same system.
        kept.update(cases[k] for k in covering([case_of(item) for item in cases], zlib.crc32(name.encode())))
    return [item for item in items if item in kept], [item for item in items if item not in kept]
