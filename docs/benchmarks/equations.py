"""The systems' equations in the hands of the rivals: heyoka's expressions, and functions of SymPy's lambdify."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import heyoka as hy
import sympy

import lagrange as lg
from lagrange.statement.coordinate import velocity_of


def plain_accelerations(system: lg.System) -> tuple[list[Any], list[Any]]:
    """Return plain symbols for [q, v], and SymPy's accelerations in them and in plain parameters."""
    names = system.statement.names
    symbols = [sympy.Symbol(name) for name in (*names, *(f"{name}_dot" for name in names))]
    moving = (*(velocity_of(q) for q in system.coordinates), *system.coordinates)
    n = len(names)
    to_plain = dict(zip(moving, (*symbols[n:], *symbols[:n]), strict=True))
    found = [expression.subs(to_plain) for expression in system.accelerations().values()]
    return symbols, [a.subs({symbol: sympy.Symbol(symbol.name) for symbol in a.free_symbols}) for a in found]


def from_sympy(system: lg.System, y: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Return SymPy's accelerations as heyoka expressions of the state y and of parameters p, in the system's order."""
    symbols, accelerations = plain_accelerations(system)
    values = dict(zip(symbols, y, strict=True))
    parameters = [sympy.Symbol(symbol.name) for symbol in system.parameters]
    values.update(zip(parameters, p, strict=True))
    return [hy.from_sympy(acceleration, s_dict=values) for acceleration in accelerations]


def accelerations_of(system: lg.System, modules: str) -> Callable[..., list[Any]]:
    """Return the accelerations as a function of the numbers of a state by lambdify(cse=True).

    `modules` is "numpy", lambdify's default, or "math" for Python's own floats, which is faster for one state.
    """
    symbols, accelerations = plain_accelerations(system)
    numbers = {sympy.Symbol(symbol.name): value for symbol, value in system.parameters.items()}
    call: Callable[..., list[Any]] = sympy.lambdify(
        symbols, [a.subs(numbers) for a in accelerations], modules=modules, cse=True
    )
    return call


def lambdified(system: lg.System, modules: str) -> Callable[[float, Any], list[float]]:
    """Return the right-hand side f(t, y) of one state by `accelerations_of`."""
    call, n = accelerations_of(system, modules), len(system.coordinates)

    def rhs(_t: float, y: Any) -> list[float]:
        numbers = y.tolist()
        return [*numbers[n:], *call(*numbers)]

    return rhs


def textbook(y: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Return the double pendulum's accelerations as heyoka expressions, those of the C file."""
    a, b, v1, v2 = y
    m1, m2, l1, l2, g = p
    s, c, s1, s2 = hy.sin(a - b), hy.cos(a - b), hy.sin(a), hy.sin(b)
    d = m1 + m2 * s * s
    return [
        -(m2 * s * (l1 * v1 * v1 * c + l2 * v2 * v2) + g * ((m1 + m2) * s1 - m2 * s2 * c)) / (l1 * d),
        (s * ((m1 + m2) * l1 * v1 * v1 + m2 * l2 * v2 * v2 * c) + (m1 + m2) * g * (s1 * c - s2)) / (l2 * d),
    ]


def from_lagrangian(y: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Return the double pendulum's accelerations as heyoka derives them from the textbook Lagrangian."""
    a, b, v1, v2 = y
    m1, m2, l1, l2, g = p
    kinetic = (m1 + m2) * (l1 * v1) ** 2 / 2 + m2 * (l2 * v2) ** 2 / 2 + m2 * l1 * l2 * v1 * v2 * hy.cos(a - b)
    potential = -(m1 + m2) * g * l1 * hy.cos(a) - m2 * g * l2 * hy.cos(b)
    found = {str(symbol): slope for symbol, slope in hy.lagrangian(kinetic - potential, [a, b], [v1, v2])}
    return [found[str(v1)], found[str(v2)]]
