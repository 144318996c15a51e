"""Differentiate nodes of the graph: gradients by the reverse mode, derivatives along a direction by the forward mode.

Both modes use the same local rules, `PARTIALS`. A choice (piecewise, min, max) is differentiated branch by branch, and
the branch is selected last. Otherwise a zero from the branch that is not chosen would be multiplied by infinities of
this branch. For the same reason a choice is not multiplied by a factor that may be infinite. Instead each branch that
is not zero is multiplied. So the derivative of sqrt(max(x, 0)) is 0 for x < 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from lagrange.graph.branches import may_lack_value
from lagrange.graph.node import Graph, Kind, Node, exact, reachable
from lagrange.statement.vocabulary.functions import FUNCTIONS

Partial = tuple[int, Node]  # Index of an argument, and the partial derivative of the node by this argument


PARTIALS: dict[Kind, Callable[[Node], list[Partial]]] = {
    Kind.SUM: lambda node: [(i, node.graph.constant(c)) for i, c in enumerate(node.data[1])],
    Kind.PRODUCT: lambda node: [
        (i, node.graph.product(node.args[:i] + node.args[i + 1 :])) for i in range(len(node.args))
    ],
    Kind.POWER: lambda node: [
        (0, node.graph.sum(((node.data, node.graph.power(node.args[0], exact(node.data - 1))),)))
    ],
    Kind.CALL: lambda node: [(i, rule(node, *node.args)) for i, rule in enumerate(FUNCTIONS[node.data].partials)],
}
"""Functions, by kind of node, that return pairs (index of an argument, partial derivative of the node by it)."""


def gradient(output: Node, symbols: Sequence[Node]) -> list[Node]:
    """Return the derivatives of `output` by each of the symbols, computed in one reverse sweep."""
    graph = output.graph
    mask = _mask(symbols)
    order = reachable([output], mask)
    inner: dict[Node, dict[Node, Node]] = {}
    for node in order:
        if _is_choice(node):
            inner[node] = _choice_gradient(node, symbols, inner)
    table = _sweep(graph, output, order, mask, inner)
    return [table.get(symbol, graph.zero) for symbol in symbols]


def tangents(outputs: Iterable[Node], direction: Mapping[Node, Node]) -> Callable[[Node], Node]:
    """Return a function from each of `outputs` to its derivative along `direction`, {symbol: component}."""
    outputs = list(outputs)
    table: dict[Node, Node] = dict(direction)
    domains = dict[Node, bool]()
    for node in reachable(outputs, _mask(direction)):
        if node not in table and node.kind is not Kind.SYMBOL:
            _push(node, table, domains)
    return lambda node: table.get(node, node.graph.zero)


def _push(node: Node, tangents: dict[Node, Node], domains: dict[Node, bool]) -> None:
    """Add the derivative of a node along a direction to `tangents`, {node: derivative}.

    The derivatives of its arguments are already in `tangents`. An argument without an entry has the derivative zero.
    For an unknown of a linear solve, the derivatives of all unknowns of this solve are added. `domains` maps nodes to
    True if they may have no finite value. A choice (piecewise, min, max) is multiplied by such a node branch by branch.
    """
    graph = node.graph
    if node.kind is Kind.COMPONENT:
        _push_component(node, tangents)
    elif _is_choice(node):
        tangents[node] = _branchwise(node, [tangents.get(value, graph.zero) for value in _values(node)])
    elif node.kind is Kind.SUM:
        coefficients = node.data[1]
        tangents[node] = graph.sum(
            [(c, tangents[a]) for c, a in zip(coefficients, node.args, strict=True) if a in tangents]
        )
    elif node.kind in PARTIALS:
        moving = [
            (tangents[node.args[i]], partial) for i, partial in PARTIALS[node.kind](node) if node.args[i] in tangents
        ]
        tangents[node] = graph.sum([(1, _chosen(tangent, partial, domains)) for tangent, partial in moving])


def _push_component(node: Node, tangents: dict[Node, Node]) -> None:
    """Add the derivatives dx of the solution x of M x = b to `tangents`. `node` is one of the unknowns.

    The derivatives solve M dx = db - dM x, with the same factors of M.
    """
    graph, solution = node.graph, node.args[0]
    factor, right = solution.args[0], solution.args[1:]
    n = solution.data
    x = graph.components(solution)
    moved = []
    for i in range(n):
        terms = [(1, tangents.get(right[i], graph.zero))]
        for j in range(n):
            entry = factor.args[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)]
            if entry in tangents:
                terms.append((-1, graph.product((tangents[entry], x[j]))))
        moved.append(graph.sum(terms))
    for unknown, tangent in zip(x, graph.solve_with(factor, moved), strict=True):
        tangents[unknown] = tangent


def _sweep(
    graph: Graph, output: Node, order: list[Node], mask: int, gradients_of_choices: Mapping[Node, Mapping[Node, Node]]
) -> dict[Node, Node]:
    """Return {symbol: derivative of `output`} for the symbols whose bits `mask` has, computed in one reverse sweep.

    `order` has the nodes on which `output` depends, arguments first. `gradients_of_choices` has the gradient of each
    choice (piecewise, min, max), {symbol: derivative}.
    """
    incoming: dict[Node, list[tuple[int, Node]]] = {output: [(1, graph.one)]}
    adjoints: dict[Node, Node] = {}
    domains = dict[Node, bool]()
    for node in reversed(order):
        if node not in incoming:
            continue
        adjoint = graph.sum(incoming.pop(node))
        if node.kind is Kind.SYMBOL:
            adjoints[node] = adjoint
        elif node in gradients_of_choices:
            for symbol, partial in gradients_of_choices[node].items():
                incoming.setdefault(symbol, []).append((1, _chosen(partial, adjoint, domains)))
        elif node.kind is Kind.SUM:
            for coefficient, arg in zip(node.data[1], node.args, strict=True):
                if arg.depends & mask:
                    incoming.setdefault(arg, []).append((coefficient, adjoint))
        else:
            for i, partial in PARTIALS[node.kind](node):
                if node.args[i].depends & mask:
                    incoming.setdefault(node.args[i], []).append((1, graph.product((adjoint, partial))))
    return adjoints


def _choice_gradient(
    node: Node, symbols: Sequence[Node], inner: Mapping[Node, Mapping[Node, Node]]
) -> dict[Node, Node]:
    graph, mask = node.graph, _mask(symbols)
    branches = [_sweep(graph, value, reachable([value], mask), mask, inner) for value in _values(node)]
    partials: dict[Node, Node] = {}
    for symbol in symbols:
        chosen = _branchwise(node, [branch.get(symbol, graph.zero) for branch in branches])
        if chosen is not graph.zero:
            partials[symbol] = chosen
    return partials


def _branchwise(node: Node, derivatives: list[Node]) -> Node:
    """Return the derivative of a choice (piecewise, min, max) from the `derivatives` of its branches.

    Where no condition of a piecewise node holds, its derivative is NaN as well.
    """
    last = node.args[-1]
    undefined = last.kind is Kind.CALL and last.data == "nan"
    otherwise = last if undefined else derivatives[-1]
    return node.graph.piecewise(list(zip(_conditions(node), derivatives, strict=False)), otherwise)


def _chosen(derivative: Node, factor: Node, domains: dict[Node, bool]) -> Node:
    """Return derivative * factor. A factor that may be infinite multiplies only the nonzero branches of a choice.

    `domains` caches for nodes whether they may have no finite value.
    """
    graph = derivative.graph
    choice = derivative.kind is Kind.CALL and derivative.data == "piecewise" and graph.zero in derivative.args
    if not choice or not may_lack_value(factor, domains):
        return graph.product((derivative, factor))
    values = [_chosen(value, factor, domains) for value in _values(derivative)]
    return graph.piecewise(list(zip(_conditions(derivative), values, strict=False)), values[-1])


def _is_choice(node: Node) -> bool:
    return node.kind is Kind.CALL and (node.data == "piecewise" or FUNCTIONS[node.data].first is not None)


def _conditions(node: Node) -> list[Node]:
    first = FUNCTIONS[node.data].first
    return list(node.args[:-1:2]) if first is None else [first(*node.args)]


def _values(node: Node) -> list[Node]:
    return [*node.args[1::2], node.args[-1]] if FUNCTIONS[node.data].first is None else list(node.args)


def _mask(symbols: Iterable[Node]) -> int:
    mask = 0
    for symbol in symbols:
        mask |= symbol.depends
    return mask
