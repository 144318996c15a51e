"""Systems for tests of series, and series in multiple precision as an independent judge of recurrences."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import mpmath
import sympy as sp
from sympy import cos, sin, sqrt

from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.evidence.precise import Precise
from lagrange.machine.kernel.interpreted import Arithmetic
from lagrange.machine.numpy_machine import Jet
from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import assemblies, series_program, switched_equations
from lagrange.statement.coordinate import coordinate, coordinates, t
from lagrange.statement.statement import Statement
from tests.models import SYSTEMS, M, c, chain, g, k, l, m, omega, phi, stated, theta, x, y
from tests.operations import operations


def relative(n: int) -> Statement:
    """Return a chain of n pendulums in relative angles: the entries of the mass matrix are long."""
    angles = [coordinate(f"a{i}") for i in range(n)]
    kinetic = potential = px = py = total = sp.S.Zero
    for angle in angles:
        total += angle
        px, py = px + l * sin(total), py - l * cos(total)
        kinetic += m * (sp.diff(px, t) ** 2 + sp.diff(py, t) ** 2) / 2
        potential += m * g * py
    start = {angle: 0.5 + 0.125 * i for i, angle in enumerate(angles)} | {angles[0].dot: 0.75}
    return stated(kinetic=kinetic, potential=potential, coordinates=angles, initial=start)


def textbook() -> Statement:
    """Return the double pendulum as in textbooks, with cos(theta - phi)."""
    spin = theta.dot**2 + phi.dot**2 / 2 + theta.dot * phi.dot * cos(theta - phi)
    return stated(
        kinetic=m * l**2 * spin,
        potential=-m * g * l * (2 * cos(theta) + cos(phi)),
        coordinates=[theta, phi],
        initial={theta: 0.5, phi: 0.75, theta.dot: 0.25, phi.dot: -1.0},
    )


def kapitza() -> Statement:
    """Return Kapitza's pendulum, whose pivot oscillates."""
    place = (l * sin(theta), cos(omega * t) / 4 - l * cos(theta))
    speed = sum(sp.diff(part, t) ** 2 for part in place)
    return stated(kinetic=m * speed / 2, potential=m * g * place[1], initial={theta: 0.5, theta.dot: 0.25})


def growing() -> Statement:
    """Return a system with explicit time in T, terms linear in velocities, and dissipation of degree four."""
    return stated(
        kinetic=m * sp.exp(t / 4) * x.dot**2 / 2 + M * (x.dot + y.dot * cos(x)) ** 2 / 2 + y.dot**2 + t * x * y.dot,
        potential=k * (x * y) ** 2 / 2,
        forces={x: cos(omega * t) - c * y.dot},
        dissipation=c * (x.dot**2 + y.dot**4) / 2,
        coordinates=[x, y],
        initial={x: 0.5, y: 0.25, x.dot: 0.25, y.dot: 0.5},
    )


def rotating() -> Statement:
    """Return a system with a constant coupled mass matrix, Coriolis forces, and explicit time."""
    return stated(
        lagrangian=m * x.dot**2 / 2 + M * (x.dot + y.dot) ** 2 / 2 + omega * x * y**2 * y.dot + t * x.dot * sin(y),
        coordinates=[x, y],
        initial={x: 0.5, y: 0.25, x.dot: 0.25, y.dot: 0.5},
    )


def relativistic() -> Statement:
    """Return a system whose Lagrangian is not quadratic in the velocities."""
    return stated(
        lagrangian=-m * c**2 * 256 * sqrt(1 - (x.dot**2 + y.dot**2) / (256 * c**2)) - k * x * y**2,
        initial={x: 0.5, y: 0.25, x.dot: 0.25, y.dot: 0.5},
    )


def bent() -> Statement:
    """Return a system with fractional powers of abs: the mass matrix depends on velocities and on signs of surfaces."""
    coupling = x.dot * sp.Abs(y.dot) ** sp.Rational(3, 2) + y.dot * sp.Abs(x - 2) ** sp.Rational(7, 4) * x.dot
    return stated(
        lagrangian=(1 + x / 8) * x.dot**2 + y.dot**2 + coupling / 16 - k * x * y**2,
        coordinates=[x, y],
        initial={x: 0.5, y: 0.25, x.dot: 0.25, y.dot: -0.5},
    )


