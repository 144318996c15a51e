"""A mass matrix that has no inverse anywhere is refused when the system is stated, with the motion without inertia."""

from __future__ import annotations

from typing import Any

import pytest
import sympy as sp
from sympy import cos, sin

from lagrange.compiler import reached
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.equations.regularity import check_regularity
from lagrange.errors import StatementError
from tests.models import SYSTEMS, M, k, laws, m, stated, theta, x, y, z


def checked(equations: Equations) -> None:
    check_regularity(equations, reach=reached)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_sound_system_passes(name: str) -> None:
    checked(laws(name))


NO_TERM = "the Lagrangian has no term of second order in {0}.dot, so {0} has no inertia"
SINGULAR = "the mass matrix d2L/dv2 is singular"
SLIDING, STRING = m * (x.dot - y.dot) ** 2 / 2, m * (x.dot + y.dot) ** 2 / 2 + m * (y.dot + z.dot) ** 2 / 2


@pytest.mark.parametrize(
    ("given", "coordinates", "words"),
    [
        (
            {"kinetic": m * x.dot**2 / 2, "potential": k * (x - y) ** 2 / 2},
            [x, y],
            ["the kinetic energy does not contain y.dot, so y has no inertia", "make y a parameter"],
        ),
        ({"lagrangian": -k * x**2}, [x], ["does not contain x.dot, so x has no inertia"]),
        ({"lagrangian": x.dot * sin(x) - x**2}, [x], [NO_TERM.format("x"), "its acceleration is not determined"]),
        ({"lagrangian": x.dot * sin(x) - x**2}, [x], ["Add the kinetic energy of x, or make x a parameter."]),
        ({"lagrangian": m * x.dot**2 / 2 + y.dot * sin(x) - k * y**2}, [x, y], [NO_TERM.format("y")]),
        ({"kinetic": (x.dot + y.dot) ** 2}, [x, y], [SINGULAR, "with x.dot = 1, y.dot = -1 has no inertia"]),
        ({"kinetic": (x.dot + y.dot) ** 2}, [x, y], ["Add the kinetic energy that is missing, or use fewer coordin"]),
        ({"kinetic": m * (x.dot + 2 * y.dot) ** 2 / 2}, [x, y], ["x.dot = 1, y.dot = -0.5 has no inertia"]),
        ({"kinetic": SLIDING + M * z.dot**2 + theta.dot**2}, [z, x, theta, y], ["x.dot = 1, y.dot = 1 has no inertia"]),
        ({"kinetic": STRING}, [x, y, z], ["x.dot = 1, y.dot = -1, z.dot = 1 has no inertia"]),
        ({"kinetic": m * (x.dot * cos(x) + y.dot * sin(y)) ** 2}, [x, y], [SINGULAR, "a motion with x.dot = "]),
    ],
)
def test_a_motion_without_inertia_is_named(given: dict[str, Any], coordinates: list[Any], words: list[str]) -> None:
    with pytest.raises(StatementError) as raised:
        checked(euler_lagrange(stated(**given, coordinates=coordinates)))
    assert all(word in str(raised.value) for word in words)
    assert len(coordinates) < 4 or not {"z.dot", "theta.dot"} & set(str(raised.value).split())


@pytest.mark.parametrize(
    "kinetic",
    [
        m * sin(x) ** 2 * y.dot**2 / 2 + m * x.dot**2 / 2,
        m * (x.dot + y.dot) ** 2 / 2 + M * x**2 * y.dot**2,
        m * (x.dot + y.dot) ** 2 / 2 + M * sp.Float("1e-9") * y.dot**2,
        x.dot * y.dot * m,
        sp.Float("1e-12") * x.dot**2 + sp.Float("5e-10") * x.dot * y.dot + sp.Float("1e12") * y.dot**2,
        # Defined nowhere that is looked at: there is no verdict.
        sp.Piecewise((m * (x.dot + y.dot) ** 2 / 2 + m * x.dot**2, x > 100)),
    ],
)
def test_singular_somewhere_and_units_that_differ_are_no_reason_to_refuse(kinetic: Any) -> None:
    checked(euler_lagrange(stated(kinetic=kinetic, coordinates=[x, y])))
