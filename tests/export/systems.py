"""Systems that tests of several targets share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest
from sympy import cos

import lagrange as lg
from tests.models import SCENE_NAMES


def every_scene(*few: str) -> list[Any]:
    """Return the names of all scenes as test parameters; a run without --conformance takes a few of them."""
    return [pytest.param(name, marks=[pytest.mark.conformance] * (name not in few)) for name in SCENE_NAMES]


def held(system: lg.System) -> list[str]:
    """Return the optional contents that this system has."""
    statement = system.statement
    result = {
        "multipliers": bool(statement.constraints),
        "positions": bool(statement.positions),
        "energies": not statement.lagrangian_alone,
    }
    return [name for name, there in result.items() if there]


def named(coordinates: Sequence[str], parameters: Sequence[str], name: str = "named") -> lg.System:
    """Return coupled pendulums whose coordinates and parameters have given names."""
    q = [lg.coordinates(item) for item in coordinates]
    p = [lg.parameters(item) for item in parameters]
    kinetic = sum((1 + k) * item.dot**2 / 2 for k, item in enumerate(q))
    coupled = sum(a.dot * b.dot * cos(a - b) / 4 for a, b in pairwise(q))
    return lg.System(
        kinetic=kinetic + coupled,
        potential=sum(item * (1 - cos(q[k % len(q)] * (1 + k / 8))) for k, item in enumerate(p)),
        coordinates=q,
        parameters={item: 1 + k / 16 for k, item in enumerate(p)},
        initial={item: 0.5 - k / 32 for k, item in enumerate(q)},
        name=name,
    )
