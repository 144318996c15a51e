"""Find the conditions under which an expression evaluates each of its nodes, and nodes that may have no finite value.

A piecewise expression evaluates one branch. The other branches may have no value, for example a root of a negative
number. So sign changes and domains of nodes in those branches must not be monitored along a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache

from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.statement.expression import parts_first

LIMITED = frozenset(("log", "asin", "acos", "atan2", "pow", "exp", "sinh", "cosh", "acosh", "atanh", "nan"))
"""Functions that have no finite value or no finite derivative at some finite arguments."""


def may_lack_value(node: Node, known: dict[Node, bool]) -> bool:
    """Return True if `node`, or a node on which it depends, may have no finite value at a finite state.

    `known` has the results for other nodes, and is extended.
    """
    for part in parts_first(node, known):
        known[part] = _is_limited(part) or any(known[arg] for arg in part.args)
    return known[node]


def _is_limited(node: Node) -> bool:
    if node.binding <= Binding.PARAMETER:
        return False
    if node.kind is Kind.POWER:
        return not isinstance(node.data, int) or node.data < 0
    return node.data in LIMITED if node.kind is Kind.CALL else node.kind in (Kind.FACTOR, Kind.SOLVE)


def read_when(graph: Graph, outputs: Sequence[Node]) -> Callable[[Node], Node]:
    """Return a function that maps a node to the condition under which the outputs use its value.

    The condition is a node, which is 1 if the value is always used. An argument of `and` is used only if the other
    argument holds. An argument of `or` is used only if the other one does not hold. If the other argument may have no
    value, the argument is always used.
    """
    order = reachable(outputs)
    if not any(node.kind is Kind.CALL and node.data == "piecewise" for node in order):
        return lambda node: graph.one
    domains, conditions = dict[Node, bool](), dict.fromkeys(outputs, graph.one)
    for node in reversed(order):
        for arg, condition in _readings(node, conditions[node], domains):
            conditions[arg] = either(conditions[arg], condition) if arg in conditions else condition
    return conditions.__getitem__


def _readings(node: Node, when: Node, domains: dict[Node, bool]) -> list[tuple[Node, Node]]:
    """Return pairs (argument of a node, condition under which it is used). `when` is the condition of the node.

    `domains` caches for nodes whether they may have no finite value.
    """
    if node.kind is not Kind.CALL or node.data not in ("piecewise", "and", "or"):
        return [(arg, when) for arg in node.args]
    if node.data == "piecewise":
        readings = []
        for condition, value in zip(node.args[:-1:2], node.args[1::2], strict=True):
            readings += [(condition, when), (value, both(when, condition))]
            when = both(when, opposite(condition))
        return [*readings, (node.args[-1], when)]
    readings = []
    for arg, other in (node.args, node.args[::-1]):
        # An argument is used if the other one does not decide the result, and always if the other one may have no
        # value.
        needed = (
            when if may_lack_value(other, domains) else both(when, other if node.data == "and" else opposite(other))
        )
        readings.append((arg, needed))
    return readings


def both(a: Node, b: Node) -> Node:
    """Return the condition "a and b" as a node."""
    always = a.graph.one
    return b if a is always or a is b else a if b is always else a.graph.call("and", a, b)


def either(a: Node, b: Node) -> Node:
    """Return the condition "a or b" as a node."""
    always = a.graph.one
    return always if a is always or b is always else a if a is b else a.graph.call("or", a, b)


def opposite(condition: Node) -> Node:
    """Return the negation of a condition as a node."""
    return condition.graph.call("not", condition)


def one_elsewhere(node: Node, condition: Node) -> Node:
    """Return a node that equals `node` if the condition holds, and else the constant 1.

    So the result is finite and not zero where the condition does not hold, and no event is found there.
    """
    graph = node.graph
    return node if condition is graph.one else graph.piecewise([(condition, node)], graph.one)


@lru_cache(maxsize=64)
def square_roots(graph: Graph, nodes: tuple[Node, ...]) -> Mapping[Node, Node]:
    """Return {sqrt(base): power} for the bases of the fractional powers on which the nodes depend.

    A Taylor series is not valid beyond a zero of such a root. `power` is the power of the base with the least magnitude
    of its exponent. A root has the value 1 where the nodes do not use it. Powers of positions with exponents of at most
    -1 are left out. The result is cached, since many runs have the same events.
    """
    powers = [node for node in reachable(nodes) if node.kind is Kind.POWER and node.binding > Binding.PARAMETER]
    bases: dict[Node, Node] = {}
    least: dict[Node, Node] = {}
    read = read_when(graph, nodes)
    for node in powers:
        broken = isinstance(node.data, Fraction) and node.data.denominator > 1
        if broken and (node.data > -1 or node.binding >= Binding.VELOCITY):
            base, when = node.args[0], read(node)
            bases[base] = either(bases[base], when) if base in bases else when
            least[base] = min(least.get(base, node), node, key=lambda power: abs(power.data))
    return {one_elsewhere(graph.power(base, Fraction(1, 2)), when): least[base] for base, when in bases.items()}
