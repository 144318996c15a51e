"""The cases of a test that a default run takes: few of a product of parameters, and of a list marked `few`.

A test over methods, machines and systems has hundreds of cases, most of which say what their neighbours said. A default
run takes `CASES` of them, dealt such that as many values of the parameters, and as many pairs of values, occur as fit.
The names of the cases decide where to begin, so that each test meets other methods on other systems. The reference
machine occurs once in a test: tests of its own hold the two machines together.
"""

import itertools
import zlib
from collections import Counter
from collections.abc import Callable, Hashable, Sequence

import pytest

CASES = 2
"""Cases of one product of parameters, or of one list marked `few`, in a default run."""

PART, LEAST = 8, 2
"""Random examples inside a test: a default run draws one in `PART`, and at least `LEAST`."""

ALL = False
"""True if more than a default run was asked for; `conftest.py` sets it before tests are collected."""

Value = tuple[str, Hashable]
"""Name of a parameter, and what identifies its value."""
Case = tuple[Value, ...]
Share = Callable[[int], int]
"""The fixture `share`: repetitions in a run of all -> repetitions in this run."""

SELDOM = ("target", "numpy")
"""The interpreted machine, which takes a hundred times as long for a step: one case of a test runs on it."""


def covering(cases: Sequence[Case], most: int = CASES) -> list[int]:
    """Return the indices of at most `most` cases, sorted, which hold as many values and pairs of values as fit.

    The next case is the one with the most new values; then one on the compiled machine; then the one with the most new
    pairs; then the one whose values were taken least often; then the first.
    """
    pairs = [tuple(itertools.combinations(case, 2)) for case in cases]
    used: Counter[Hashable] = Counter()

    def gain(k: int) -> tuple[int, bool, int, int]:
        new, new_pairs = (sum(not used[entry] for entry in entries) for entries in (cases[k], pairs[k]))
        return new, SELDOM not in cases[k], new_pairs, -sum(used[value] for value in cases[k])

    left = list(range(len(cases)))
    while left and len(cases) - len(left) < most:
        best = max(left, key=gain)
        left.remove(best)
        used.update((*cases[best], *pairs[best]))
    return sorted({*range(len(cases))} - {*left})


def examples(count: int) -> int:
    """Return the number of random examples that a test draws, of `count` in a run of all."""
    return count if ALL else min(count, max(LEAST, count // PART))


def case_of(item: pytest.Item) -> Case:
    """Return the parameters of a case: a text by itself, any other value by the object that its cases share."""
    call = getattr(item, "callspec", None)
    parameters = call.params if call is not None else {}
    return tuple((name, value if isinstance(value, str) else id(value)) for name, value in parameters.items())


def many(item: pytest.Item) -> bool:
    """Return True for a case of a product of parameters, and of a test marked `few`."""
    return item.get_closest_marker("few") is not None or len([*item.iter_markers("parametrize")]) > 1


def most_of(item: pytest.Item) -> int:
    """Return how many cases of its test a default run takes: `CASES`, or as many as the mark says, `few(1)`."""
    few = item.get_closest_marker("few")
    return int(few.args[0]) if few is not None and few.args else CASES


def thinned(items: Sequence[pytest.Item]) -> tuple[list[pytest.Item], list[pytest.Item]]:
    """Return the cases that a default run takes, in their order, and the others."""
    kept: set[pytest.Item] = set()
    for _, group in itertools.groupby(items, key=lambda item: item.nodeid.partition("[")[0]):
        cases = [item for item in group if item.get_closest_marker("slow") is None]
        if cases and many(cases[0]):
            cases.sort(key=lambda item: zlib.crc32(item.nodeid.encode()))
            cases = [cases[k] for k in covering([case_of(item) for item in cases], most_of(cases[0]))]
        kept.update(cases)
    return [item for item in items if item in kept], [item for item in items if item not in kept]
