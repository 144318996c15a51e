"""Rooted trees, one for each order condition of a Runge-Kutta method (Hairer, Norsett, Wanner, Solving ODE I, II.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from functools import cache
from math import prod
from string import ascii_lowercase
from typing import Any

Tree = tuple[Any, ...]
"""A tree is the sorted tuple of its root's subtrees; a leaf is the empty tuple."""

Coefficient = Fraction | float
Coefficients = tuple[Coefficient, ...]


@cache
def trees(order: int) -> tuple[Tree, ...]:
    """Return the rooted trees with `order` nodes. There are 1, 1, 2, 4, 9, 20, 48, 115, 286 trees of 1 to 9 nodes."""
    if order == 1:
        return ((),)
    return tuple(dict.fromkeys(grown for tree in trees(order - 1) for grown in _grafted(tree)))


def _grafted(tree: Tree) -> Iterator[Tree]:
    """Yield the trees that grow from a tree by one more leaf, at each of its nodes in turn."""
    yield ((), *tree)
    for index, child in enumerate(tree):
        for grown in _grafted(child):
            yield tuple(sorted((*tree[:index], grown, *tree[index + 1 :])))


@cache
def size(tree: Tree) -> int:
    """Return the number of nodes of a tree."""
    return 1 + sum(map(size, tree))


@cache
def density(tree: Tree) -> int:
    """Return the density gamma of a tree: the exact solution has the weight theta**size / gamma for this tree."""
    return size(tree) * prod(map(density, tree))


def stage_weights(matrix: tuple[Coefficients, ...], order: int) -> Mapping[Tree, Coefficients]:
    """Return the weights Phi_j(tree) of the stages j, (stages,), for every tree with at most `order` nodes.

    The order condition of a tree is sum_j b_j Phi_j = 1/gamma. `matrix` is the lower triangle A of a tableau; row i
    has at least i entries. If an entry is a float, all entries become floats, with which the weights of order 9 take
    milliseconds only.
    """
    unit: Coefficient = Fraction(1)
    if any(isinstance(entry, float) for row in matrix for entry in row):
        matrix, unit = tuple(tuple(map(float, row)) for row in matrix), 1.0
    weights: dict[Tree, Coefficients] = {(): (unit,) * len(matrix)}
    fed: dict[Tree, Coefficients] = {}
    for level in range(1, order):
        for tree in trees(level):
            fed[tree] = tuple(dot(row, weights[tree]) for row in matrix)
        for tree in trees(level + 1):
            weights[tree] = tuple(prod(factors) for factors in zip(*(fed[child] for child in tree), strict=True))
    return weights


def dot(left: Coefficients, right: Coefficients) -> Coefficient:
    """Return the sum of products of two rows of coefficients, up to the end of the shorter row.

    The sum is exact if the entries are.
    """
    return sum((a * b for a, b in zip(left, right, strict=False) if a and b), Fraction(0))


def formula(tree: Tree) -> str:
    """Return the formula of a tree's elementary weight, such as ``c_i^2 a_ij c_j``; empty for a single node."""
    letters = iter(ascii_lowercase[ascii_lowercase.index("i") :])
    return _formula(tree, next(letters), letters)


def _formula(tree: Tree, index: str, letters: Iterator[str]) -> str:
    leaves = tree.count(())
    parts = [f"c_{index}" + (f"^{leaves}" if leaves > 1 else "")] if leaves else []
    for child in tree:
        if child:
            letter = next(letters)
            parts.append(f"a_{index}{letter} {_formula(child, letter, letters)}")
    return " ".join(parts)
