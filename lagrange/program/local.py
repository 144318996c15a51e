"""Equations of motion in local coordinates about the start of a step, for Munthe-Kaas's methods.

A rotation that has turned by the angle a about a unit vector n since then has Cayley's coordinates u = tan(a/2) n. With
the rates w of the body, u' = (w + u x w + (u.w) u)/2. A local state has u as a quaternion Q = q (1, u), where q is the
quaternion at the start: Q' = Q (u.w, w)/2. It has w as V = q (0, w)/2. Both are linear in u and w, so a Runge-Kutta
step of Q and V is one of u and w. Other coordinates and velocities are local as they are.
Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, sections IV.8.2 and IV.8.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.node import Binding, Node
from lagrange.graph.rebuild import substitute
from lagrange.program.lower import Named
from lagrange.statement.coordinate import rotation_name
from lagrange.statement.rotation import rotation_of
from lagrange.statement.space import conjugate, product

HALF = Fraction(1, 2)


def local_inputs(equations: Equations) -> dict[str, Sequence[Node]]:
    """Return the inputs of `local` by name: a local state (Q, V), then the coordinates at the start of the step."""
    start = [equations.graph.symbol(f"start {i}", Binding.CONFIGURATION) for i in range(len(equations.q))]
    return {**equations.state, "start": start}


def local(equations: Equations) -> Named:
    """Return the nodes of dQ/dt, dV/dt, q and v for a local state (Q, V) about the start of a step, n of each.

    [q, v] is the state that (Q, V) represents. Its quaternions have length one, and their velocities are
    perpendicular to them.
    """
    e, graph, start = equations, equations.graph, local_inputs(equations)["start"]
    rates, coordinates, velocities, known = [*e.rate], [*e.q], [*e.v], {}
    turned = [[e.q.index(entry) for entry in quaternion] for quaternion in _quaternions(e)]
    for rows in turned:
        q, Q, V = ([part[i] for i in rows] for part in (start, e.q, e.v))
        w = [2 * rate for rate in _quotient(V, q)]
        along = graph.sum([(1, a * b) for a, b in zip(_quotient(Q, q), w, strict=True)])
        spin = [HALF * entry for entry in product(Q, (graph.zero, *w))]
        unit = graph.power(_square(Q), -HALF)
        for k, i in enumerate(rows):
            known[e.v[i]] = spin[k]
            rates[i] = spin[k] + HALF * along * Q[k]
            coordinates[i], velocities[i] = unit * Q[k], unit * spin[k]
    accelerations = substitute(e.accelerations, known)
    for rows in turned:
        q, Q, pushed = ([part[i] for i in rows] for part in (start, e.q, accelerations))
        for i, entry in zip(rows, product(q, (graph.zero, *_quotient(pushed, Q))), strict=True):
            accelerations[i] = entry
    return {"rates": rates, "accelerations": accelerations, "coordinates": coordinates, "velocities": velocities}


def _quaternions(equations: Equations) -> list[list[Node]]:
    """Return for each rotation of the system the four coordinates of its quaternion."""
    names = dict.fromkeys(name for name in map(rotation_name, equations.leaves) if name is not None)
    return [[equations.leaves[q] for q in rotation_of(name).quaternion] for name in names]


def _quotient(a: Sequence[Node], q: Sequence[Node]) -> list[Node]:
    """Return the vector part of q^-1 a for quaternions q and a."""
    square = _square(q)
    _, *vector = product(conjugate(q), a)
    return [entry / square for entry in vector]


def _square(q: Sequence[Node]) -> Node:
    return q[0].graph.sum([(1, entry**2) for entry in q])
