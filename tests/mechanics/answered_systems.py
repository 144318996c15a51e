"""Systems of textbooks whose equations are typed in the tests of answers, each stated and derived once."""

from __future__ import annotations

from functools import cache

import sympy as sp

import lagrange as lg


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
