"""Detection of angles among the coordinates, for pictures that wrap and for sliders of a full turn."""

from __future__ import annotations

from typing import Any

import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.dynamics.axes import angles

q, x = lg.coordinates("q x")
free = (q.dot**2 + x.dot**2) / 2

CASES: dict[str, tuple[dict[str, Any], tuple[bool, bool]]] = {
    "a pendulum": ({"potential": -cos(q) + x**2}, (True, False)),
    "one on a torsion spring": ({"potential": -cos(q) + q**2}, (False, False)),
    "half an angle": ({"potential": -cos(q / 2)}, (False, False)),
    "a free one that is seen to turn": ({"positions": {"tip": (x + cos(q), sin(q))}}, (True, False)),
    "a free one": ({"positions": {"tip": (x, q)}}, (False, False)),
    "a wheel that turns as it rolls": (
        {"constraints": [x - q], "potential": x, "positions": {"tip": (x + cos(q), sin(q))}, "initial": {}},
        (False, False),
    ),
}


@pytest.mark.parametrize("what", CASES)
def test_a_turn_of_an_angle_changes_nothing(what: str) -> None:
    stated, result = CASES[what]
    assert angles(lg.System(kinetic=free, coordinates=[q, x], **stated).statement) == result
