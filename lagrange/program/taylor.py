"""The series program of a system: from its equations, in the form that costs least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
    mass = [equations.mass[i][j] for i, j in equations.plan.triangle]
    n, count = len(equations.q), len(watched)
    switched = switch(equations.graph, (*equations.momenta, *equations.forces, *mass), watched)
    p, f = switched.outputs[:n], switched.outputs[n : 2 * n]
    end = len(switched.outputs) - count
    triangles, seen = switched.outputs[2 * n : end], (*switched.surfaces, *switched.outputs[end:])
    best = min(assemblies(equations, switched, p, f, triangles, seen), key=lambda assembly: assembly.cost)
    return best.program("series"), switched


def assemblies(
    e: Equations,
    switched: Switched,
    p: Sequence[Node],
    f: Sequence[Node],
    triangles: Sequence[Node],
    seen: Sequence[Node],
) -> list[_Assembly]:
    """Return every form of the equations worth comparing."""
    if _constant(triangles):
        # Of p only M v is solved for: the rest of it, of a potential that depends on velocities, is a force, and no
        # form may count on p.
        f, p = bias_forces(f, p, e.q, e.rate, e.time), [e.graph.zero] * len(p)
    return [
        _Assembly(e, form, triangles, seen, switched, apart=apart)
        for form in forms(p, f, e.q, e.rate, e.time)
        for apart in (False, True)
    ]


class _Assembly:
    """One form of the equations as values with rules."""

    def __init__(
        self,
        equations: Equations,
        form: Form,
        triangles: Sequence[Node],
        watched: Sequence[Node],
        switched: Switched,
        *,
        apart: bool,
    ) -> None:
        self.equations = equations
        self.triangles, self.switched = triangles, switched
        self.plan = replace(equations.plan, moving=not _constant(triangles))
        graph = equations.graph
        forces = [node for terms in form.forces for _, node in terms]
        inertia = form.nodes if self.plan.moving else forces
        nodes = [*inertia, *watched]
        self.builder = RecurrenceBuilder(
            graph, equations.q, equations.v, equations.time, nodes, rate=equations.rate, apart=apart
        )
        self.builder.starts.update(switched.starts)
        self.parts = form.parts
        self.known: dict[Node, int | None] = {}
        self.momenta = [self.momentum(node) if self.plan.moving else None for node in form.momenta]
        self.forces = [self.force(terms) for terms in form.forces]
        self.seen = tuple(watched)
        self.watched = [self.builder.value(node) for node in watched]
        self.rates = tuple(self.builder.value(rate) for rate in equations.rate)

    def momentum(self, node: Node) -> int | None:
        """Return the value of a momentum, up to a constant; those inside it come first."""
        todo = [node]
        while todo:
            inner = [other for _, _, other in self.parts[todo[-1]].inner if other not in self.known]
            if inner:
                todo += inner
            else:
                ready = todo.pop()
                self.known[ready] = self.combined(self.parts[ready])
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
            stages=(Stage(tuple(range(n, 2 * n)), tuple(self.momenta), tuple(self.forces), self.plan),),
            watched=tuple(self.watched),
            values=lower(f"{name}_values", {"values": self.seen or (e.graph.zero,)}, e.state, e.time, symbols),
        )


def _constant(triangles: Sequence[Node]) -> bool:
    return all(entry.binding <= Binding.PARAMETER for entry in triangles)
