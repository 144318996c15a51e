"""Energies of standard parts, such as springs and rods."""

from __future__ import annotations

from typing import Any

import pytest
import sympy
from sympy import cos, sin

import lagrange as lg
from lagrange.statement.coordinate import coordinates, parameters
from lagrange.statement.declare import declare
from lagrange.statement.energy import gravity, kinetic_energy, rotational_energy, spring
from tests.refusals import nested, refusal

x, y, theta = coordinates("x y theta")
m, g, l, k, a = parameters("m g l k a")
w1, w2, w3 = parameters("w1 w2 w3")
i1, i2, i3 = parameters("i1 i2 i3")


def zero(expression: Any) -> bool:
    return bool(sympy.simplify(expression) == 0)


def test_kinetic_energy_squares_the_velocity() -> None:
    assert kinetic_energy(m, [x, y]) == m * (x.dot**2 + y.dot**2) / 2
    assert kinetic_energy(m, (x,)) == kinetic_energy(m, x) == m * x.dot**2 / 2
    assert zero(kinetic_energy(m, [l * sin(theta), -l * cos(theta)]) - m * l**2 * theta.dot**2 / 2)
    assert kinetic_energy(2, sympy.Matrix([x, y, 3, 0.5])) == x.dot**2 + y.dot**2


def test_rotational_energy_of_a_scalar_of_moments_and_of_a_tensor() -> None:
    assert rotational_energy(i1, theta.dot) == i1 * theta.dot**2 / 2
    assert zero(rotational_energy([i1, i2, i3], [w1, w2, w3]) - (i1 * w1**2 + i2 * w2**2 + i3 * w3**2) / 2)
    assert zero(rotational_energy(i1, [w1, w2]) - i1 * (w1**2 + w2**2) / 2)
    tensor = [[i1, k], [k, i2]]
    expected = (i1 * w1**2 + 2 * k * w1 * w2 + i2 * w2**2) / 2
    assert zero(rotational_energy(tensor, [w1, w2]) - expected)
    assert zero(rotational_energy(sympy.Matrix(tensor), sympy.Matrix([w1, w2])) - expected)
    assert zero(rotational_energy(sympy.Matrix([i1, i2]), [w1, w2]) - (i1 * w1**2 + i2 * w2**2) / 2)


def test_gravity_takes_the_height_along_up() -> None:
    assert gravity(m, [x, y], g) == m * g * y
    assert gravity(m, [x, y, theta], g) == m * g * theta
    assert gravity(m, [x, y], g, up=[1, 0]) == m * g * x
    assert gravity(m, [x, y], g, up=(0, -2)) == -m * g * y
    assert zero(gravity(m, [x, y], g, up=[3, 4]) - m * g * (3 * x + 4 * y) / 5)
    assert gravity(m, x, g) == m * g * x


def test_a_spring_has_a_rest_length() -> None:
    assert spring(k, [x, y], [0, 0]) == k * (x**2 + y**2) / 2
    assert zero(spring(k, [x, y], [0, 0], l) - k * (sympy.sqrt(x**2 + y**2) - l) ** 2 / 2)
    assert spring(k, x, y) == k * (x - y) ** 2 / 2
    assert spring(k, [x, y], [1, 2], 0.0) == k * ((x - 1) ** 2 + (y - 2) ** 2) / 2


def test_a_spring_with_one_end_goes_to_the_origin() -> None:
    assert spring(k, x) == k * x**2 / 2
    assert spring(k, [x, y], rest_length=l) == spring(k, [x, y], [0, 0], l)


