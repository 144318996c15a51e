"""Taylor coefficients of random mechanisms, in 200 digits, against what the law of motion leaves of their series."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp
from hypothesis import assume, given
from hypothesis import strategies as st

from lagrange.evidence.precise import Precise
from lagrange.statement.coordinate import t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from tests.laws.mechanisms import PLACES, RATES, functions_of, holonomic, kinetic_energies, potentials, rationals, some
from tests.series import CONTEXT, DIGITS, NUMBER, series

ORDER = 9
TIME = NUMBER("0.25")

three = st.tuples(rationals, rationals, rationals)


def law(lagrangian: Any) -> list[Any]:
    """Return M by rows, and behind them the rest of d/dt dL/dv - dL/dq; SymPy differentiates."""
    momenta = [sp.diff(lagrangian, v) for v in RATES]
    mass = [sp.diff(p, v) for p in momenta for v in RATES]
    rest = [
        sum(sp.diff(p, x) * v for x, v in zip(PLACES, RATES, strict=True)) - sp.diff(lagrangian, q)
        for p, q in zip(momenta, PLACES, strict=True)
    ]
    return mass + rest


def residuals(judge: Precise, found: Any, h: Any) -> tuple[Any, Any]:
    """Return what a polynomial leaves of M a + rest across G, and of phi, at a time h behind the start."""
    powers = [h**k for k in range(len(found))]
    q = [sum(c * s for c, s in zip(found[:, i], powers, strict=True)) for i in range(3)]
    v = [sum(k * found[k, i] * powers[k - 1] for k in range(1, len(found))) for i in range(3)]
    a = [sum(k * (k - 1) * found[k, i] * powers[k - 2] for k in range(2, len(found))) for i in range(3)]
    *mass, r1, r2, r3, g1, g2, g3, off = judge(q, v, TIME + h, {})
    e1, e2, e3 = (
        sum(c * x for c, x in zip(mass[3 * i : 3 * i + 3], a, strict=True)) + r for i, r in enumerate((r1, r2, r3))
    )
    return max(abs(e1 * g2 - e2 * g1), abs(e2 * g3 - e3 * g2), abs(e3 * g1 - e1 * g3)), abs(off)


def start(statement: Statement, place: Sequence[Any], wish: Sequence[Any]) -> list[Any]:
    """Return a place, and the velocities nearest to a wish that the constraint allows, to all digits."""
    phi = statement.constraints[0].expression
    rows = Precise([*(sp.diff(phi, q) for q in PLACES), sp.diff(phi, t).doit()], statement, DIGITS)
    q, w = ([NUMBER(one.p) / one.q for one in numbers] for numbers in (place, wish))
    *G, rate = rows(q, w, TIME, {})
    size = sum(one**2 for one in G)
    assume(size > 0.1)
    return [*q, *(one - rate / size * two for one, two in zip(w, G, strict=True))]


@some
@given(kinetic_energies(*PLACES), potentials(*PLACES), holonomic(*PLACES), functions_of(t, *PLACES), three, three)
def test_a_series_is_that_of_the_motion(T: Any, V: Any, phi: Any, moving: Any, place: Any, wish: Any) -> None:
    """Of the polynomial of order p, M a - h leaves p - 1 powers of h beside G^T lambda, and phi leaves p + 1."""
    phi = phi + moving / 8
    phi -= phi.subs(dict(zip(PLACES, place, strict=True))).subs(t, sp.Rational(1, 4))
    statement = declare(coordinates=list(PLACES), kinetic=T, potential=V, constraints=[phi])
    found = series(statement, ORDER, TIME, start(statement, place, wish))
    judge = Precise([*law(T - V), *(sp.diff(phi, q) for q in PLACES), phi], statement, DIGITS)
    step = NUMBER(10) ** -12
    both = zip(residuals(judge, found, step), residuals(judge, found, 2 * step), strict=True)
    for (near, far), expected in zip(both, (ORDER - 1, ORDER + 1), strict=True):
        assert near < step ** (expected - 1)
        if near > NUMBER(10) ** (20 - DIGITS):  # a series that ends leaves nothing
            assert CONTEXT.log(far / near, 2) > expected - 0.1