def gravity(n: int) -> Statement:
    """Return n bodies in space that attract each other."""
    bodies = [coordinates(f"x{i} y{i} z{i}") for i in range(n)]
    kinetic = sum((1 + sp.Rational(i, 4)) * r.dot**2 / 2 for i, body in enumerate(bodies) for r in body)
    potential = sp.S.Zero
    for (i, a), (j, b) in itertools.combinations(enumerate(bodies), 2):
        distance = sqrt(sum((p - q) ** 2 for p, q in zip(a, b, strict=True)))
        potential -= k * (1 + sp.Rational(i, 4)) * (1 + sp.Rational(j, 4)) / distance
    places = [r for body in bodies for r in body]
    start = {r: (-1) ** i * (0.5 + 0.25 * i) + (i % 3) for i, r in enumerate(places)}
    return stated(kinetic=kinetic, potential=potential, coordinates=places, initial=start)


def lattice(n: int) -> Statement:
    """Return n masses between walls with hardening springs, as of Fermi, Pasta, Ulam and Tsingou."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    stretch = [b - a for a, b in itertools.pairwise([sp.S.Zero, *xs, sp.S.Zero])]
    return stated(
        kinetic=m * sum(q.dot**2 for q in xs) / 2,
        potential=sum(k * s**2 / 2 + s**4 / 4 for s in stretch),
        coordinates=xs,
        initial={q: 0.25 * (-1) ** i + 0.125 * i for i, q in enumerate(xs)},
    )


def functions() -> Statement:
    """Return a system with all elementary functions, once and twice."""
    terms = [f(x * y / 4) + f(x.dot / 8) for f in (sp.sin, sp.tan, sp.asin, sp.acos, sp.atan, sp.exp, sp.sinh, sp.tanh)]
    terms += [f(x * y / 4) for f in (sp.asinh, sp.atanh, sp.erf)]
    terms += [
        sp.acosh(2 + x),
        sp.log(2 + x),
        sp.atan2(y, 2 + x),
        sp.atan2(x, m),
        sp.atan2(m, 2 + y),
        sqrt(2 + x * y),
        x / (y + 3),
        1 / (3 + x * y),
    ]
    terms += [(3 + x) ** k, (3 + y) ** c, (2 + x) ** y, (4 + y) ** -3, (2 + x) ** sp.Rational(-3, 2)]
    terms += [sp.Abs(x - 4), sp.Min(x, y) * sp.Max(x**2, y), cos(t) * sp.sign(y.dot)]
    terms += [sp.Piecewise((x * y, x < y), (cos(y), x < 2 * y), (t, True))]
    return stated(
        kinetic=x.dot**2 / 2 + y.dot**2,
        forces={x: sum(terms[::2]), y: sum(terms[1::2])},
        coordinates=[x, y],
        initial={x: 0.5, y: 0.25, x.dot: 0.25, y.dot: 0.5},
    )


def started(name: str) -> Statement:
    """Return a named system with initial velocities, since from rest every second coefficient is zero."""
    statement = SYSTEMS[name]()
    n = len(statement.coordinates)
    return replace(statement, initial=(*statement.initial[:n], *(0.25 + 0.125 * i for i in range(n))))


def coupled() -> Statement:
    """Return a system with three coupled velocities, which do not fill a vector of four."""
    a, b, d = coordinates("a b d")
    coupling = (a.dot * b.dot + b.dot * d.dot) / 3
    return stated(
        kinetic=a.dot**2 + b.dot**2 + d.dot**2 + coupling + a**2 * a.dot**2 / 10,
        potential=sp.exp(a) + sp.exp(b + 1) + sp.tan(d) + sp.tanh(d),
        coordinates=[a, b, d],
        initial={a: 0.25, b: 0.5, d: 0.125, a.dot: 0.5},
    )


LARGER: dict[str, Callable[[], Statement]] = {
    **SYSTEMS,
    "textbook": textbook,
    "relative angles": lambda: relative(2),
    **{f"chain of {n}": partial(chain, n) for n in (3, 5)},
    **{f"{n} relative angles": partial(relative, n) for n in (3, 5, 7)},
    "kapitza": kapitza,
    "growing": growing,
    "rotating": rotating,
    "relativistic": relativistic,
    "4 bodies": lambda: gravity(4),
    "lattice of 10": lambda: lattice(10),
    "functions": functions,
    "coupled functions": coupled,
}
"""Everything that a kernel may look like: diagonal, full and constant, in blocks, long, and with every rule."""


def rods(n: int) -> Statement:
    """Return n masses in a plane, connected by rods: a sparse system with multipliers."""
    places = [coordinates(f"x{i} y{i}") for i in range(n)]
    ends = [(sp.S.Zero, sp.S.Zero), *places]
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(ends)]
    start: dict[Any, float] = {}
    for i, (a, b) in enumerate(places):
        start |= {a: (i + 1) * 0.6 + 0.05 * i, b: -(i + 1) * 0.8, a.dot: 0.25 * i, b.dot: 0.125}
    return stated(
        kinetic=m * sum(q.dot**2 for place in places for q in place) / 2 + places[-1][0].dot * places[-1][1].dot / 8,
        potential=m * g * sum(b for _, b in places),
        coordinates=[q for place in places for q in place],
        constraints=[a**2 + b**2 - l**2 for a, b in steps],
        initial=start,
    )


def ladder(n: int) -> Statement:
    """Return n four-bar loops of uniform rods in a row: mass matrix and constraints couple only neighbours."""
    places = [coordinates(f"x{i} y{i}") for i in range(n + 1)]
    feet = [(sp.Integer(i), sp.S.Zero) for i in range(n + 1)]
    rods_ = [*zip(feet, places, strict=True), *itertools.pairwise(places)]
    speed = [[(sp.diff(a, t), sp.diff(b, t)) for a, b in zip(*ends, strict=True)] for ends in rods_]
    start: dict[Any, float] = {}
    for i, (a, b) in enumerate(places):
        start |= {a: i + 0.28, b: 0.96, a.dot: 0.48, b.dot: -0.14}
    return stated(
        kinetic=m * sum(p**2 + p * q + q**2 for rod in speed for p, q in rod) / 6,
        potential=m * g * sum(b for _, b in places),
        coordinates=[q for place in places for q in place],
        constraints=[sum((b - a) ** 2 for a, b in zip(*ends, strict=True)) - 1 for ends in rods_],
        initial=start,
    )


def sleigh() -> Statement:
    """Return Chaplygin's sleigh on a moving belt, a constraint on velocities."""
    skid = -sin(theta) * (x.dot - t / 8) + cos(theta) * y.dot
    centre = (x + k * cos(theta) / 4, y + k * sin(theta) / 4)
    speed = sum(sp.diff(part, t) ** 2 for part in centre)
    return stated(
        kinetic=m * speed / 2 + M * theta.dot**2 / 8,
        potential=0,
        coordinates=[x, y, theta],
        constraints={"blade": skid},
        initial={x: 0.5, theta: 0.5, x.dot: 0.25, theta.dot: 0.75},
    )


