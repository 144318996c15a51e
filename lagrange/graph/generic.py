"""The rank of a matrix of nodes at almost every point, by arithmetic modulo a large prime.

Symbols and function values become random residues. Sine and cosine of the same argument are a random point of the unit
circle. The result is never above the generic rank, and below it with a probability of about 1e-17. Functions with other
relations, such as cosh and sinh, count as independent.
Source: J. T. Schwartz, Fast probabilistic algorithms for verification of polynomial identities, J. ACM 27, 1980.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from lagrange.graph.node import Kind, Node, reachable

PRIME = 2**61 - 1


def generic_rank(matrix: Sequence[Sequence[Node]]) -> int:
    """Return the rank of a matrix of nodes at almost every point."""
    nodes = [node for row in matrix for node in row]
    values = _residues(nodes)
    rows = [[values[node] for node in row] for row in matrix]
    rank = 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        inverse = pow(rows[rank][column], -1, PRIME)
        for i in range(rank + 1, len(rows)):
            factor = rows[i][column] * inverse % PRIME
            if factor:
                rows[i] = [(a - factor * b) % PRIME for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
        if rank == len(rows):
            break
    return rank


def _residues(outputs: Sequence[Node]) -> dict[Node, int]:
    """Return {node: residue modulo `PRIME`} for every node that the outputs depend on."""
    chosen = random.Random(1)
    residues: dict[Node, int] = {}
    circle: dict[Node, tuple[int, int]] = {}
    for node in reachable(outputs):
        args = [residues[arg] for arg in node.args]
        value: int | None = None
        if node.kind is Kind.CONSTANT:
            value = node.data.numerator * pow(node.data.denominator, -1, PRIME)
        elif node.kind is Kind.SUM:
            constant, coefficients = node.data
            terms = [(constant, 1), *zip(coefficients, args, strict=True)]
            value = sum(c.numerator * pow(c.denominator, -1, PRIME) * arg for c, arg in terms)
        elif node.kind is Kind.PRODUCT:
            value = 1
            for arg in args:
                value = value * arg % PRIME
        elif node.kind is Kind.POWER and isinstance(node.data, int) and (args[0] or node.data > 0):
            value = pow(args[0], node.data, PRIME)
        elif node.kind is Kind.CALL and node.data in ("sin", "cos"):
            if node.args[0] not in circle:
                half = chosen.randrange(1, PRIME)
                over = pow(1 + half * half, -1, PRIME)
                circle[node.args[0]] = 2 * half * over, (1 - half * half) * over
            value = circle[node.args[0]][node.data == "cos"]
        residues[node] = chosen.randrange(1, PRIME) if value is None else value % PRIME
    return residues
