"""Textbook systems for the tests of typed answers, each stated and derived once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import sympy as sp

import lagrange as lg
from tests.models import shared_scene


@cache
def oscillator() -> lg.System:
    x, (m, k, c, g, F, w) = lg.coordinate("x"), lg.parameters("m k c g F w")
    return lg.System(
        m * x.dot**2 / 2, k * x**2 / 2 - m * g * x, forces={x: F * sp.cos(w * lg.t)}, dissipation=c * x.dot**2 / 2
    )


@cache
def morse() -> lg.System:
    r, (m, D, a) = lg.coordinate("r"), lg.parameters("m D a")
    return lg.System(m * r.dot**2 / 2, D * (1 - sp.exp(-a * r)) ** 2)


@cache
def orbit() -> lg.System:
    r, phi = lg.coordinates("r phi")
    m, M, g = lg.parameters("m M g")
    return lg.System((m + M) * r.dot**2 / 2 + m * r**2 * phi.dot**2 / 2, M * g * r)


@cache
def wedge() -> lg.System:
    X, s = lg.coordinates("X s")
    m, M, g, a = lg.parameters("m M g a")
    return lg.System((M + m) * X.dot**2 / 2 + m * s.dot**2 / 2 + m * X.dot * s.dot * sp.cos(a), -m * g * s * sp.sin(a))


@cache
def chain() -> lg.System:
    x1, x2, x3 = lg.coordinates("x1 x2 x3")
    m, M, k, b = lg.parameters("m M k b")
    springs = k * ((x2 - x1 - b) ** 2 + (x3 - x2 - b) ** 2) / 2
    return lg.System(m * (x1.dot**2 + x3.dot**2) / 2 + M * x2.dot**2 / 2, springs)


@cache
def top() -> lg.System:
    phi, theta, psi = lg.coordinates("phi theta psi")
    I1, I3 = lg.parameters("I1 I3")
    spin = psi.dot + phi.dot * sp.cos(theta)
    return lg.System(I1 * (theta.dot**2 + phi.dot**2 * sp.sin(theta) ** 2) / 2 + I3 * spin**2 / 2, 0)


@cache
def cart() -> lg.System:
    x, theta = lg.coordinates("x theta")
    M, m, l, g = lg.parameters("M m l g")
    bob = (x + l * sp.sin(theta), -l * sp.cos(theta))
    return lg.System(M * x.dot**2 / 2 + lg.kinetic_energy(m, bob), lg.gravity(m, bob, g))


@cache
def driven() -> lg.System:
    theta, (m, l, g, A, gamma) = lg.coordinate("theta"), lg.parameters("m l g A gamma")
    return lg.System(m * l**2 * theta.dot**2 / 2, -m * l * (g + A * sp.sin(theta - gamma * lg.t)) * sp.cos(theta))


@cache
def table() -> lg.System:
    x, y = lg.coordinates("x y")
    m, g, mu = lg.parameters("m g mu")
    friction = -mu * m * g * sp.sign(x.dot)
    kinetic = m * (x.dot**2 + y.dot**2) / 2
    return lg.System(kinetic, m * g * y, constraints={"table": y}, forces={x: friction})


@cache
def rolling() -> lg.System:
    s, phi = lg.coordinates("s phi")
    m, inertia, R, g, a = lg.parameters("m I R g alpha")
    kinetic = m * s.dot**2 / 2 + inertia * phi.dot**2 / 2
    return lg.System(kinetic, -m * g * s * sp.sin(a), constraints={"rolling": s - R * phi})


@cache
def strung() -> lg.System:
    x, y = lg.coordinates("x y")
    m1, m2, g, L = lg.parameters("m1 m2 g L")
    return lg.System(m1 * x.dot**2 / 2 + m2 * y.dot**2 / 2, -m1 * g * x - m2 * g * y, constraints={"string": x + y - L})


@cache
def spun() -> lg.System:
    J1, J2, J3 = lg.parameters("J1 J2 J3")
    x, y, z = lg.rotation("R").body
    return lg.System((J1 * x**2 + J2 * y**2 + J3 * z**2) / 2, 0)


@cache
def rod() -> lg.System:
    x, y = lg.coordinates("x y")
    m, g, l = lg.parameters("m g l")
    return lg.System(m * (x.dot**2 + y.dot**2) / 2, m * g * y, constraints={"rod": x**2 + y**2 - l**2})


@cache
def pulley() -> lg.System:
    x, (m1, m2, inertia, R, g) = lg.coordinate("x"), lg.parameters("m1 m2 I R g")
    return lg.System((m1 + m2 + inertia / R**2) * x.dot**2 / 2, -(m1 - m2) * g * x)


@cache
def coupled() -> lg.System:
    x1, x2 = lg.coordinates("x1 x2")
    m1, m2, k, kappa = lg.parameters("m1 m2 k kappa")
    springs = k * (x1**2 + x2**2) / 2 + kappa * (x2 - x1) ** 2 / 2
    return lg.System(m1 * x1.dot**2 / 2 + m2 * x2.dot**2 / 2, springs)


@cache
def disc() -> lg.System:
    s, phi = lg.coordinates("s phi")
    m, inertia, R, g = lg.parameters("m I R g")
    kinetic = m * s.dot**2 / 2 + inertia * phi.dot**2 / 2
    return lg.System(kinetic, -m * g * s, constraints={"roll": s.dot - R * phi.dot})


@cache
def yoyo() -> lg.System:
    y, (m, inertia, R, g) = lg.coordinate("y"), lg.parameters("m I R g")
    return lg.System((m + inertia / R**2) * y.dot**2 / 2, -m * g * y)


@cache
def bowl() -> lg.System:
    theta, (m, R, r, g) = lg.coordinate("theta"), lg.parameters("m R r g")
    return lg.System(sp.Rational(3, 4) * m * (R - r) ** 2 * theta.dot**2, -m * g * (R - r) * sp.cos(theta))


m, g, l, M, k, R, F, c, m1, m2, l1, l2, omega, Omega, alpha, a, b, beta, gamma, I1, I3, r0, L0, ma, mb, mu = (
    lg.parameters("m g l M k R F c m1 m2 l1 l2 omega Omega alpha a b beta gamma I1 I3 r_0 L_0 m_A m_B mu")
)
theta, phi, psi, x, y, z, r, s, theta1, theta2, rho, th1, th2, q1, q2, xa, xb = lg.coordinates(
    "theta phi psi x y z r s theta1 theta2 rho theta_1 theta_2 q1 q2 x_A x_B"
)
K, sin, cos, half = lg.kinetic_energy, sp.sin, sp.cos, sp.Rational(1, 2)
polar = half * m * (r.dot**2 + r**2 * phi.dot**2)
plane = half * m * (x.dot**2 + y.dot**2)
bob = half * m * l**2 * theta.dot**2, -m * g * l * cos(theta)
inner = l1 * sin(theta1), -l1 * cos(theta1)
outer = inner[0] + l2 * sin(theta2), inner[1] - l2 * cos(theta2)
twin = k * l**2 * (sin(th1) - sin(th2)) ** 2 / 2 - m * g * l * (cos(th1) + cos(th2))
rotor = I1 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2 + I3 * (psi.dot + phi.dot * cos(theta)) ** 2 / 2
turning = half * m * ((x.dot - omega * y) ** 2 + (y.dot + omega * x) ** 2) - k * (x**2 + y**2) / 2
swinging = half * m * (r.dot**2 + r**2 * theta.dot**2)
speed = sp.sqrt(x.dot**2 + y.dot**2)
stretched = lg.spring(k, (r * cos(theta), r * sin(theta)), None, l)
swaying = a * cos(omega * lg.t) + l * sin(theta), -l * cos(theta)

TYPED: dict[str, Callable[[], lg.System]] = {
    "pendulum": lambda: lg.System(*bob),
    "damped": lambda: lg.System(*bob, dissipation=b * theta.dot**2 / 2),
    "cartesian": lambda: lg.System(plane, m * g * y, constraints={"rod": x**2 + y**2 - l**2}),
    "coupledpend": lambda: lg.System(half * m * l**2 * (th1.dot**2 + th2.dot**2), twin),
    "cone": lambda: lg.System(half * m * (r.dot**2 / sin(alpha) ** 2 + r**2 * phi.dot**2), m * g * r / sp.tan(alpha)),
    "parabola": lambda: lg.System(K(m, (x, beta * x**2)), m * g * beta * x**2),
    "top": lambda: lg.System(rotor, m * g * l * cos(theta)),
    "wedge": lambda: lg.System(K(M, (x, 0)) + K(m, (x + s * cos(alpha), -s * sin(alpha))), -m * g * s * sin(alpha)),
    "pivot": lambda: lg.System(K(m, swaying), -m * g * l * cos(theta)),
    "double_pendulum": lambda: lg.System(K(m1, inner) + K(m2, outer), g * (m1 * inner[1] + m2 * outer[1])),
    "table": lambda: lg.System(half * m1 * (r.dot**2 + r**2 * phi.dot**2) + half * m2 * r.dot**2, m2 * g * r),
    "foucault": lambda: lg.System(plane + m * Omega * (x * y.dot - y * x.dot), m * g * (x**2 + y**2) / (2 * l)),
    "duffing": lambda: lg.System(
        half * m * x.dot**2, k * x**2 / 2 + beta * x**4 / 4, forces={x: F * cos(omega * lg.t) - c * x.dot}
    ),
    "side": lambda: lg.System(half * m * x.dot**2, k * (sp.sqrt(x**2 + l**2) - r0) ** 2 / 2),
    "rhoz": lambda: lg.System(
        half * m * (rho.dot**2 + rho**2 * phi.dot**2 + z.dot**2), m * g * z + k * (rho**2 + z**2) / 2
    ),
    "yukawa": lambda: lg.System(polar, -k / sp.sqrt(r)),
    "normal": lambda: lg.System(half * m * (q1.dot**2 + q2.dot**2), k * (q1**2 + q2**2 - q1 * q2) / 2),
    "helix": lambda: lg.System(half * m * (R**2 + a**2) * phi.dot**2, m * g * a * phi),
    "cycloid": lambda: lg.System(half * m * s.dot**2, m * g * s**2 / (8 * R)),
    "AB": lambda: lg.System(
        K(ma, (xa, 0)) + K(mb, (xb, 0)), k * (xb - xa - L0) ** 2 / 2, dissipation=c * (xb.dot - xa.dot) ** 2 / 2
    ),
    "relat": lambda: lg.System(polar, gamma * r**2 / 2 - alpha / r),
    "springhoop": lambda: lg.System(K(m, (R * theta, 0)), k * R**2 * (1 - cos(theta)) - m * g * R * sin(theta)),
    "rotframe": lambda: lg.System(lagrangian=turning),
    "weighed": lambda: lg.System(half * m * y.dot**2, m * g * y, constraints={"table": y}, parameters={m: 1, g: 9.81}),
    "polar": lambda: lg.System(swinging, stretched),
    "hanging": lambda: lg.System(swinging, stretched - m * g * r * cos(theta)),
    "line": lambda: lg.System(half * m * x.dot**2, lg.spring(k, (x,), rest_length=l)),
    "two": lambda: lg.System(plane, lg.spring(k, (x, 0), (y, 0), l)),
    "friction": lambda: lg.System(half * m * x.dot**2, 0, forces={x: -mu * m * g * sp.sign(x.dot)}),
    "drag": lambda: lg.System(plane, m * g * y, forces={x: -c * speed * x.dot, y: -c * speed * y.dot}),
    "valued": lambda: lg.System(
        half * m * x.dot**2, k * (x - b) ** 2 / 2 + c * x**4, parameters={k: 30, b: 2, m: 3, c: 0}
    ),
    "sprung": lambda: lg.System(
        half * m * (theta.dot**2 + phi.dot**2),
        k * (sin(theta) - sin(phi)) ** 2 / 2 - m * g * (cos(theta) + cos(phi)),
        coordinates=[theta, phi],
    ),
}
"""Systems of answers in many styles, by name."""


@cache
def answered(name: str) -> lg.System:
    """Return the system of an answer: `scene:name`, `typed:name`, or a function of this file."""
    kind, _, rest = name.rpartition(":")
    return shared_scene(rest) if kind == "scene" else TYPED[rest]() if kind else globals()[name]()
