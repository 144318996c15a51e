"""Two ways to write the equations of motion for a Taylor series, as sums of terms: momentum form, d'Alembert's form.

The momentum form is dp/dt = f. In d'Alembert's form each term C Y of p, with C free of velocities, is differentiated by
parts: C dY/dt = f - Y dC/dt. If the Lagrangian is a sum of squares of velocities of points, Y dC/dt cancels against
terms of f, and half of the products disappear. Both forms have the same mass matrix, so that one kernel serves both.
The caller builds both and keeps the cheaper one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from heapq import heapify, heappop, heappush

from lagrange.graph.differentiate import tangents
from lagrange.graph.node import LONGEST_FLAT, Binding, Exact, Graph, Kind, Node, exact, reachable

LinearTerms = tuple[tuple[Exact, Node], ...]
"""Sum of coefficient * node, as a list. As a node of the graph, its common factors would be collected again."""

MOST_TERMS = 4096
"""Largest number of terms in one equation of a form. Expansion saves operations only for few terms. The scenes, and
chains of 30 links, have at most 7. A mass that is a product of 12 sums has 4096 terms, which take 0.03 s for each
momentum and save nothing.
"""


@dataclass(frozen=True)
class Momentum:
    """A momentum, up to a constant, as a sum of three parts: products, integrals along the motion, other momenta.

    `terms` are (number, node) for each product. `swept` has (c, C, Y) for each integral of c C dY, with a number c and
    nodes C and Y. `inner` has (c, s, node) for each term c * s * p, where p is another momentum, given by its `node`; c
    is a number, and the node s is constant in time.
    """

    terms: LinearTerms = ()
    swept: tuple[tuple[Exact, Node, Node], ...] = ()
    inner: tuple[tuple[Exact, Node, Node], ...] = ()


@dataclass(frozen=True, eq=False)
class Form:
    """Equations of motion dp/dt = f, with momenta and forces as sums of terms.

    `momenta` and `forces` are in the order of the coordinates. `parts` maps the node of each momentum to its parts.
    """

    momenta: tuple[Node, ...]
    parts: Mapping[Node, Momentum]
    forces: tuple[LinearTerms, ...]

    @property
    def nodes(self) -> list[Node]:
        """All nodes in the terms of the forces and of the momenta, without the nodes of the momenta themselves."""
        nodes = [node for terms in self.forces for _, node in terms]
        for part in self.parts.values():
            nodes += [node for _, node in part.terms]
            nodes += [node for _, c, y in part.swept for node in (c, y)]
        return nodes


def forms(p: Sequence[Node], f: Sequence[Node], q: Sequence[Node], v: Sequence[Node], time: Node) -> list[Form]:
    """Return the forms of the equations of motion dp/dt = f, one of which the caller chooses by their costs.

    `p` are the momenta, `f` the forces, q the coordinates and v their rates. The first form has `p` and `f`
    unchanged. The others are the expanded sums and d'Alembert's form, if these do not have too many terms.
    """
    graph = time.graph
    whole = Form(tuple(p), {node: Momentum(((1, node),)) for node in p}, tuple(((1, node),) for node in f))
    whole_sums = _used_again([*p, *f])
    momenta, forces = {}, []
    for momentum, force in zip(p, f, strict=True):
        expansions = _expanded(momentum, whole_sums), _expanded(force, whole_sums)
        if expansions[0] is None or expansions[1] is None:
            return [whole]
        momenta[momentum] = Momentum(_terms(graph, expansions[0]))
        forces.append(expansions[1])
    expanded = Form(tuple(p), momenta, tuple(_terms(graph, e) for e in forces))
    parts = _ByParts(p, f, forces, whole_sums, {**dict(zip(q, v, strict=True)), **graph.rates}).form()
    return [whole, expanded] + ([] if parts is None else [parts])


Expansion = dict[tuple[Node, ...], Exact]
"""A sum as a table: the coefficient of each term, by the sorted factors of the term."""

_Term = tuple[tuple[Node, ...], Exact]


def _used_again(outputs: Sequence[Node]) -> frozenset[Node]:
    """Return the nodes that stay single factors when the outputs are expanded to sums of products.

    Such a node has several readers. A product must also be an output.
    """
    uses: Counter[Node] = Counter(outputs)
    for node in reachable(outputs):
        uses.update(node.args)
    again = {node for node, count in uses.items() if count > 1}
    themselves = frozenset(outputs)
    return frozenset(node for node in again if node.kind is not Kind.PRODUCT or node in themselves)


def _expanded(node: Node, unexpanded: Collection[Node]) -> Expansion | None:
    """Return a node as an expanded sum of products, or None if it has too many terms.

    Nodes in `unexpanded` are not expanded.
    """
    expansion: Expansion = {}
    root = node
    while root.kind is Kind.SUM and _is_scaled(root):
        root = root.args[0]
    stack: list[tuple[Exact, tuple[Node, ...], tuple[Node, ...]]] = [(1, (), (node,))]
    while stack:
        coefficient, done, todo = stack.pop()
        if not todo:
            key = tuple(sorted(done, key=lambda factor: factor.id))
            expansion[key] = expansion.get(key, 0) + coefficient
            if len(expansion) > MOST_TERMS:
                return None
            continue
        first, rest = todo[0], todo[1:]
        opens = first is root or first not in unexpanded
        if first.kind is Kind.CONSTANT:
            stack.append((coefficient * first.data, done, rest))
        elif first.kind is Kind.PRODUCT and (done or rest) and len(first.args) > LONGEST_FLAT:
            # A long product inside a product is not expanded: many terms may share it.
            stack.append((coefficient, (*done, first), rest))
        elif first.kind is Kind.PRODUCT and (opens or not first.binding >= Binding.VELOCITY):
            stack.append((coefficient, done, (*first.args, *rest)))
        elif first.kind is Kind.SUM and (opens or _is_scaled(first)):
            constant, scales = first.data
            if constant:
                stack.append((coefficient * constant, done, rest))
            stack += [(coefficient * c, done, (arg, *rest)) for c, arg in zip(scales, first.args, strict=True)]
        else:
            stack.append((coefficient, (*done, first), rest))
    return {key: c for key, c in expansion.items() if c}


def _is_scaled(node: Node) -> bool:
    return len(node.args) == 1 and not node.data[0]


def _terms(graph: Graph, expansion: Expansion) -> LinearTerms:
    return tuple((c, graph.product(factors)) for factors, c in expansion.items() if c)


class _ByParts:
    """Builds d'Alembert's form of dp/dt = f: C dY/dt = f - Y dC/dt for the terms C Y of a momentum.

    `slopes` has for each momentum its slope, the expanded sum of Y dC/dt over its terms C Y. A momentum may contain
    other momenta, as in a chain with relative angles. Its slope and its force then contain the slopes and forces of
    the other coordinates. Therefore the remaining force of one coordinate replaces its force and slope in all later
    coordinates.
    """

    def __init__(
        self,
        p: Sequence[Node],
        f: Sequence[Node],
        forces: Sequence[Expansion],
        whole: frozenset[Node],
        along: Mapping[Node, Node],
    ) -> None:
        self.graph = p[0].graph
        self.p, self.f, self.forces, self.along = p, f, forces, along
        self.whole = set(whole)
        self.parts: dict[Node, Momentum] = {}
        self.slopes: dict[Node, Node] = {}

    def form(self) -> Form | None:
        """Return d'Alembert's form of the equations, or None if an expanded sum has more than `MOST_TERMS` terms."""
        graph = self.graph
        for momentum in sorted(self.p, key=lambda node: node.id):
            if not self.split(momentum):
                return None
        left: dict[int, Expansion] = {}
        finished = _FinishedCoordinates()
        for i in sorted(range(len(self.p)), key=lambda i: self.p[i].id):
            slope = _expanded(self.slopes[self.p[i]], self.whole)
            if slope is None:
                return None
            rest = dict(self.forces[i])
            for key, value in slope.items():
                rest[key] = rest.get(key, 0) - value
            left[i] = {key: value for key, value in finished.joined(rest).items() if value}
            finished.add(_term(self.f[i]), _term(self.slopes[self.p[i]]), graph.sum(_terms(graph, left[i])))
        return Form(tuple(self.p), self.parts, tuple(_terms(graph, left[i]) for i in range(len(self.p))))

    def split(self, momentum: Node) -> bool:
        """Store the terms of a `momentum` and its slope, the sum of Y dC/dt over its terms C Y.

        C is free of velocities. Return False, with nothing stored, if there are too many terms.
        """
        graph = self.graph
        expansion = _expanded(momentum, self.whole)
        if expansion is None:
            return False
        kept: list[tuple[Exact, Node]] = []
        swept: list[tuple[Exact, Node, Node]] = []
        inner: list[tuple[Exact, Node, Node]] = []
        slope: list[tuple[Exact, Node]] = []
        for factors, coefficient in expansion.items():
            constant = [a for a in factors if a.binding <= Binding.PARAMETER]
            still = [a for a in factors if Binding.PARAMETER < a.binding < Binding.VELOCITY]
            moving = [a for a in factors if a.binding >= Binding.VELOCITY]
            if still and moving:
                c, y = graph.product([*constant, *still]), graph.product(moving)
                swept.append((coefficient, c, y))
                slope.append((coefficient, graph.product((tangents([c], self.along)(c), y))))
            elif len(moving) == 1 and moving[0] in self.parts:
                scale = graph.product(constant)
                inner.append((coefficient, scale, moving[0]))
                slope.append((coefficient, graph.product((scale, self.slopes[moving[0]]))))
            else:
                kept.append((coefficient, graph.product(factors)))
        self.parts[momentum] = Momentum(tuple(kept), tuple(swept), tuple(inner))
        self.slopes[momentum] = graph.sum(slope)
        self.whole.add(self.slopes[momentum])
        return True


def _term(node: Node) -> _Term:
    """Return a node as one term, without expanding it: its factors and its coefficient."""
    coefficient: Exact = 1
    while node.kind is Kind.SUM and _is_scaled(node):
        coefficient, node = coefficient * node.data[1][0], node.args[0]
    return (node,), coefficient


class _FinishedCoordinates:
    """Coordinates whose equations are already in d'Alembert's form: C dY/dt = f - Y dC/dt for terms C Y of momenta.

    For each coordinate these are stored: its force f, its slope (the sum of Y dC/dt), and the node of f minus the
    slope.
    """

    def __init__(self) -> None:
        self._forces: list[tuple[_Term, _Term, Node]] = []
        self._places: dict[tuple[Node, ...], list[int]] = {}

    def add(self, force: _Term, slope: _Term, rest: Node) -> None:
        """Store a coordinate: its force f, its slope (see the class), and the node `rest` of f minus the slope."""
        self._places.setdefault(force[0], []).append(len(self._forces))
        self._forces.append((force, slope, rest))

    def joined(self, terms: Expansion) -> Expansion:
        """Return `terms` in which the node of f minus the slope replaces f and the slope of finished coordinates.

        f is the force of a coordinate. Its slope is the sum of Y dC/dt over the terms C Y of its momentum.
        """
        result = dict(terms)
        todo = [index for key in result for index in self._places.get(key, ())]
        heapify(todo)
        while todo:
            index = heappop(todo)
            (force, scale), (slope, slope_scale), rest = self._forces[index]
            share = Fraction(result.get(force, 0)) / scale if scale else Fraction(0)
            if share and Fraction(result.get(slope, 0)) == -share * slope_scale:
                del result[force], result[slope]
                result[(rest,)] = exact(result.get((rest,), 0) + share)
                for later in self._places.get((rest,), ()):
                    if later > index:
                        heappush(todo, later)
        return result
