"""The structure of a system: all findings with their sentences, and the blocks of random matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sympy import Abs, Piecewise, cos, exp, sin

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.equations.solve_plan import coupled
from lagrange.equations.structure import Structure
from lagrange.statement.coordinate import t
from tests.models import c, k, l, laws, m, omega, phi, r, stated, theta, x, y
from tests.series_systems import HELD


def structure(name: str) -> Structure:
    return laws(name).structure


FINDINGS = {
    #                     blocks           constant separable autonomous forced cyclic position_only
    "oscillator": (((0,),), True, True, True, False, (), True),
    "pendulum": (((0,),), True, True, True, False, (), True),
    "double pendulum": (((0, 1),), False, False, True, False, (), False),
    "elastic pendulum": (((0,), (1,)), False, False, True, False, (), False),
    "spherical pendulum": (((0,), (1,)), False, False, True, False, (1,), False),
    "cart and pole": (((0, 1),), False, False, True, True, (), False),
    "charge": (((0,), (1,), (2,)), True, False, True, False, (), False),
    "Henon-Heiles": (((0,), (1,)), True, True, True, False, (), True),
    "coupled masses": (((0, 1),), True, True, True, False, (), True),
    "8 carried masses": ((tuple(range(8)),), True, True, True, False, (), True),
    "saddle": (((0, 1), (2,)), True, True, True, False, (), True),
    "friction": (((0,), (1,)), True, True, True, True, (), False),
}


@pytest.mark.parametrize("name", FINDINGS)
def test_findings(name: str) -> None:
    result = structure(name)
    assert (
        result.blocks,
        result.constant_mass,
        result.separable,
        result.autonomous,
        result.forced,
        result.cyclic,
        result.position_only,
    ) == FINDINGS[name]
    assert result.conservative == (not result.forced)


FREE = {"kinetic": m * (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y]}


@pytest.mark.parametrize(
    ("parts", "cyclic"),
    [
        ({**FREE, "potential": k * x}, (1,)),
        ({**FREE, "potential": k * x, "forces": {y: c}}, ()),
        ({**FREE, "dissipation": c * y.dot**2}, (0,)),
        ({"kinetic": r.dot**2 + r**2 * phi.dot**2, "forces": {r: -k * r}, "coordinates": [r, phi]}, (1,)),
        ({**FREE, "kinetic": m * (x.dot + y.dot) ** 2 + m * (x.dot - y.dot) ** 2}, (0, 1)),
    ],
)
def test_a_coordinate_with_a_force_on_it_is_not_cyclic(parts: dict[str, Any], cyclic: tuple[int, ...]) -> None:
    result = euler_lagrange(stated(**parts)).structure
    assert result.cyclic == cyclic and result.blocks == ((0,), (1,))


def test_a_mass_that_depends_on_time_is_not_constant() -> None:
    assert not euler_lagrange(stated(kinetic=m * (1 + t) * theta.dot**2 * l)).structure.constant_mass


def test_explicit_time_is_found_and_time_that_cancels_is_not() -> None:
    driven = euler_lagrange(stated(kinetic=m * x.dot**2 / 2, potential=k * x * cos(omega * t)))
    assert not driven.structure.autonomous
    still = euler_lagrange(stated(kinetic=m * x.dot**2 / 2 * (sin(t) ** 2 + cos(t) ** 2)))
    assert still.structure.autonomous == (not still.lagrangian.depends & still.time.depends)
    forced = euler_lagrange(stated(kinetic=m * x.dot**2 / 2, forces={x: cos(t)}))
    assert forced.structure.autonomous and forced.structure.forced


@pytest.mark.parametrize(
    ("force", "brief"),
    [
        (cos(3 * t) * x + t**2 * sin(omega * t), False),
        (k * exp(x) + Piecewise((x, x < 1), (1, True)), False),
        (sin(t) * exp(-x) / (1 + x**2), False),
        (Piecewise((1, t < 1), (0, True)), True),
        (exp(-((t - 50) ** 2) * 100), True),
        (1 / (1 + 100 * (t - 50) ** 2), True),
        (Abs(t - 1) * x, True),
    ],
)
def test_a_force_that_may_act_briefly(force: Any, brief: bool) -> None:
    assert euler_lagrange(stated(kinetic=m * x.dot**2 / 2, forces={x: force})).structure.brief is brief
    assert euler_lagrange(stated(kinetic=m * x.dot**2 / 2, potential=force * x)).structure.brief is brief


def test_sentences_for_the_user() -> None:
    assert structure("Henon-Heiles").sentences() == [
        "The mass matrix is diagonal and constant.",
        "The momenta depend on velocities alone: all else in the Lagrangian acts as a potential.",
        "Nothing depends on time explicitly and no force acts besides the potential: the energy is conserved.",
    ]
    assert structure("spherical pendulum").sentences() == [
        "The mass matrix is diagonal and changes along the motion.",
        "The momenta depend on more than the velocities: the Lagrangian does not separate.",
        "Nothing depends on time explicitly and no force acts besides the potential: the energy is conserved.",
        "phi does not appear in L: it is cyclic, so p_phi is conserved.",
    ]
    assert structure("double pendulum").sentences()[0] == (
        "The mass matrix couples all coordinates and changes along the motion."
    )
    assert structure("coupled masses").sentences()[0] == "The mass matrix couples all coordinates and is constant."
    assert structure("saddle").sentences()[0] == "The mass matrix falls into blocks (x, y) and (z) and is constant."
    assert structure("cart and pole").sentences()[2] == "The energy is not conserved: forces or dissipation act."
    both = euler_lagrange(stated(kinetic=m * x.dot**2 / 2, potential=k * x * cos(t), forces={x: c * x.dot}))
    assert both.structure.sentences()[2] == (
        "The energy is not conserved: the Lagrangian depends on time and forces or dissipation act."
    )


def test_what_constraints_leave() -> None:
    result = {name: euler_lagrange(HELD[name]()).structure for name in ("1 rod", "3 rods", "sleigh")}
    assert result["1 rod"].sentences()[2] == (
        "The constraint constraint_1 leaves 1 of 2 velocities free. Its forces do no work."
    )
    assert result["3 rods"].sentences()[2] == (
        "The constraints constraint_1, constraint_2 and constraint_3 leave 3 of 6 velocities free. Their forces do no "
        "work."
    )
    assert result["sleigh"].sentences()[2:4] == [
        "The constraint blade leaves 2 of 3 velocities free.",
        "The energy was not found to be conserved: constraints that depend on time, or on velocities other than in "
        "proportion, may do work.",
    ]
    assert result["3 rods"].conservative and not result["sleigh"].conservative
    bent = stated(kinetic=x.dot**2 + y.dot**2, coordinates=[x, y], constraints={"speed": x.dot**2 + y.dot**2 - 1})
    assert euler_lagrange(bent).structure.sentences()[3] == (
        "The constraint speed is not linear in the velocities: its force is along its derivative in the velocities "
        "(Chetaev's rule)."
    )


@given(st.integers(1, 9), st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=9))
def test_blocks_are_the_connected_groups(n: int, pairs: list[tuple[int, int]]) -> None:
    full = np.eye(n, dtype=bool)
    for i, j in pairs:
        if i < n and j < n:
            full[i, j] = full[j, i] = True
    reached = np.linalg.matrix_power(full.astype(int), n) > 0
    expected = sorted({tuple(np.flatnonzero(row)) for row in reached})
    assert sorted(coupled([np.flatnonzero(row).tolist() for row in full])) == expected
