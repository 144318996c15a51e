"""The series program of a system: from its equations, in the form that costs least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import NamedTuple

from lagrange.equations.euler_lagrange import Equations, bias_forces
from lagrange.graph.node import Binding, Exact, Kind, Node
from lagrange.program.forms import Form, LinearTerms, Momentum, forms
from lagrange.program.lower import lower
from lagrange.program.recurrence import RecurrenceBuilder, known_node
from lagrange.program.series import (
    SeriesProgram,
    SeriesRule,
    Stage,
    convolutions,
    integrated,
    kept_values,
    lagged_values,
)
from lagrange.program.switching import Switched, switch


def series_program(equations: Equations, watched: Sequence[Node] = ()) -> tuple[SeriesProgram, Switched]:
    """Return the series of a system and its switching surfaces.

    The values watched are the surfaces, then the nodes given (of events).
    """
    switched = switched_equations(equations, watched)
    best = min(assemblies(equations, switched), key=lambda assembly: assembly.cost)
    return best.program("series"), switched


def switched_equations(equations: Equations, watched: Sequence[Node] = ()) -> Switched:
    """Return what a series is made of, with one branch of every choice: its outputs are those that `_Parts` names."""
    e, held = equations, equations.constraints
    gradient = [entry for row in held.gradient for entry in row]
    matrix = [e.matrix[i][j] for i, j in e.plan.triangle]
    return switch(e.graph, (*e.momenta, *e.forces, *held.velocities, *gradient, *matrix), watched)


class _Parts(NamedTuple):
    """The momenta, forces, constraints on velocities and their gradients G, the system matrix, and what is watched."""

    momenta: Sequence[Node]
    forces: Sequence[Node]
    velocities: Sequence[Node]
    gradient: Sequence[Node]
    triangle: Sequence[Node]
    watched: Sequence[Node]

    @classmethod
    def of(cls, e: Equations, switched: Switched) -> _Parts:
        """Divide the outputs."""
        n, m = len(e.q), len(e.constraints)
        ends = accumulate((0, n, n, m, m * n, len(e.plan.triangle), len(switched.outputs)))
        p, f, psi, gradient, triangle, rest = (switched.outputs[begin:end] for begin, end in pairwise(ends))
        return cls(p, f, psi, gradient, triangle, (*switched.surfaces, *rest))


def assemblies(e: Equations, switched: Switched) -> list[_Assembly]:
    """Return every form of the equations worth comparing."""
    parts = _Parts.of(e, switched)
    p, f = list(parts.momenta), list(parts.forces)
    n = len(e.q)
    steady = _constant([entry for (i, _), entry in zip(e.plan.triangle, parts.triangle, strict=True) if i < n])
    if steady:
        # Of p only M v is solved for: the rest of it, of a potential that depends on velocities, is a force, and no
        # form may count on p.
        f, p = bias_forces(f, p, e.q, e.rate, e.time), [e.graph.zero] * len(p)
    return [
        _Assembly(e, form, parts, switched, steady=steady, apart=apart)
        for form in forms(p, f, e.q, e.rate, e.time)
        for apart in (False, True)
    ]


class _Assembly:
    """One form of the equations as values with rules."""

    def __init__(
        self,
        equations: Equations,
        form: Form,
        parts: _Parts,
        switched: Switched,
        *,
        steady: bool,
        apart: bool,
    ) -> None:
        self.equations = equations
        self.triangles, self.switched = parts.triangle, switched
        self.plan = replace(equations.plan, moving=not _constant(parts.triangle))
        self.steady = steady
        lower = dict(zip(equations.plan.triangle, parts.triangle, strict=True))
        self.entries = {**lower, **{(j, i): entry for (i, j), entry in lower.items()}}
        graph = equations.graph
        forces = [node for terms in form.forces for _, node in terms]
        inertia = forces if steady else form.nodes
        nodes = [*inertia, *parts.velocities, *parts.gradient, *parts.watched]
        self.builder = RecurrenceBuilder(
            graph, equations.q, equations.v, equations.time, nodes, rate=equations.rate, apart=apart
        )
        self.builder.starts.update(switched.starts)
        self.sums = form.parts
        self.known: dict[Node, int | None] = {}
        self.momenta = [None if steady else self.momentum(node) for node in form.momenta]
        self.forces = [self.force(terms) for terms in form.forces]
        self.constrain(parts.velocities, parts.gradient)
        self.seen = tuple(parts.watched)
        self.watched = [self.builder.value(node) for node in parts.watched]
        self.rates = tuple(self.builder.value(rate) for rate in equations.rate)

    def constrain(self, velocities: Sequence[Node], gradient: Sequence[Node]) -> None:
        """Add the constraints to the solve.

        The unknown of each is the integral of -lambda: G^T times its differential is part of the momenta, and psi = 0.
        """
        b, n, m = self.builder, len(self.equations.q), len(velocities)
        self.impulses = [b.add(SeriesRule("unknown", (), (n + j,)), None) for j in range(m)]
        for i in range(n) if m else ():
            terms = self.inertia(i)
            for j, one in enumerate(self.impulses):
                scale, value = self.impulse(one, gradient[j * n + i])
                terms.append((value, scale))
            terms = [(value, scale) for value, scale in terms if scale is not b.graph.zero]
            values, scales = zip(*terms, strict=True)
            self.momenta[i] = b.add(SeriesRule("linear", values, tuple(map(b.constant, scales))), None)
        self.momenta += [b.value(psi) for psi in velocities]
        self.forces += [None] * m

    def inertia(self, i: int) -> list[tuple[int, Node]]:
        """Return a momentum as values times constants: of a constant mass matrix M v itself."""
        known, b, e = self.momenta[i], self.builder, self.equations
        if known is not None:
            return [(known, b.graph.one)]
        entries = {j: entry for (k, j), entry in self.entries.items() if k == i and j < len(e.q)}
        return [(b.values[e.v[j]], entry) for j, entry in entries.items()] if self.steady else []

    def impulse(self, multiplier: int, entry: Node) -> tuple[Node, int]:
        """Return the integral of an entry of G along that of its multiplier, as a constant times a value."""
        b = self.builder
        if entry.binding <= Binding.PARAMETER:
            return entry, multiplier
        scale, value = b.split(entry)
        return scale, b.add(SeriesRule("along", (multiplier, value), (b.constant(1),)), None)

    def momentum(self, node: Node) -> int | None:
        """Return the value of a momentum, up to a constant; those inside it come first."""
        todo = [node]
        while todo:
            inner = [other for _, _, other in self.sums[todo[-1]].inner if other not in self.known]
            if inner:
                todo += inner
            else:
                ready = todo.pop()
                self.known[ready] = self.combined(self.sums[ready])
        return self.known[node]

    def combined(self, part: Momentum) -> int | None:
        """Return the value of a momentum whose parts have theirs."""
        b, graph = self.builder, self.equations.graph
        args: dict[int, Node] = {}

        def add(value: int, coefficient: Exact, *factors: Node) -> None:
            args[value] = args.get(value, graph.zero) + graph.product((graph.node(coefficient), *factors))

        for coefficient, node in part.terms:
            if node.binding > Binding.PARAMETER:
                scale, value = b.split(node)
                add(value, coefficient, scale)
        for coefficient, c, y in part.swept:
            scale, w = b.split(c)
            factor, a = b.split(y)
            add(b.add(SeriesRule("along", (a, w), (b.constant(1),)), None), coefficient, scale, factor)
        for coefficient, scale, other in part.inner:
            known = self.known[other]
            if known is not None:
                add(known, coefficient, scale)
        if not args:
            return None
        return b.add(SeriesRule("linear", tuple(args), tuple(b.constant(c) for c in args.values())), None, graph.zero)

    def force(self, terms: LinearTerms) -> int | None:
        """Return the value of a force."""
        graph = self.equations.graph
        if not terms:
            return None
        node = graph.sum(terms)
        if len(terms) == 1:
            return self.builder.value(node)
        return self.builder.linear(terms, node)

    @property
    def cost(self) -> tuple[int, int]:
        """What an order costs: its sums over lower orders, then its values."""
        return convolutions(self.builder.rules), len(self.builder.rules)

    def program(self, name: str) -> SeriesProgram:
        """Return the record."""
        e, b = self.equations, self.builder
        outputs = {value for value in (*self.forces, *self.watched) if value is not None}
        needed = kept_values(b.rules) | lagged_values(b.rules) | outputs.union(integrated(b.rules, self.rates))
        started = tuple(sorted(needed)) or (0,)
        table = list(b.constants) or [e.graph.one]
        mass = list(self.triangles)
        symbols = (*e.parameters, *self.switched.sides)
        entries = [e.graph.symbol(f"constant {place}", Binding.PARAMETER) for place in range(len(table))]
        known = [node if node.kind is Kind.CONSTANT else entries[place] for place, node in enumerate(table)]
        n = len(e.q)
        low = [e.graph.symbol(f"low {i}", Binding.CONFIGURATION if i < n else Binding.VELOCITY) for i in range(2 * n)]
        values = b.initial(known, dict(enumerate(low)))
        initial = [known_node(values[value]) for value in started]
        constants: dict[str, Sequence[Node]] = {"table": table}
        first: dict[str, Sequence[Node]] = {"values": initial}
        (first if self.plan.moving else constants)["mass"] = mass
        lost = {"q_lost": low[:n], "v_lost": low[n:]}
        stated = self.switched.stated or (e.graph.zero,)
        return SeriesProgram(
            name=name,
            dimension=len(e.q),
            sides=len(self.switched.sides),
            surfaces=lower(f"{name}_surfaces", {"surfaces": stated}, e.state, e.time, e.parameters),
            constants=lower(f"{name}_constants", constants, e.state, e.time, symbols),
            numbers=tuple(float(c.data) if c.kind is Kind.CONSTANT else None for c in table),
            rules=tuple(b.rules),
            start=lower(f"{name}_start", first, {**e.state, **lost}, e.time, (*symbols, *entries)),
            started=started,
            rates=self.rates,
            stages=(Stage((*range(n, 2 * n), *self.impulses), tuple(self.momenta), tuple(self.forces), self.plan),),
            watched=tuple(self.watched),
            values=lower(f"{name}_values", {"values": self.seen or (e.graph.zero,)}, e.state, e.time, symbols),
        )


def _constant(triangles: Sequence[Node]) -> bool:
    return all(entry.binding <= Binding.PARAMETER for entry in triangles)
