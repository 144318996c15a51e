"""Sizes of the terms of an expression: the scale for deciding whether its value is zero.

The size of a sum is the sum of the sizes of its terms. The size of a product is the product of the sizes of its
factors. Bounded functions, and functions whose value is an angle or a logarithm, have a size of at least 1, the unit of
their argument or value. So x**2 + y**2 - l**2 has the size x**2 + y**2 + l**2, and l sin(a) the size l at every angle.
"""

from __future__ import annotations

from collections.abc import Iterable

from lagrange.graph.node import Kind, Node, reachable
from lagrange.statement.vocabulary.elementary import ELEMENTARY

BOUNDED = frozenset(elementary.name for elementary in ELEMENTARY.values() if elementary.size == "bounded")
"""Functions with values up to 1; their size is 1."""

AT_LEAST_ONE = frozenset(
    ("atan2", *(elementary.name for elementary in ELEMENTARY.values() if elementary.size == "unit"))
)
"""Functions with dimensionless argument or value, in whose argument terms may cancel; their size is at least 1."""


def term_sizes(outputs: Iterable[Node]) -> list[Node]:
    """Return the size of each output, the scale for deciding whether it is zero, as a node that is not negative."""
    outputs = list(outputs)
    sizes: dict[Node, Node] = {}
    for node in reachable(outputs):
        sizes[node] = _size(node, sizes)
    return [sizes[node] for node in outputs]


def _size(node: Node, sizes: dict[Node, Node]) -> Node:
    """Return the node of the size of a node, from the sizes of its arguments.

    The size is the magnitude that the value would have if no terms cancelled.
    """
    graph, inner = node.graph, [sizes[arg] for arg in node.args]
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        return graph.sum([(abs(c), size) for c, size in zip(coefficients, inner, strict=True)], abs(constant))
    if node.kind is Kind.PRODUCT:
        return graph.product(inner)
    if node.kind is Kind.POWER and node.data > 0:
        return graph.power(inner[0], node.data)
    if node.kind is not Kind.CALL:
        return graph.call("abs", node)
    if node.data in BOUNDED:
        return graph.one
    if node.data in ("min", "max"):
        return graph.call("max", *inner)
    if node.data == "abs":
        return inner[0]
    if node.data == "piecewise":
        conditions = node.args[:-1:2]
        return graph.piecewise(list(zip(conditions, inner[1::2], strict=True)), inner[-1])
    size = graph.call("abs", node)
    return size + 1 if node.data in AT_LEAST_ONE else size
