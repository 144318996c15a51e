"""A default run takes a sample of a product of parameters; `--remaining` runs the others."""

import itertools
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests import covering
from tests.covering import Case

ROOT = Path(__file__).resolve().parent.parent


def product(**axes: int) -> list[Case]:
    return list(itertools.product(*([(name, value) for value in range(count)] for name, count in axes.items())))


def test_the_reference_machine_is_taken_once() -> None:
    cases = [(("name", n), ("target", target)) for n in range(30) for target in ("numpy", "llvm")]
    assert [cases[k][1][1] for k in covering.covering(cases)].count("numpy") == 1


def test_no_value_is_lost_in_a_product_with_gaps() -> None:
    chance = random.Random(3)
    for _ in range(50):
        cases = [case for case in product(a=6, b=4, c=3) if chance.random() < 0.3]
        taken = covering.covering(cases, 13)
        assert {value for k in taken for value in cases[k]} == {value for case in cases for value in case}


FILE = """
import pytest
from hypothesis import given, strategies

@pytest.mark.parametrize("target", ["numpy", "llvm"])
@pytest.mark.parametrize("name", [object() for _ in range(5)])
def test_product(name, target): ...

@pytest.mark.few
@pytest.mark.parametrize("seed", range(40))
def test_chance(seed): ...

@pytest.mark.parametrize("name", ["quick", pytest.param("long", marks=pytest.mark.slow)])
def test_long(name): ...

@pytest.mark.few
@pytest.mark.parametrize("name", range(5))
def test_sizes(name, share): ...

@pytest.fixture
def size(everything): ...

def test_size(size): ...

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


@pytest.mark.slow
def test_what_a_run_takes(tmp_path: Path) -> None:
    """A test that is named runs completely. Tests that are larger in a full run run in both."""
    file = tmp_path / "test_taken.py"
    file.write_text(FILE, encoding="utf-8")
    default, everything, remaining, by_keyword, by_name = runs = [
        str(file), f"--all {file}", f"--remaining {file}", f"-k product {file}", f"{file}::test_long"
    ]  # fmt: skip
    result = subprocess.run(
        [sys.executable, "-c", COLLECT, *runs], cwd=ROOT, capture_output=True, text=True, check=True
    )
    taken: dict[str, list[str]] = {}
    for line in result.stdout.splitlines():
        if line.startswith("# "):
            cases = taken[line[2:]] = []
        elif "::" in line:
            cases.append(line.partition("::")[2])
    assert len(taken[by_keyword]) == 10 and taken[by_name] == ["test_long[quick]", "test_long[long]"]
    counts = Counter(case.partition("[")[0] for case in taken[default])
    assert counts == {"test_product": 2, "test_chance": 2, "test_long": 1, "test_sizes": 2} | dict.fromkeys(
        ("test_size", "test_law"), 1
    )
    assert len(taken[everything]) == 10 + 40 + 2 + 5 + 1 + 1
    both = {case for case in taken[default] if "size" in case or "law" in case}
    assert sorted(taken[everything]) == sorted({*taken[default], *taken[remaining]})
    assert {*taken[default]} & {*taken[remaining]} == both and len(both) == 4
    assert all(len(set(cases)) == len(cases) for cases in taken.values())