def quaternion() -> Statement:
    """Return a rigid body in terms of a unit quaternion: T depends on three of the four rates."""
    a, b, d, e = coordinates("qa qb qc qd")
    spin = (
        2 * (a * b.dot - b * a.dot - d * e.dot + e * d.dot),
        2 * (a * d.dot - d * a.dot - e * b.dot + b * e.dot),
        2 * (a * e.dot - e * a.dot - b * d.dot + d * b.dot),
    )
    moments = (m, M, m + M / 4)
    return stated(
        kinetic=sum(moment * rate**2 for moment, rate in zip(moments, spin, strict=True)) / 2,
        potential=k * (b * e + a * d),
        coordinates=[a, b, d, e],
        constraints={"unit": a**2 + b**2 + d**2 + e**2 - 1},
        initial={a: 0.5, b: -0.5, d: 0.5, e: 0.5, a.dot: 0.25, b.dot: 0.5, d.dot: -0.25, e.dot: 0.5},
    )


HELD: dict[str, Callable[[], Statement]] = {
    "1 rod": lambda: rods(1),
    "3 rods": lambda: rods(3),
    "ladder of 1": lambda: ladder(1),
    "ladder of 6": lambda: ladder(6),
    "sleigh": sleigh,
    "quaternion": quaternion,
}
"""Systems with constraints: sparse, of velocities, with time, and with a mass matrix that is singular by itself."""


# --- series in multiple precision, and their residuals: an independent judge of recurrences --------------------


DIGITS = 200
"""Enough for a coefficient of order 12 to be seen in a motion over 1e-12, see `right_orders`."""

PRECISE: Any = mpmath.MPContext()
PRECISE.dps = DIGITS
NUMBER = PRECISE.mpf

MANY_DIGITS = Arithmetic(operations(PRECISE), NUMBER, object)
"""The operations of a program on numbers of `DIGITS` digits."""


def numbers(values: Sequence[Any]) -> list[Any]:
    return [NUMBER(value) for value in values]


def jet(program: SeriesProgram, parameters: Sequence[Any]) -> Jet:
    return Jet(program, numbers(parameters), MANY_DIGITS)


def values(statement: Statement) -> list[Any]:
    """Return the parameters' default values."""
    return [statement.defaults[p] for p in statement.parameters]


