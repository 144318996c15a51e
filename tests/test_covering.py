"""A default run takes few of the cases of a product, and every value of every parameter is among them."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import covering
from tests.covering import Case, dealt, drawn, examples, share, spread

ROOT = Path(__file__).resolve().parent.parent


def product(**axes: int) -> list[Case]:
    return list(itertools.product(*([(name, value) for value in range(count)] for name, count in axes.items())))


@pytest.mark.parametrize("start", [0, 1, 12345])
@pytest.mark.parametrize("axes", [{"a": 3, "b": 3}, {"a": 2, "b": 39, "c": 2}, {"a": 5, "b": 4, "c": 4, "d": 3}])
def test_every_value_is_taken_in_as_many_cases_as_the_longest_parameter_has_values(
    axes: dict[str, int], start: int
) -> None:
    cases = product(**axes)
    taken = covering.covering(cases, start)
    assert len(taken) == max(axes.values()) and taken == sorted(set(taken))
    assert {value for k in taken for value in cases[k]} == {value for case in cases for value in case}


def test_every_value_is_taken_equally_often() -> None:
    cases = product(method=20, system=5)
    systems = [cases[k][1] for k in covering.covering(cases, 7)]
    assert [systems.count(("system", n)) for n in range(5)] == [4] * 5


def test_as_many_pairs_as_fit() -> None:
    cases = product(method=12, order=3, way=2)
    assert len({cases[k][1:] for k in covering.covering(cases)}) == 6


def test_the_reference_machine_is_taken_once() -> None:
    cases = [(("name", n), ("target", target)) for n in range(30) for target in ("numpy", "llvm")]
    slow = [[cases[k][0][1] for k in covering.covering(cases, s) if cases[k][1][1] == "numpy"] for s in range(30)]
    assert all(len(names) == 1 for names in slow) and len({names[0] for names in slow}) == 30


def test_no_value_is_lost_in_a_product_with_gaps() -> None:
    chance = random.Random(3)
    for _ in range(50):
        cases = [case for case in product(a=6, b=4, c=3) if chance.random() < 0.3]
        taken = covering.covering(cases, chance.randrange(9))
        assert {value for k in taken for value in cases[k]} == {value for case in cases for value in case}


def test_one_list_of_parameters_is_taken_as_a_whole() -> None:
    assert covering.covering(product(a=5)) == [0, 1, 2, 3, 4] and covering.covering([]) == []
    assert covering.covering([(), ()]) == [0, 1]


@pytest.mark.larger
def test_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = (2, 3, 10, 100)
    for everything, found in ((False, [2, 2, 2, 16]), (True, [2, 3, 10, 100])):
        monkeypatch.setattr(covering, "ALL", everything)
        assert [share(count) for count in counts] == [examples(count) for count in counts] == found


def test_how_much_is_tested_is_asked_where_a_run_of_the_remaining_cases_knows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(RuntimeError, match=r"mark it as `@pytest\.mark\.larger`"):
        share(12)
    monkeypatch.setattr(covering, "LARGER", None)
    with pytest.raises(RuntimeError, match="is asked inside a test"):
        share(12)


def test_parameters() -> None:
    """All are there, and those that a default run leaves out are marked."""

    def parts(parameters: list[Any]) -> tuple[list[Any], list[Any]]:
        left = [one for one in parameters if isinstance(one, type(pytest.param()))]
        assert all([mark.name for mark in one.marks] == ["exhaustive"] for one in left)
        return [one for one in parameters if one not in left], [one.values for one in left]

    rows = [(a, b) for a in "abcd" for b in "xy"]
    taken, left = parts(dealt(rows))
    assert len(taken) == 4 and {value for row in taken for value in row} == set("abcdxy")
    assert sorted([*taken, *left]) == rows
    assert parts(spread("abcdefg", 3)) == ([*"adg"], [("b",), ("c",), ("e",), ("f",)])
    assert parts(spread("ab", 3)) == ([*"ab"], [])
    assert parts(drawn(12)) == ([0, 1], [(k,) for k in range(2, 12)])


FILE = """
import pytest
from hypothesis import given, strategies
from tests.covering import drawn

@pytest.mark.parametrize("target", ["numpy", "llvm"])
@pytest.mark.parametrize("name", [object() for _ in range(5)])
def test_product(name, target): ...

@pytest.mark.parametrize("seed", drawn(40))
def test_chance(seed): ...

@pytest.mark.exhaustive
def test_long(): ...

@pytest.mark.larger
@pytest.mark.parametrize("target", ["numpy", "llvm"])
@pytest.mark.parametrize("name", [object() for _ in range(3)])
def test_sizes(name, target): ...

@given(strategies.none())
def test_law(nothing): ...
"""

COLLECT = """
import sys
import pytest
for options in sys.argv[1:]:
    print("\\n# " + options)
    pytest.main("-q --collect-only -p no:cacheprovider -c pyproject.toml --confcutdir=. -p tests.conftest".split()
                + options.split())
"""


def test_what_a_run_takes(tmp_path: Path) -> None:
    """Tests of their own name run whole; what is left out remains, and what is larger in a run of all runs in both."""
    file = tmp_path / "test_taken.py"
    file.write_text(FILE, encoding="utf-8")
    default, everything, remaining, by_keyword, by_name = runs = [
        str(file), f"--all {file}", f"--remaining {file}", f"-k product {file}", f"{file}::test_long"
    ]  # fmt: skip
    found = subprocess.run([sys.executable, "-c", COLLECT, *runs], cwd=ROOT, capture_output=True, text=True, check=True)
    taken: dict[str, list[str]] = {}
    for line in found.stdout.splitlines():
        if line.startswith("# "):
            cases = taken[line[2:]] = []
        elif "::" in line:
            cases.append(line.partition("::")[2])
    assert len(taken[by_keyword]) == 10 and taken[by_name] == ["test_long"]
    assert len(taken[default]) == 5 + 6 + 3 + 1 and len(taken[everything]) == 10 + 40 + 1 + 6 + 1
    both = {case for case in taken[default] if "sizes" in case or "law" in case}
    assert sorted(taken[everything]) == sorted({*taken[default], *taken[remaining]})
    assert {*taken[default]} & {*taken[remaining]} == both and len(both) == 4
    assert all(len(set(cases)) == len(cases) for cases in taken.values())
