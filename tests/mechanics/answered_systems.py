"""Textbook systems for the tests of typed answers, each stated and derived once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import sympy as sp

import lagrange as lg
from tests.models import shared_scene

m, g, l, M, k, R, F, c, m1, m2, l1, l2, omega, Omega, alpha, a, b, beta, gamma, I1, I3, r0, L0, ma, mb, mu = (
    lg.parameters("m g l M k R F c m1 m2 l1 l2 omega Omega alpha a b beta gamma I1 I3 r_0 L_0 m_A m_B mu")
)
inertia, w, kappa, D, A, L, J1, J2, J3, r_ = lg.parameters("I w kappa D A L J1 J2 J3 r")
x1, x2, X = lg.coordinates("x1 x2 X")
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
rolled = half * m * s.dot**2 + half * inertia * phi.dot**2
body = lg.rotation("R").body
swaying = a * cos(omega * lg.t) + l * sin(theta), -l * cos(theta)

TYPED: dict[str, Callable[[], lg.System]] = {
    "oscillator": lambda: lg.System(
        half * m * x.dot**2,
        k * x**2 / 2 - m * g * x,
        forces={x: F * cos(w * lg.t)},
        dissipation=c * x.dot**2 / 2,
    ),
    "morse": lambda: lg.System(half * m * r.dot**2, D * (1 - sp.exp(-a * r)) ** 2),
    "orbit": lambda: lg.System(
        half * (m + M) * r.dot**2 + half * m * r**2 * phi.dot**2, M * g * r, coordinates=[r, phi]
    ),
    "slope": lambda: lg.System(
        half * (M + m) * X.dot**2 + half * m * s.dot**2 + m * X.dot * s.dot * cos(a), -m * g * s * sin(a)
    ),
    "cart": lambda: lg.System(K(M, x) + K(m, (x + l * sin(theta), -l * cos(theta))), -m * g * l * cos(theta)),
    "driven": lambda: lg.System(
        half * m * l**2 * theta.dot**2, -m * l * (g + A * sin(theta - gamma * lg.t)) * cos(theta)
    ),
    "floor": lambda: lg.System(plane, m * g * y, constraints={"table": y}, forces={x: -mu * m * g * sp.sign(x.dot)}),
    "rolling": lambda: lg.System(rolled, -m * g * s * sin(alpha), constraints={"rolling": s - R * phi}),
    "disc": lambda: lg.System(rolled, -m * g * s, constraints={"roll": s.dot - R * phi.dot}),
    "strung": lambda: lg.System(K(m1, x) + K(m2, y), -m1 * g * x - m2 * g * y, constraints={"string": x + y - L}),
    "spun": lambda: lg.System(half * (J1 * body[0] ** 2 + J2 * body[1] ** 2 + J3 * body[2] ** 2)),
    "rod": lambda: lg.System(plane, m * g * y, constraints={"rod": x**2 + y**2 - l**2}),
    "pulley": lambda: lg.System(half * (m1 + m2 + inertia / R**2) * x.dot**2, -(m1 - m2) * g * x),
    "yoyo": lambda: lg.System(half * (m + inertia / R**2) * y.dot**2, -m * g * y),
    "coupled": lambda: lg.System(K(m1, x1) + K(m2, x2), k * (x1**2 + x2**2) / 2 + kappa * (x2 - x1) ** 2 / 2),
    "bowl": lambda: lg.System(sp.Rational(3, 4) * m * (R - r_) ** 2 * theta.dot**2, -m * g * (R - r_) * cos(theta)),
    "pendulum": lambda: lg.System(*bob),
    "damped": lambda: lg.System(*bob, dissipation=b * theta.dot**2 / 2),
    "cartesian": lambda: lg.System(plane, m * g * y, constraints={"rod": x**2 + y**2 - l**2}),
    "coupledpend": lambda: lg.System(half * m * l**2 * (th1.dot**2 + th2.dot**2), twin),
    "cone": lambda: lg.System(
        half * m * (r.dot**2 / sin(alpha) ** 2 + r**2 * phi.dot**2), m * g * r / sp.tan(alpha), coordinates=[r, phi]
    ),
    "parabola": lambda: lg.System(K(m, (x, beta * x**2)), m * g * beta * x**2),
    "top": lambda: lg.System(rotor, m * g * l * cos(theta)),
    "wedge": lambda: lg.System(K(M, (x, 0)) + K(m, (x + s * cos(alpha), -s * sin(alpha))), -m * g * s * sin(alpha)),
    "pivot": lambda: lg.System(K(m, swaying), -m * g * l * cos(theta)),
    "double_pendulum": lambda: lg.System(K(m1, inner) + K(m2, outer), g * (m1 * inner[1] + m2 * outer[1])),
    "table": lambda: lg.System(
        half * m1 * (r.dot**2 + r**2 * phi.dot**2) + half * m2 * r.dot**2, m2 * g * r, coordinates=[r, phi]
    ),
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
    """Return the system of an answer: `scene:name`, or a name in the table of this file, also as `typed:name`."""
    kind, _, rest = name.rpartition(":")
    return shared_scene(rest) if kind == "scene" else TYPED[rest]()