def sides(program: SeriesProgram, parameters: Sequence[Any], time: Any, y: Sequence[Any]) -> list[Any]:
    """Return the signs of the switching surfaces at a state. A surface may depend on the signs of others."""
    result: list[Any] = [NUMBER(1)] * program.sides
    for _ in range(program.sides + 1):
        x = jet(program, [*parameters, *result]).coefficients(NUMBER(time), numbers(y), 0)
        result = [PRECISE.sign(x[0, surface]) for surface in program.watched[: program.sides]]
    return result


def series(statement: Statement, order: int, time: Any = 0.25, start: Sequence[Any] | None = None) -> Any:
    """Return the coefficients of q and v at a time and a state, (order + 1, 2n)."""
    program, _ = series_program(euler_lagrange(statement))
    return coefficients(program, statement, order, time, start)


def coefficients(
    program: SeriesProgram, statement: Statement, order: int, time: Any = 0.25, start: Sequence[Any] | None = None
) -> Any:
    """Return the Taylor coefficients of q and v by a program, (order + 1, 2n)."""
    y = statement.initial if start is None else start
    parameters = values(statement)
    parameters += sides(program, parameters, time, y)
    result = jet(program, parameters).coefficients(NUMBER(time), numbers(y), order)
    return result[:, : 2 * program.dimension]


def all_forms(equations: Equations) -> list[SeriesProgram]:
    """Return the programs of all forms of the equations, with rates of sums whole and separate."""
    result = assemblies(equations, *switched_equations(equations))
    return [assembly.program("series") for assembly in result]


def right_orders(statement: Statement, result: Any, time: Any = 0.25) -> float:
    """Return the order up to which coefficients of q are right, from the residual of the equations of motion.

    A motion that is right up to order p, with an error d at the next order, has the residual p (p+1) d h^(p-1) at the
    time h. The power follows from doubling h from 1e-12, where later terms are smaller by a factor of 1e-12.
    """
    near, far = (residual(statement, result, time, NUMBER(h) * NUMBER(10) ** -12) for h in (1, 2))
    if near < NUMBER(10) ** (10 - DIGITS):  # a series that ends, as that of an oscillator at rest
        return math.inf
    return float(PRECISE.log(far / near, 2)) + 1


def residual(statement: Statement, result: Any, time: Any, h: Any) -> Any:
    """Return |d/dt dL/dv - dL/dq - Q + dD/dv| at time + h for the polynomial with these coefficients.

    SymPy differentiates and mpmath evaluates, independent of the graph.
    """
    n = len(statement.coordinates)
    powers = [h**k for k in range(len(result))]
    q = [sum(c * s for c, s in zip(result[:, i], powers, strict=True)) for i in range(n)]
    v = [sum(k * c * powers[k - 1] for k, c in enumerate(result[:, i]) if k) for i in range(n)]
    a = [sum(k * (k - 1) * c * powers[k - 2] for k, c in enumerate(result[:, i]) if k > 1) for i in range(n)]
    parameters = dict(zip(statement.parameters, values(statement), strict=True))
    rows = _law(statement)(q, v, NUMBER(time) + h, parameters)
    width = 2 * n + 1
    left = [rows[i * width : (i + 1) * width] for i in range(n)]
    return max(abs(row[-1] + sum(c * x for c, x in zip(row, (*v, *a), strict=False))) for row in left)


@cache
def _law(statement: Statement) -> Precise:
    """Return, for each coordinate, the coefficients of v and a in the equation of motion, and its other terms."""
    q, v = statement.coordinates, statement.velocities
    moving = [sp.Dummy(real=True) for _ in (*v, *q)]
    there = dict(zip((*v, *q), moving, strict=True))
    back = {symbol: leaf for leaf, symbol in there.items()}

    def plain(expression: Any) -> Any:
        return expression.xreplace({leaf: there[leaf] for leaf in v}).xreplace({leaf: there[leaf] for leaf in q})

    lagrangian, dissipation = plain(statement.lagrangian), plain(statement.dissipation)
    outputs = []
    for place, speed, force in zip(q, v, statement.forces, strict=True):
        momentum = lagrangian.diff(there[speed])
        outputs += [momentum.diff(there[leaf]) for leaf in (*q, *v)]
        outputs.append(momentum.diff(t) - lagrangian.diff(there[place]) - plain(force) + dissipation.diff(there[speed]))
    # SymPy's slope of Max is Heaviside's step, and that of sign an impulse on the surface itself.
    outputs = [output.replace(sp.Heaviside, lambda a, *_: (1 + sp.sign(a)) / 2) for output in outputs]
    outputs = [output.replace(sp.DiracDelta, lambda *_: sp.S.Zero) for output in outputs]
    return Precise([output.xreplace(back) for output in outputs], statement, DIGITS)
