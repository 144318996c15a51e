"""Rebuilding of nodes with other arguments, for substitution and for passes over a graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from lagrange.graph.node import Kind, Node, reachable


def rebuild(node: Node, args: Sequence[Node]) -> Node:
    """Return the node with other arguments, simplified as when it was first built."""
    graph = node.graph
    if all(new is old for new, old in zip(args, node.args, strict=True)):
        return node
    if node.kind is Kind.SUM:
        return graph.sum(zip(node.data[1], args, strict=True), node.data[0])
    if node.kind is Kind.PRODUCT:
        return graph.product(args)
    if node.kind is Kind.POWER:
        return graph.power(args[0], node.data)
    if node.kind is Kind.CALL and node.data == "piecewise":
        return graph.piecewise(list(zip(args[:-1:2], args[1::2], strict=True)), args[-1])
    if node.kind is Kind.CALL:
        return graph.call(node.data, *args)
    return graph.plain(node.kind, tuple(args), node.data)


def substitute(outputs: Iterable[Node], replacements: Mapping[Node, Node]) -> list[Node]:
    """Return the outputs with some nodes, usually symbols, replaced."""
    outputs = list(outputs)
    table = dict(replacements)
    for node in reachable(outputs, excluded=replacements.keys()):
        table[node] = rebuild(node, [table[arg] for arg in node.args])
    return [table[node] for node in outputs]


class Substitution:
    """Replaces nodes by others. Replacements may be added between calls; rebuilt nodes are cached."""

    def __init__(self) -> None:
        self._replaced: dict[Node, Node] = {}
        self._table: dict[Node, Node] = {}

    def __call__(self, node: Node) -> Node:
        """Return the node with all replacements so far applied."""
        table = self._table
        missing: set[Node] = set()
        stack = [node]
        while stack:
            inner = stack.pop()
            if inner not in table and inner not in missing:
                missing.add(inner)
                stack.extend(inner.args)
        for inner in sorted(missing, key=lambda inner: inner.id):
            table[inner] = rebuild(inner, [table[arg] for arg in inner.args])
        return table[node]

    def replace(self, node: Node, other: Node) -> None:
        """Replace `node` by `other` in later calls."""
        self._replaced[node] = other
        if self._table.get(node, other) is not other:
            # Cached nodes that contain this one were built from its old value.
            self._table = dict(self._replaced)
        self._table[node] = other
