"""Redundant constraints: the motion is solved with independent ones, and all of them share the forces.

With the rows G_s of independent constraints the forces are G_s^T lambda_s. The rows of all are G = C G_s, where
C = G G_s^T (G_s G_s^T)^-1, and of all lambda with G^T lambda = G_s^T lambda_s the one of least norm is
C (C^T C)^-1 lambda_s.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, section 5.5.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.equations.constraints import ConstraintEquations
from lagrange.graph.node import Node


def least_norm(stated: ConstraintEquations, kept: Sequence[int], multipliers: Sequence[Node]) -> list[Node]:
    """Return the multipliers of all constraints from those of the constraints kept, whose rows span all rows."""
    others = [i for i in range(len(stated)) if i not in kept]
    if not others:
        return list(multipliers)
    graph = multipliers[0].graph
    rows = [stated.gradient[i] for i in kept]

    def products(row: Sequence[Node]) -> list[Node]:
        return [_dot(row, other) for other in rows]

    square = [products(row) for row in rows]
    shares = [graph.solve(square, products(stated.gradient[i])) for i in others]
    one = graph.one
    gram = [
        [graph.sum([(int(a == b), one), *((1, c[a] * c[b]) for c in shares)]) for b in range(len(rows))]
        for a in range(len(rows))
    ]
    weights = graph.solve(gram, list(multipliers))
    found = dict(zip(kept, weights, strict=True))
    found |= {i: _dot(c, weights) for i, c in zip(others, shares, strict=True)}
    return [found[i] for i in range(len(stated))]


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    return a[0].graph.sum([(1, x * y) for x, y in zip(a, b, strict=True)])