def test_a_rate_may_be_made_of_an_angle() -> None:
    assert rotational_energy(i1, k * sympy.sin(x)) == i1 * k**2 * sympy.sin(x) ** 2 / 2
    assert rotational_energy(i1, k * x + y.dot) == i1 * (k * x + y.dot) ** 2 / 2
    assert rotational_energy(i1, k * lg.t + y.dot) == i1 * (k * lg.t + y.dot) ** 2 / 2
    assert rotational_energy(i1, sympy.sin(x) / 2) == i1 * sympy.sin(x) ** 2 / 8
    assert rotational_energy(i1, sympy.sin(x) * y.dot) == i1 * sympy.sin(x) ** 2 * y.dot**2 / 2
    assert rotational_energy(i1, [k, lg.given("w")]) == i1 * k**2 / 2 + i1 * lg.given("w") ** 2 / 2


def test_what_is_stated_is_real() -> None:
    assert declare(kinetic=x.dot**2, potential=sympy.Abs(sympy.exp(k * x))).potential == sympy.exp(k * x)
    assert declare(kinetic=x.dot**2, potential=sympy.Abs(x * sympy.exp(x))).potential == sympy.Abs(x) * sympy.exp(x)
    shortened = declare(kinetic=kinetic_energy(m, sympy.Abs(x) * sympy.exp(x))).kinetic
    slope = sympy.exp(x) * (sympy.Abs(x) + sympy.sign(x))
    assert zero(shortened - m * (slope * x.dot) ** 2 / 2)


REFUSALS: list[tuple[Any, str]] = [
    (lambda: kinetic_energy(m, "x"), "the position is the text 'x': give SymPy expressions."),
    (lambda: kinetic_energy(m, (y, x.dot)), "the position contains x.dot, a rate: give the place in x, or write the"),
    (lambda: kinetic_energy(m, y * x.ddot), "the position contains x.ddot, an acceleration: give the place in x"),
    (lambda: kinetic_energy(m, (nested(x, 350), y)), "nested too deeply for SymPy: give symbols to its inner parts"),
    (lambda: kinetic_energy(m, []), "the position is empty: give at least one component."),
    (
        lambda: gravity(m, [x, y], g, up=[0, 0, 1]),
        "up has 3 components and the position 2: give both the same number of components.",
    ),
    (lambda: rotational_energy(i1, x), "the angular velocity is x, an angle: give its rate, such as x.dot."),
    (lambda: rotational_energy(i1, y.dot + x), "the angular velocity has the term x, an angle: give its rate, such as"),
    (lambda: rotational_energy(i1, x.dot * (y + x.dot)), "has the term x.dot**2 in x.dot*(x.dot + y), a product of"),
    (lambda: rotational_energy(i1, sympy.sin(x)), "the angular velocity is sin(x), a number without a rate: give its"),
    (lambda: rotational_energy(i1, y.dot + k / l * sympy.sin(x)), "the angular velocity has the term k*sin(x)/l, a nu"),
    (lambda: rotational_energy(i1, [0, 0, x.ddot]), "component 2 of the angular velocity contains x.ddot, an accelera"),
    (lambda: rotational_energy(i1, k * lg.t), "the angular velocity is k*t, an angle or its function: give its rate,"),
    (lambda: rotational_energy(i1, y.dot + x.dot**2), "the angular velocity has the term x.dot**2, a product of"),
    (lambda: rotational_energy(i1, [0, 0, lg.rotation("R").body[2] ** 2]), "the term R_body_z**2, a product of rates"),
    (lambda: rotational_energy([1, -2, 1], [w1, w2, w3]), "the inertia has the moment -2 below zero, which no body"),
    (lambda: rotational_energy([[1, 2], [2, 1]], [w1, w2]), "the inertia has a principal moment below zero"),
    (lambda: rotational_energy([[i1, k], [0, i2]], [w1, w2]), "the inertia is not symmetric: entry (0, 1) is k, and"),
    (
        lambda: spring(k, [x, y], [0]),
        "the ends of the spring have 2 and 1 components: give both the same number of components.",
    ),
]


@pytest.mark.parametrize(("call", "message"), REFUSALS, ids=[message[:30] for _, message in REFUSALS])
def test_refusals(call: Any, message: str) -> None:
    assert message in refusal(call)
