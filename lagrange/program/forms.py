"""The forms in which the equations of motion enter a series, as sums of terms.

The momentum form is dp/dt = f. In d'Alembert's form each term C Y of p, with C free of velocities, is differentiated
by parts: C dY/dt = f - Y dC/dt. Where the Lagrangian is a sum of squares of velocities of points, what is subtracted
cancels against f, and half of the products are gone. Both forms have the same mass matrix, so that one kernel serves
both; the caller builds both and keeps the cheaper.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Exact, Graph, Kind, Node, reachable

Terms = tuple[tuple[Exact, Node], ...]
"""Sum of coefficient * node, kept apart: the graph would take out common factors again."""

MOST_TERMS = 4096
"""A form with more terms in one equation than this is given up: expanding is worth its while for a few only."""


@dataclass(frozen=True, eq=False)
class Form:
    """dp/dt = f with p[i] = `momenta[i]` + the integrals of C dY over the pairs (coefficient, C, Y) of `swept[i]`."""

    momenta: tuple[Terms, ...]
    swept: tuple[tuple[tuple[Exact, Node, Node], ...], ...]
    forces: tuple[Terms, ...]

    @property
    def nodes(self) -> list[Node]:
        """Every node of the form."""
        plain = [node for terms in (*self.momenta, *self.forces) for _, node in terms]
        return plain + [node for pairs in self.swept for _, c, y in pairs for node in (c, y)]


def forms(p: Sequence[Node], f: Sequence[Node], q: Sequence[Node], v: Sequence[Node], time: Node) -> list[Form]:
    """Return the forms worth comparing, the momentum form as it stands first."""
    none: tuple[tuple[tuple[Exact, Node, Node], ...], ...] = ((),) * len(p)
    whole = Form(tuple(((1, node),) for node in p), none, tuple(((1, node),) for node in f))
    once = _used_once([*p, *f])
    momenta, forces = [], []
    for momentum, force in zip(p, f, strict=True):
        expansions = _expanded(momentum, once), _expanded(force, once)
        if expansions[0] is None or expansions[1] is None:
            return [whole]
        momenta.append(expansions[0])
        forces.append(expansions[1])
    graph = time.graph
    expanded = Form(tuple(_terms(graph, e) for e in momenta), none, tuple(_terms(graph, e) for e in forces))
    parts = _by_parts(momenta, forces, q, v, time)
    return [whole, expanded] + ([] if parts is None else [parts])


Expansion = dict[tuple[Node, ...], Exact]
"""Coefficients by the factors of a term, sorted."""


def _used_once(outputs: Sequence[Node]) -> frozenset[Node]:
    uses: Counter[Node] = Counter(outputs)
    for node in reachable(outputs):
        uses.update(node.args)
    return frozenset(node for node, count in uses.items() if count == 1)


def _expanded(node: Node, once: frozenset[Node]) -> Expansion | None:
    """Return a node as a sum of products; sums that others use as well stay whole. None if there are too many terms."""
    found: Expansion = {}
    stack: list[tuple[Exact, tuple[Node, ...], tuple[Node, ...]]] = [(1, (), (node,))]
    while stack:
        coefficient, done, todo = stack.pop()
        if not todo:
            key = tuple(sorted(done, key=lambda factor: factor.id))
            found[key] = found.get(key, 0) + coefficient
            if len(found) > MOST_TERMS:
                return None
            continue
        first, rest = todo[0], todo[1:]
        if first.kind is Kind.CONSTANT:
            stack.append((coefficient * first.data, done, rest))
        elif first.kind is Kind.PRODUCT:
            stack.append((coefficient, done, (*first.args, *rest)))
        elif first.kind is Kind.SUM and (first in once or first is node or _is_scaled(first) or _is_rate(first)):
            constant, scales = first.data
            if constant:
                stack.append((coefficient * constant, done, rest))
            stack += [(coefficient * c, done, (arg, *rest)) for c, arg in zip(scales, first.args, strict=True)]
        else:
            stack.append((coefficient, (*done, first), rest))
    return {key: c for key, c in found.items() if c}


def _is_scaled(node: Node) -> bool:
    return len(node.args) == 1 and not node.data[0]


def _is_rate(node: Node) -> bool:
    """Whether a sum is one of velocities themselves, as the rate of an angle between two links."""
    return all(arg.kind is Kind.SYMBOL and arg.binding is Binding.VELOCITY for arg in node.args)


def _terms(graph: Graph, expansion: Expansion) -> Terms:
    return tuple((c, graph.product(factors)) for factors, c in expansion.items() if c)


def _by_parts(
    momenta: Sequence[Expansion],
    forces: Sequence[Expansion],
    q: Sequence[Node],
    v: Sequence[Node],
    time: Node,
) -> Form | None:
    """Return d'Alembert's form, or None where it would have too many terms."""
    graph = time.graph
    along = {**dict(zip(q, v, strict=True)), time: graph.one}
    plain, swept, rest = [], [], []
    for momentum, force in zip(momenta, forces, strict=True):
        kept: list[tuple[Exact, Node]] = []
        pairs: list[tuple[Exact, Node, Node]] = []
        left = dict(force)
        for factors, coefficient in momentum.items():
            still = [a for a in factors if Binding.PARAMETER < a.binding < Binding.VELOCITY]
            moving = [a for a in factors if a.binding >= Binding.VELOCITY]
            if not still or not moving:
                kept.append((coefficient, graph.product(factors)))
                continue
            constant = [a for a in factors if a.binding <= Binding.PARAMETER]
            c, y = graph.product([*constant, *still]), graph.product(moving)
            pairs.append((coefficient, c, y))
            removed = _expanded(graph.product((tangents([c], along)(c), y)), frozenset())
            if removed is None:
                return None
            for key, value in removed.items():
                left[key] = left.get(key, 0) - coefficient * value
        plain.append(tuple(kept))
        swept.append(tuple(pairs))
        rest.append(_terms(graph, left))
    return Form(tuple(plain), tuple(swept), tuple(rest))
