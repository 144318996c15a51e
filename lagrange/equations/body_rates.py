"""Euler-Poincare equations of rotating bodies, in their angular velocities, for Taylor series.

These are p = dL/dw, dp/dt = p x w + (dL along a turn) + torque, for a statement whose rotations are described by small
turns. The length of a quaternion does not occur in them, so the equation of the quaternion is polynomial: dq/dt =
q w/2. The entries of a rotation matrix R are separate variables with the derivatives R (w x).
Source: J. E. Marsden, T. S. Ratiu, Introduction to Mechanics and Symmetry, 1999, section 13.5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from typing import Any

from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.node import Binding, Graph, Node, substitute
from lagrange.graph.sympy_nodes import Translator
from lagrange.statement.coordinate import velocity_of
from lagrange.statement.rotation import Rotation, rotation_of
from lagrange.statement.space import conjugate, length_excess, matrix_of, product
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class Turning:
    """Equations with m velocities: first those of coordinates outside of rotations, then three rates w of each body.

    - `velocities`, `momenta` and `forces` have m entries. Forces on a body contain p x w, with its momenta p.
    - `derivatives` maps coordinates outside of rotations, and symbols of entries of rotation matrices, to derivatives.
    - `starts` maps the symbols of w and of entries of rotation matrices to nodes in the statement's q and v.
    - `spun` maps the coordinate index of each quaternion entry to three nodes. The first is -q w, which is minus twice
      the derivative of the quaternion q. The others are the derivatives of q and of its velocities v at the start of a
      step, with terms that restore the length of the quaternion. Without these terms errors of v along q would
      accumulate, and change the energy.
    """

    velocities: tuple[Node, ...]
    momenta: tuple[Node, ...]
    forces: tuple[Node, ...]
    derivatives: Mapping[Node, Node]
    starts: Mapping[Node, Node]
    spun: Mapping[int, tuple[Node, Node, Node]]

    @property
    def integrals(self) -> dict[Node, Node]:
        """Time derivatives of the entries of rotation matrices, {symbol of the entry: derivative}."""
        return {symbol: rate for symbol, rate in self.derivatives.items() if symbol in self.starts}

    @property
    def adjacent(self) -> bool:
        """True if the entries of all quaternions are consecutive coordinates, at the start or the end of q.

        Taylor series are computed in rates of bodies only if this is true.
        """
        count = len(self.spun)
        first, others = min(self.spun), len(self.velocities) - count * 3 // 4
        return first in (0, others) and max(self.spun) == first + count - 1

    def has(self, node: Node) -> bool:
        """Return True if a node contains rates of bodies or entries of rotation matrices."""
        return any(symbol.depends & node.depends for symbol in self.starts)


class _Body:
    """Rotating body: symbols of its angular velocity w and of the entries of its rotation matrix R, and derivatives."""

    def __init__(self, graph: Graph, each: Rotation, leaves: Mapping[Any, Node]) -> None:
        q, v = ([leaves[f] for f in part] for part in (each.quaternion, map(velocity_of, each.quaternion)))
        self.w = [graph.symbol(str(f), Binding.VELOCITY) for f in each.body]
        self.entries = [graph.symbol(str(f), Binding.CONFIGURATION) for f in each.matrix]
        turned = [
            graph.sum([(1, e * rate) for e, rate in zip(self.entries[i:], self.w, strict=False)]) for i in (0, 3, 6)
        ]
        known = (*self.w, *self.entries, *turned)
        self.leaves = dict(zip((*each.body, *each.matrix, *each.space), known, strict=True))
        (w, i, j, k), (a, b, c), half = q, self.w, Fraction(1, 2)
        rows = (
            [(-i, a), (-j, b), (-k, c)],
            [(w, a), (j, c), (-k, b)],
            [(w, b), (k, a), (-i, c)],
            [(w, c), (i, b), (-j, a)],
        )
        self.spun = [graph.sum([(-1, x * rate) for x, rate in row]) for row in rows]
        """Four nodes -q w, which are minus twice the time derivatives of the quaternion q. w are the body's rates."""
        square = w**2 + i**2 + j**2 + k**2
        excess = length_excess(q)
        (stretch, *turned), size = product(conjugate(q), v), graph.power(a**2 + b**2 + c**2, half)
        rates = [2 * rate - 2 * rate * (excess / square) for rate in turned]
        self.starts = dict(zip((*self.w, *self.entries), (*rates, *chain(*matrix_of(q))), strict=True))
        slopes = [-half * (rate + size * excess * x) for rate, x in zip(self.spun, q, strict=True)]
        self.slopes = substitute(slopes, self.starts)
        """Time derivatives of the quaternion at the start of a step, with a term that brings its length back to one."""
        self.pulls = [-(size * stretch / square * x) for x in q]
        """Second time derivatives of the quaternion at the start of a step that damp changes of its length."""
        x, y, z = columns = [self.entries[k::3] for k in range(3)]
        changes = ({1: z, 2: [-e for e in y]}, {0: [-e for e in z], 2: x}, {0: y, 1: [-e for e in x]})
        self.turns = [
            {e: moved for k, column in change.items() for e, moved in zip(columns[k], column, strict=True)}
            for change in changes
        ]
        """Derivatives {entry of R: derivative} along a small turn about each body axis, without those that are zero."""

    def rates(self) -> dict[Node, Node]:
        """Return the time derivatives of the entries of the rotation matrix R, by symbol."""
        zero = self.w[0].graph.zero
        pairs = list(zip(self.w, self.turns, strict=True))
        return {e: sum((w * turn.get(e, zero) for w, turn in pairs), zero) for e in self.entries}

    def spin(self, p: Sequence[Node]) -> list[Node]:
        """Return p x w, three nodes, where p is the angular momentum and w are the rates of the body."""
        (a, b, c), (x, y, z) = self.w, p
        return [y * c - z * b, z * a - x * c, x * b - y * a]


