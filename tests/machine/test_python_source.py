"""The Python that procedures print reads as people and Python's own printer write it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from lagrange.algorithm.linear import gauss_jordan, inverse, ldl
from lagrange.machine.python_source import source
from lagrange.procedure.form import Procedure
from tests.procedure.random_procedures import RandomProcedure

LINEAR: dict[str, Procedure] = {
    "invert_dense": ldl.invert_dense.form(),
    "solve_columns": ldl.solve_columns.form(),
    "invert": inverse.invert.form(),
    "inversion": gauss_jordan.inversion(7),
}
RANDOM = {str(seed): RandomProcedure(seed, fused=False).build() for seed in range(40)}
EVERY = {**LINEAR, **RANDOM}

HALVES = re.compile(r"\((\w+\[0\] \+ \w+\[1\])\) \+ \(")
"""Partial sums are added in pairs, and the parentheses around both are written to show it."""
RETURNED = re.compile(r"return \((.*,.*)\)$")
"""Python's printer puts parentheses around what a function returns, where it is several."""
ELSE_IF = re.compile(r"else:\n +if ")
"""Python's printer writes elif."""


LOOPS = (ast.For, ast.While, ast.ListComp, ast.GeneratorExp)


def lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]


@pytest.mark.parametrize("name", EVERY)
def test_there_is_no_parenthesis_and_no_column_too_many(name: str) -> None:
    ours = source(EVERY[name])
    if ELSE_IF.search(ours):
        pytest.skip("Python's printer writes elif")
    expected = [RETURNED.sub(r"return \1", line) for line in lines(ast.unparse(ast.parse(ours)))]
    assert [HALVES.sub(r"\1 + (", line) for line in lines(ours)] == expected


def used_once_nearby(body: list[ast.stmt], function: ast.AST) -> Iterator[str]:
    """Yield the results of operators that have a name, and are used once behind it outside of any further loop."""
    for place, statement in enumerate(body):
        for inner in (getattr(statement, part, []) for part in ("body", "orelse")):
            yield from used_once_nearby(inner, function)
        match statement:
            case ast.Assign(
                targets=[ast.Name(id=name)],
                value=ast.BinOp() | ast.Compare() | ast.BoolOp() | ast.UnaryOp() | ast.IfExp() as value,
            ):
                if re.fullmatch(r"x\d+", name) is None:
                    continue  # the author of the algorithm gave it a name
                there = [node.ctx for node in ast.walk(function) if isinstance(node, ast.Name) and node.id == name]
                following = [
                    one for one in body[place + 1 :] if not any(isinstance(node, LOOPS) for node in ast.walk(one))
                ]
                near = [node for one in following for node in ast.walk(one) if isinstance(node, ast.Name)]
                if len(there) == 2 and any(node.id == name for node in near) and len(ast.unparse(value)) < 40:
                    yield f"{name} = {ast.unparse(value)}"


@pytest.mark.parametrize("name", ["invert_dense", "inversion"])
def test_what_is_used_once_has_no_name_but_that_of_its_author(name: str) -> None:
    for function in ast.parse(source(LINEAR[name])).body:
        assert isinstance(function, ast.FunctionDef)
        assert list(used_once_nearby(function.body, function)) == []
