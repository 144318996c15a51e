"""A default run takes few of the cases of a product, and every value of every parameter is among them."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests import covering
from tests.covering import Case, dealt, share

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


def test_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(a, b) for a in "abcd" for b in "xy"]
    monkeypatch.setattr(covering, "WHOLE", False)
    assert [share(count) for count in (2, 3, 10, 100)] == [2, 2, 2, 16]
    assert covering.spread("abcdefg", 3) == ["a", "d", "g"] and covering.spread("ab", 3) == ["a", "b"]
    assert len(dealt(rows)) == 4 and {value for row in dealt(rows) for value in row} == set("abcdxy")
    monkeypatch.setattr(covering, "WHOLE", True)
    assert [share(count) for count in (2, 3, 10, 100)] == [2, 3, 10, 100] and dealt(rows) == rows
    assert covering.spread("abcdefg", 3) == [*"abcdefg"]


FILE = """
import pytest
from tests.covering import share

@pytest.mark.parametrize("target", ["numpy", "llvm"])
@pytest.mark.parametrize("name", [object() for _ in range(5)])
def test_product(name, target): ...

@pytest.mark.parametrize("seed", range(share(40)))
def test_chance(seed): ...

@pytest.mark.exhaustive
def test_long(): ...
"""


@pytest.mark.parametrize(
    ("options", "count"), [([], 5 + 6), (["--all"], 10 + 40 + 1), (["-k", "product"], 10), (["::test_long"], 1)]
)
def test_what_a_run_takes(options: list[str], count: int, tmp_path: Path) -> None:
    """Tests of their own name run whole, whatever is asked for otherwise."""
    file = tmp_path / "test_taken.py"
    file.write_text(FILE, encoding="utf-8")
    named = [f"{file}{option}" for option in options if option.startswith("::")]
    given = [option for option in options if not option.startswith("::")]
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider", "-c", "pyproject.toml"]
    found = subprocess.run(
        [*command, "--confcutdir=.", "-p", "tests.conftest", *given, *(named or [str(file)])],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert sum("::" in line for line in found.stdout.splitlines()) == count, found.stdout + found.stderr
