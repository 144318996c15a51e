"""Branches: under which condition a node is read at all, and which nodes may have no value.

Of a piecewise only one branch counts. What stands in another may be a root of a negative number, and nothing may be
asked of it: neither its sign, nor whether the motion leaves its domain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache

from lagrange.graph.node import Binding, Graph, Kind, Node, reachable

LIMITED = frozenset(("log", "asin", "acos", "atan2", "pow", "exp", "sinh", "cosh", "acosh", "atanh", "nan"))
"""The functions that have no finite value, or no derivative, at some arguments that are finite doubles."""


class Domains:
    """Tells which nodes may have no finite value at a finite state; the answers are kept."""

    def __init__(self) -> None:
        self._known: dict[Node, bool] = {}

    def limited(self, node: Node) -> bool:
        """Whether the node, or one that it is computed from, has a value in some domain only."""
        known = self._known
        stack = [node]
        while stack:
            top = stack[-1]
            waiting = [arg for arg in top.args if arg not in known]
            if top in known or not waiting:
                stack.pop()
                known[top] = _is_limited(top) or any(known[arg] for arg in top.args)
            else:
                stack.extend(waiting)
        return known[node]


def _is_limited(node: Node) -> bool:
    if node.binding <= Binding.PARAMETER:
        return False
    if node.kind is Kind.POWER:
        return not isinstance(node.data, int) or node.data < 0
    return node.data in LIMITED if node.kind is Kind.CALL else node.kind in (Kind.FACTOR, Kind.SOLVE)


def read_when(graph: Graph, outputs: Sequence[Node]) -> Callable[[Node], Node]:
    """Return a function from a node that the outputs are computed from to the condition under which they read it.

    The condition is 1 where they always do. Of two conditions joined by `and`, one that may have no value is read
    where the other holds, and by `or` where the other does not.
    """
    order = reachable(outputs)
    if not any(node.kind is Kind.CALL and node.data == "piecewise" for node in order):
        return lambda node: graph.one
    domains, found = Domains(), dict.fromkeys(outputs, graph.one)
    for node in reversed(order):
        for arg, condition in _readings(node, found[node], domains):
            found[arg] = either(found[arg], condition) if arg in found else condition
    return found.__getitem__


def _readings(node: Node, when: Node, domains: Domains) -> list[tuple[Node, Node]]:
    """Return each argument of a node with the condition under which it is read."""
    if node.kind is not Kind.CALL or node.data not in ("piecewise", "and", "or"):
        return [(arg, when) for arg in node.args]
    if node.data == "piecewise":
        found = []
        for condition, value in zip(node.args[:-1:2], node.args[1::2], strict=True):
            found += [(condition, when), (value, both(when, condition))]
            when = both(when, opposite(condition))
        return [*found, (node.args[-1], when)]
    first, second = node.args
    return [(arg, _beside(node, when, other, domains)) for arg, other in ((first, second), (second, first))]


def _beside(node: Node, when: Node, other: Node, domains: Domains) -> Node:
    """Return when a condition matters that is joined with another one that always has a value."""
    if domains.limited(other):
        return when
    return both(when, other if node.data == "and" else opposite(other))


def both(a: Node, b: Node) -> Node:
    """Return the condition that two conditions hold."""
    one = a.graph.one
    return b if a is one or a is b else a if b is one else a.graph.call("and", a, b)


def either(a: Node, b: Node) -> Node:
    """Return the condition that one of two conditions holds."""
    one = a.graph.one
    return one if a is one or b is one else a if a is b else a.graph.call("or", a, b)


def opposite(condition: Node) -> Node:
    """Return the condition that a condition does not hold."""
    return condition.graph.call("not", condition)


def where_read(node: Node, condition: Node) -> Node:
    """Return the node where it is read, and 1 elsewhere: finite, positive, and without a zero."""
    graph = node.graph
    return node if condition is graph.one else graph.piecewise([(condition, node)], graph.one)


@lru_cache(maxsize=64)
def square_roots(graph: Graph, nodes: tuple[Node, ...]) -> Mapping[Node, Node]:
    """Return the square roots of what has a fractional power in some nodes, with what is under each.

    A root in a branch that is not taken counts as 1. Powers of positions from -1 down are left out. The last few
    answers are kept, since many runs have the same events.
    """
    powers = [node for node in reachable(nodes) if node.kind is Kind.POWER and node.binding > Binding.PARAMETER]
    bases: dict[Node, Node] = {}
    read = read_when(graph, nodes)
    for node in powers:
        broken = isinstance(node.data, Fraction) and node.data.denominator > 1
        if broken and (node.data > -1 or node.binding >= Binding.VELOCITY):
            base, when = node.args[0], read(node)
            bases[base] = either(bases[base], when) if base in bases else when
    return {where_read(graph.power(base, Fraction(1, 2)), when): base for base, when in bases.items()}
