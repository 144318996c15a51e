"""Tests of the mutants: each has one change, all kinds occur, and names do not depend on edits elsewhere."""

import ast
from pathlib import Path

import pytest

from tests.mutants.mutate import Mutant, mutants, mutated, population, sample
from tests.mutants.order import Reached, chosen, distance

ROOT = Path(__file__).resolve().parents[2]
FILE = "lagrange/machine/made.py"


def outcomes(source: str) -> set[str]:
    """Return the texts of all mutants of a source."""
    return {mutated(source, mutant) for mutant in mutants(FILE, source, 1)}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a + b", {"a - b"}),
        ("a -= b", {"a += b"}),
        ("a * b / c", {"a / b / c", "a * b * c"}),
        ("a // b", {"a * b"}),
        ("a < b <= c", {"a > b <= c", "a < b >= c"}),
        ("a == b", {"a != b"}),
        ("a is None", {"a is not None"}),
        ("a not in b", {"a in b"}),
        ("not a", {"not not a"}),
        ("a and b or c", {"(a or b) or c", "(a and b) and c"}),
        ("a[1]", {"a[2]"}),
        ("emit(f'%r = fadd double {a}, {b}')", {"emit(f'%r = fsub double {a}, {b}')"}),
        ("real('fcmp olt', a, b)", {"real('fcmp ogt', a, b)"}),
        ("value('and i1 %a, %b')", {"value('or i1 %a, %b')"}),
        ("'text' + a", set()),
        ("a + f'{b}'", set()),
        ("x = 2.5, True", set()),
        ("def f(a: tuple[int, 3]) -> x[1]:\n    return a", set()),
        ("x: Literal[1] = a", set()),
        ("'''a text of 1 < 2 fadd'''", set()),
    ],
)
def test_the_changes_of_a_source(source: str, expected: set[str]) -> None:
    assert outcomes(source) == expected


def test_a_mutant_says_where_it_is() -> None:
    source = "class A:\n    def f(self):\n        return g(1 if a < b else c)\n"
    (number, compared) = sorted(mutants(FILE, source, 1), key=lambda mutant: mutant.kind, reverse=True)
    assert (number.function, number.kind, number.line) == ("A.f", "constant", 3)
    assert str(compared) == f"{FILE}:3 A.f: `a < b` -> `a > b`"


def test_names_stay_where_lines_move_and_other_functions_change() -> None:
    before = "def f():\n    return a + b\n\ndef g():\n    return c * d\n"
    after = "X = 1\n\n\ndef g():\n    return c - d\n\ndef f():\n    return a + b\n"
    kept = {mutant.name for mutant in mutants(FILE, before, 1)} & {mutant.name for mutant in mutants(FILE, after, 1)}
    assert kept == {mutant.name for mutant in mutants(FILE, before, 1) if mutant.function == "f"}
    twice = mutants(FILE, "def f():\n    return (a + b) * (a + b)\n", 1)
    assert len({mutant.name for mutant in twice}) == 3
    assert not {mutant.name for mutant in twice} & {mutant.name for mutant in mutants(FILE, before, 2)}


@pytest.mark.slow
def test_every_mutant_of_the_package_is_python_and_another_one(everything: bool) -> None:
    every = population(ROOT, 1)
    assert len({mutant.name for mutant in every}) == len(every) > 5000 and sample(ROOT, 1, 10) == every[:10]
    # A mutant takes some 20 ms. They are in the order of their names, which are digests: some are as good as others.
    for mutant in every[: 500 if everything else 10]:
        source = (ROOT / mutant.file).read_text("utf-8")
        changed = mutated(source, mutant)
        compile(changed, mutant.file, "exec", ast.PyCF_ONLY_AST)
        assert changed != ast.unparse(ast.parse(source))


def test_the_order_in_which_a_mutant_meets_tests() -> None:
    mutant = Mutant("0", "lagrange/machine/drivers.py", 1, "f", "sum", "a + b", "a - b", 0)
    here = frozenset([f"{mutant.file}:f"])
    tests = [
        Reached("tests/machine/test_drivers.py::slow", 9.0, here),
        Reached("tests/machine/test_drivers.py::many[a]", 1.0, here),
        Reached("tests/machine/test_drivers.py::many[b]", 2.0, here),
        Reached("tests/machine/test_drivers.py::elsewhere", 1.0, frozenset(["lagrange/machine/drivers.py:g"])),
        Reached("tests/machine/test_taylor.py::near", 3.0, here),
        Reached("tests/laws/test_taylor.py::far", 1.0, here),
        Reached("tests/laws/test_taylor.py::endless", 1e6, here),
        Reached("tests/show/test_table.py::none", 1.0, frozenset()),
    ]
    tests += [Reached(f"tests/laws/test_taylor.py::endless[{i}]", 1e6, here) for i in range(4)]
    assert [distance(mutant, test.test) for test in tests[:7]] == [0, 0, 0, 0, 1, 2, 2]
    names = [test.partition("::")[2] for test in chosen(mutant, tests, 100.0)]
    assert names == ["many[a]", "slow", "many[b]", "elsewhere", "near", "far"]
    names = [test.partition("::")[2] for test in chosen(mutant, tests, 12.0)]
    assert names == ["many[a]", "many[b]", "near", "far"]
    on_import = Mutant("0", mutant.file, 1, "", "constant", "1", "2", 0)
    assert len(chosen(on_import, tests, 100.0)) == 6
    assert len(chosen(on_import, tests[1:8], 100.0)) == 6
