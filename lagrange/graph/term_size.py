"""The size of what cancels in an expression that is zero: the sum of its terms, each as an absolute value."""

from __future__ import annotations

from lagrange.graph.node import Kind, Node


def term_size(node: Node) -> Node:
    """Return the sum of the sizes of a sum's terms; of a product the product of those of its factors."""
    graph = node.graph
    if node.kind is Kind.PRODUCT:
        return graph.product(tuple(map(_sum_size, node.args)))
    return _sum_size(node)


def _sum_size(node: Node) -> Node:
    graph, factor = node.graph, node.graph.one
    while node.kind is Kind.SUM and len(node.args) == 1 and not node.data[0]:  # a common factor stands before the sum
        factor, node = factor * abs(node.data[1][0]), node.args[0]
    if node.kind is not Kind.SUM:
        return factor * graph.call("abs", node)
    constant, coefficients = node.data
    terms = [(abs(c), graph.call("abs", arg)) for c, arg in zip(coefficients, node.args, strict=True)]
    return factor * graph.sum([*terms, (1, graph.node(abs(constant)))])
