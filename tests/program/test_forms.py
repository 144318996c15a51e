"""Forms of the equations of motion for series: what several coordinates share is taken from each once."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from sympy import cos, exp

from lagrange.compiler import machine
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.program.catalogue import program_of
from lagrange.program.taylor import series_program
from lagrange.statement.coordinate import t
from tests.models import stated, x, y, z


@pytest.mark.parametrize(
    "order", list(permutations([x, y, z])), ids=lambda order: "".join(q.func.__name__ for q in order)
)
@pytest.mark.parametrize("sign", [1, -1])
def test_one_force_on_several_coordinates_whose_momenta_add_up(sign: int, order: Any) -> None:
    """The momentum of z is the sum of those of x and y, while the force on each of the three is the same."""
    kinetic = exp(t) * (x.dot + z.dot) ** 2 / 2 + exp(2 * t) * (y.dot + z.dot) ** 2 / 2 + z.dot**2 / 2
    statement = stated(lagrangian=kinetic + sign * cos(x + y + z), coordinates=list(order), initial={x: 0.3})
    equations = euler_lagrange(statement)
    state, none = np.array([0.3, 0.2, 0.4, 0.5, -0.3, 0.2]), np.empty(0)
    rows = NumpySeries(series_program(equations)[0]).rows(2, 0.3, state, 1.0, none)
    expected = machine("numpy").load(program_of("rhs", equations))(0.3, state, none)
    assert rows[1] == pytest.approx(expected, rel=1e-13, abs=1e-13)