def turning(statement: Statement, graph: Graph, leaves: Mapping[Any, Node]) -> Turning | None:
    """Return the equations of motion of a statement in the angular velocities of its bodies, or None.

    The result is None for a statement with constraints, and for rotations that cannot be described by small turns.
    `leaves` maps coordinates, velocities, time and parameters to nodes of the graph.
    """
    read = statement.reading
    if read is None or read.constraints:
        return None
    rotations = list(map(rotation_of, statement.rotations))
    bodies = [_Body(graph, each, leaves) for each in rotations]
    nodes = {**leaves}
    for body in bodies:
        nodes |= body.leaves
    translate = Translator(graph, nodes)
    lagrangian, dissipation = translate(read.kinetic) - translate(read.potential), translate(read.dissipation)
    others = [nodes[q] for q in read.coordinates if q in nodes]
    velocities = [nodes[v] for v in read.velocities]
    momenta = gradient(lagrangian, velocities)
    forces = gradient(lagrangian, others)
    for i, body in enumerate(bodies):
        spin = body.spin(momenta[len(others) + 3 * i :][:3])
        forces += [tangents([lagrangian], turn)(lagrangian) + p for turn, p in zip(body.turns, spin, strict=True)]
    parts = zip(forces, map(translate, read.forces), gradient(dissipation, velocities), strict=True)
    derivatives = dict(zip(others, velocities, strict=False))
    starts: dict[Node, Node] = {}
    spun: dict[int, tuple[Node, Node, Node]] = {}
    for each, body in zip(rotations, bodies, strict=True):
        derivatives |= body.rates()
        starts |= body.starts
        rows = map(statement.coordinates.index, each.quaternion)
        spun |= zip(rows, zip(body.spun, body.slopes, body.pulls, strict=True), strict=True)
    return Turning(
        velocities=tuple(velocities),
        momenta=tuple(momenta),
        forces=tuple(force + applied - drag for force, applied, drag in parts),
        derivatives=derivatives,
        starts=starts,
        spun=dict(sorted(spun.items())),
    )
