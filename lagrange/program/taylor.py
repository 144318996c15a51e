"""Series program of a system, for Taylor methods: its equations of motion in the form with the least cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from lagrange.equations.euler_lagrange import Equations, MotionForm, bias_forces, mass_matrix
from lagrange.equations.solve_plan import SolvePlan, plan_of
from lagrange.graph.node import Binding, Exact, Kind, Node, reachable, substitute
from lagrange.program.catalogue import projection
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
from lagrange.program.series_forms import Form, LinearTerms, Momentum, forms
from lagrange.program.switching import Switched, switch


def series_program(equations: Equations, watched: Sequence[Node] = ()) -> tuple[SeriesProgram, Switched]:
    """Return the series program of a system, and its switching surfaces.

    The watched values are the surfaces, followed by the nodes `watched` (of events).
    """
    plain, chosen = replace(equations, turning=None), in_rates(equations)
    if solved_within(watched) or (chosen.turning is not None and not chosen.turning.adjacent):
        chosen = plain
    parts, switched = switched_equations(chosen, watched)
    if chosen.turning is not None and any(map(chosen.turning.has, switched.stated)):
        chosen = plain
        parts, switched = switched_equations(plain, watched)
    best = min(assemblies(chosen, parts, switched), key=lambda assembly: assembly.cost)
    return best.program("series"), switched


def in_rates(e: Equations) -> Equations:
    """Return the equations with angular rates of bodies as velocities; unchanged for a system without them."""
    if e.turning is None:
        return e
    mass = mass_matrix(e.turning.momenta, e.turning.velocities)
    motion = MotionForm(e.turning.momenta, e.turning.forces, ())
    return replace(e, motion=motion, matrix=mass, plan=plan_of(mass))


Parts = Mapping[str, Sequence[Node]]
"""The nodes from which a series is built, in blocks: the rates dq/dt, momenta, forces, constraints on velocities, G by
rows, and the triangle of the system matrix. The block `right` is the right-hand side of the equations of motion if the
watched nodes contain accelerations or multipliers, else empty. `watched` are the switching surfaces, then the watched
nodes.
"""


def switched_equations(equations: Equations, watched: Sequence[Node] = ()) -> tuple[Parts, Switched]:
    """Return the nodes of the equations of motion and the `watched` nodes, with smooth expressions for switches.

    In the watched nodes, symbols replace accelerations and multipliers that a linear system determines.
    """
    e, held = equations, equations.constraints
    right = [*e.motion.bias, *(-gamma for gamma in held.bias)] if solved_within(watched) else []
    unknown = zip(e.solution, motion_symbols(e), strict=True) if right else ()
    seen = substitute(watched, {node: symbol for node, symbol in unknown if node.kind is Kind.COMPONENT})
    stated = {
        "rates": e.rate,
        "momenta": e.motion.momenta,
        "forces": e.motion.forces,
        "velocities": held.velocities,
        "gradient": [entry for row in held.gradient for entry in row],
        "triangle": [e.matrix[i][j] for i, j in e.plan.triangle],
        "right": right,
    }
    # A constraint phi(q) may jump where dphi/dt does not. So the switching surfaces of phi are included.
    positions = [phi for phi in held.positions if phi is not None]
    switched = switch(e.graph, [*(node for block in stated.values() for node in block), *positions, *seen])
    smooth = {name: [switched.smooth[node] for node in block] for name, block in stated.items()}
    return {**smooth, "watched": [*switched.surfaces, *(switched.smooth[node] for node in seen)]}, switched


def solved_within(watched: Sequence[Node]) -> bool:
    """Return True if the watched nodes contain accelerations or multipliers that a linear system determines."""
    return any(node.kind is Kind.COMPONENT for node in reachable(watched))


def motion_symbols(e: Equations) -> list[Node]:
    """Return a symbol for each unknown of the equations of motion: the accelerations, then -lambda."""
    return [e.graph.symbol(f"motion {i}", Binding.ACCELERATION) for i in range(len(e.matrix))]


def assemblies(e: Equations, parts: Parts, switched: Switched) -> list[_Assembly]:
    """Return the builders of the series, two for each form of the equations. The caller chooses the cheapest.

    In one of the two the factors a' - b' in rates of sin(a - b) are multiplied out. `parts` and `switched` are the
    equations without switches.
    """
    p, f = list(parts["momenta"]), list(parts["forces"])
    n = len(p)
    derivatives = dict(zip(e.q, parts["rates"], strict=True)) if e.turning is None else e.turning.derivatives
    q, rate = list(derivatives), list(derivatives.values())
    steady = _is_constant([entry for (i, _), entry in zip(e.plan.triangle, parts["triangle"], strict=True) if i < n])
    if steady:
        # Only the part M v of p is solved for. The rest, from a potential that depends on velocities, is a force; no
        # form may assume p.
        f, p = bias_forces(f, p, q, rate, e.time), [e.graph.zero] * len(p)
    return [
        _Assembly(e, form, parts, switched, steady=steady, termwise=termwise)
        for form in forms(p, f, q, rate, e.time)
        for termwise in (False, True)
    ]


class _Assembly:
    """Builds the series of one form of the equations of motion: its values and their rules."""

    def __init__(
        self, equations: Equations, form: Form, parts: Parts, switched: Switched, *, steady: bool, termwise: bool
    ) -> None:
        self.equations = equations
        self.triangles, self.switched = parts["triangle"], switched
        self.plan = replace(equations.plan, moving=not _is_constant(parts["triangle"]))
        self.steady = steady
        lower = dict(zip(equations.plan.triangle, parts["triangle"], strict=True))
        self.entries = {**lower, **{(j, i): entry for (i, j), entry in lower.items()}}
        graph, m, turning = equations.graph, len(equations.constraints), equations.turning
        velocities = equations.v if turning is None else turning.velocities
        n, spun = len(equations.q), {} if turning is None else turning.spun
        forces = [node for terms in form.forces for _, node in terms]
        inertia = forces if steady else form.nodes
        self.motion = motion_symbols(equations) if parts["right"] else []
        balance = self.balance(parts["right"])
        nodes = [
            *inertia,
            *parts["velocities"],
            *parts["gradient"],
            *balance,
            *parts["watched"],
            *parts["rates"],
            *(rate for rate, _, _ in spun.values()),
        ]
        solved_for = [*(v for v in velocities if v not in equations.v), *self.motion]
        self.builder = RecurrenceBuilder(
            graph,
            equations.q,
            equations.v,
            equations.time,
            nodes,
            rate=parts["rates"],
            termwise=termwise,
            unknowns={symbol: n + m + i for i, symbol in enumerate(solved_for)},
            integrals={} if turning is None else turning.integrals,
        )
        self.unknowns = [self.builder.values[v] for v in velocities]
        self.spun = {self.builder.values[equations.v[i]]: self.spin(rate, pull) for i, (rate, _, pull) in spun.items()}
        self.builder.starts.update({} if turning is None else turning.starts)
        self.builder.starts.update(switched.starts)
        solution = equations.plan.solved(self.matrix, parts["right"]) if parts["right"] else []
        self.builder.starts.update(zip(self.motion, solution, strict=True))
        self.sums = form.parts
        self.known: dict[Node, int | None] = {}
        self.momenta = [None if steady else self.momentum(node) for node in form.momenta]
        self.forces = [self.force(terms) for terms in form.forces]
        self.constrain(parts["velocities"], parts["gradient"])
        self.balances = [self.builder.value(node) for node in balance]
        self.seen = tuple(substitute(parts["watched"], dict(zip(self.motion, solution, strict=True))))
        self.watched = [self.builder.value(node) for node in parts["watched"]]
        self.rates = tuple(self.builder.value(rate) for rate in parts["rates"])

    @property
    def matrix(self) -> list[list[Node]]:
        """The matrix of the equations of motion: M, or [[M, G^T], [G, 0]] for a system with constraints."""
        size, zero = len(self.equations.matrix), self.equations.graph.zero
        return [[self.entries.get((i, j), zero) for j in range(size)] for i in range(size)]

    def balance(self, right: Sequence[Node]) -> list[Node]:
        """Return the residuals M a - h - G^T lambda and G a + gamma, with symbols for a and -lambda.

        `right` are the right-hand sides h and -gamma. If it is empty, the result is empty. The residuals are zero along
        the motion. Their Taylor coefficients with the unknowns a and -lambda set to zero are the right-hand sides of
        the linear system for the coefficients of the unknowns.
        """
        graph = self.equations.graph
        return [
            graph.sum([*((1, entry * x) for entry, x in zip(row, self.motion, strict=True)), (-1, known)])
            for row, known in (zip(self.matrix, right, strict=True) if right else ())
        ]

    def constrain(self, velocities: Sequence[Node], gradient: Sequence[Node]) -> None:
        """Add the constraints to the linear system that determines the velocities.

        `velocities` are psi, the constraints on velocities, and `gradient` is G by rows. Each constraint adds the
        equation psi = 0 and an unknown, the integral of -lambda. The integral of G^T over the differential of this
        unknown is added to the momenta.
        """
        b, n, m = self.builder, len(self.equations.q), len(velocities)
        self.impulses = [b.add(SeriesRule("unknown", (), (n + j,)), None) for j in range(m)]
        for i in range(n) if m else ():
            terms = self.inertia(i)
            for j, impulse in enumerate(self.impulses):
                scale, value = self.impulse(impulse, gradient[j * n + i])
                terms.append((value, scale))
            terms = [(value, scale) for value, scale in terms if scale is not b.graph.zero]
            values, scales = zip(*terms, strict=True)
            self.momenta[i] = b.add(SeriesRule("linear", values, tuple(map(b.constant, scales))), None)
        self.momenta += [b.value(psi) for psi in velocities]
        self.forces += [None] * m

    def spin(self, rate: Node, pull: Node) -> int:
        """Return the index of a series value: -2 times the velocity of a quaternion entry, rate - 2 * pull * t.

        `rate` is -2 times the derivative of the entry that follows from the angular rates of the body. Along the series
        the length of the quaternion may change; the acceleration `pull` of the entry at the start of the step removes
        this change.
        """
        b = self.builder
        pulled = b.add(SeriesRule("integral", (b.add(SeriesRule("constant"), pull, pull),), (b.constant(1),)), None)
        return b.add(SeriesRule("linear", (b.value(rate), pulled), (b.constant(1), b.constant(-2))), None)

    def inertia(self, i: int) -> list[tuple[int, Node]]:
        """Return momentum number i as terms (index of a series value, constant factor); empty for zero.

        For a constant mass matrix the terms add up to entry i of M v.
        """
        known, b, e = self.momenta[i], self.builder, self.equations
        if known is not None:
            return [(known, b.graph.one)]
        entries = {j: entry for (k, j), entry in self.entries.items() if k == i and j < len(e.q)}
        return [(self.unknowns[j], entry) for j, entry in entries.items()] if self.steady else []

    def impulse(self, multiplier: int, entry: Node) -> tuple[Node, int]:
        """Return the integral of `entry` over d(multiplier), as (constant factor, index of a series value).

        `entry` is a node of G, the gradients of the constraints. `multiplier` is the index of the series value that
        is the integral of -lambda.
        """
        b = self.builder
        if entry.binding <= Binding.PARAMETER:
            return entry, multiplier
        scale, value = b.split(entry)
        return scale, b.add(SeriesRule("along", (multiplier, value), (b.constant(1),)), None)

    def momentum(self, node: Node) -> int | None:
        """Build the series of the momentum `node`, and return its index among the values of the program.

        The result is None for a momentum of zero. Terms that do not change in time are left out, since only the rate of
        the momentum is used. Other momenta in it are built first.
        """
        todo = [node]
        while todo:
            inner = [momentum for _, _, momentum in self.sums[todo[-1]].inner if momentum not in self.known]
            if inner:
                todo += inner
            else:
                ready = todo.pop()
                self.known[ready] = self.combined(self.sums[ready])
        return self.known[node]

    def combined(self, part: Momentum) -> int | None:
        """Add the series value of a momentum, the sum of its parts. Return its index, or None for zero."""
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
        for coefficient, scale, momentum in part.inner:
            known = self.known[momentum]
            if known is not None:
                add(known, coefficient, scale)
        if not args:
            return None
        return b.add(SeriesRule("linear", tuple(args), tuple(b.constant(c) for c in args.values())), None, graph.zero)

    def force(self, terms: LinearTerms) -> int | None:
        """Return the index of the series value of a force, the sum of `terms`; None for zero."""
        graph = self.equations.graph
        if not terms:
            return None
        node = graph.sum(terms)
        return self.builder.value(node) if len(terms) == 1 else self.builder.linear(terms, node)

    @property
    def cost(self) -> tuple[int, int]:
        """Cost of one order of the series: the number of sums over lower orders, then the number of values."""
        return convolutions(self.builder.rules), len(self.builder.rules)

    def program(self, name: str) -> SeriesProgram:
        """Return the finished series program. The names of all its parts begin with `name`."""
        e, b = self.equations, self.builder
        outputs = {value for value in (*self.forces, *self.watched) if value is not None}
        outputs |= self.spun.keys()
        needed = kept_values(b.rules) | lagged_values(b.rules) | outputs.union(integrated(b.rules, self.rates))
        started = tuple(sorted(needed)) or (0,)
        table = list(b.constants) or [e.graph.one]
        mass = substitute(self.triangles, {} if e.turning is None else e.turning.starts)
        symbols = (*e.parameters, *self.switched.sides)
        entries = [e.graph.symbol(f"constant {index}", Binding.PARAMETER) for index in range(len(table))]
        known = [node if node.kind is Kind.CONSTANT else entries[index] for index, node in enumerate(table)]
        n = len(e.q)
        low = [e.graph.symbol(f"low {i}", Binding.CONFIGURATION if i < n else Binding.VELOCITY) for i in range(2 * n)]
        values = b.initial(known, dict(enumerate(low)))
        for value, (_, slope, _) in zip(self.spun, () if e.turning is None else e.turning.spun.values(), strict=True):
            values[value] = slope
        initial = [known_node(values[value]) for value in started]
        constants: dict[str, list[Node]] = {"table": table, "mass": [e.graph.node(2)] * len(self.spun)}
        first = {"values": initial, "mass": []}
        (first if self.plan.moving else constants)["mass"][:0] = [*mass, *mass] if self.motion else mass
        lost = {"q_lost": low[:n], "v_lost": low[n:]}
        stated = self.switched.stated or (e.graph.zero,)
        corrections = projection(e) if len(e.constraints) else None
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
            stages=self.stages(),
            watched=tuple(self.watched),
            values=lower(f"{name}_values", {"values": self.seen or (e.graph.zero,)}, e.state, e.time, symbols),
            projection=None
            if corrections is None
            else lower("projection", corrections, e.state, e.time, e.parameters, solved=True),
        )

    def stages(self) -> tuple[Stage, ...]:
        """Return the linear systems that are solved at each order, in order.

        The first determines the velocities. A second one determines watched accelerations and multipliers or, for a
        system in angular rates of bodies, the velocities of quaternions.
        """
        b = self.builder
        first = Stage((*self.unknowns, *self.impulses), tuple(self.momenta), tuple(self.forces), self.plan)
        if self.spun:
            alone = SolvePlan(tuple((i,) for i in range(len(self.spun))), moving=False)
            return (first, Stage(tuple(self.spun), tuple(self.spun.values()), (None,) * len(self.spun), alone))
        if not self.motion:
            return (first,)
        unknowns = tuple(b.values[symbol] for symbol in self.motion)
        return (first, Stage(unknowns, tuple(self.balances), (None,) * len(unknowns), self.plan))


def _is_constant(triangles: Sequence[Node]) -> bool:
    return all(entry.binding <= Binding.PARAMETER for entry in triangles)
