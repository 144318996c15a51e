"""Splittings: their coefficients, held to what they claim, and where they are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lagrange.errors import StatementError
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.splitting import Splitting, composition
from tests.models import model
from tests.trajectory.runs import SPLITTINGS, exact, run


def test_the_parts_of_a_splitting_add_up_to_a_step() -> None:
    with pytest.raises(StatementError, match=r"the kicks of half add up to 0\.5: they must add up to one step"):
        Splitting("half", 1, ((0.5, 1.0),))
    with pytest.raises(StatementError, match=r"the drifts of half add up to 2"):
        Splitting("half", 1, ((1.0, 2.0),))
    with pytest.raises(StatementError, match=r"the kicks of half add up to nan"):
        Splitting("half", 1, ((math.nan, 1.0),))


@pytest.mark.few
@pytest.mark.parametrize("name", SPLITTINGS)
def test_a_splitting_is_of_no_higher_order_than_it_claims_and_holds_every_coefficient(name: str) -> None:
    method = find(name)
    assert isinstance(method, Splitting)
    with pytest.raises(StatementError, match=f"{name} is not of order {method.order + 1}: the coefficient of"):
        replace(method, order=method.order + 1)
    if method.order > 1:
        for i in range(len(method.stages) - 1):
            (kick, drift), (later_kick, later_drift) = method.stages[i : i + 2]
            moved = ((kick + 1e-9, drift - 1e-9), (later_kick - 1e-9, later_drift + 1e-9))
            with pytest.raises(StatementError, match="is not of order"):
                replace(method, stages=(*method.stages[:i], *moved, *method.stages[i + 2 :]))


def test_symmetry_is_read_off_the_coefficients() -> None:
    assert not Splitting("late", 1, ((0.25, 1.0), (0.75, 0.0))).symmetric
    assert Splitting("apart", 2, ((0.25, 0.0), (0.25, 1.0), (0.5, 0.0))).symmetric, "kicks in a row are one kick"
    assert [name for name in SPLITTINGS if not find(name).claims.symmetric] == [
        "symplectic-euler", "symplectic-euler-b", "ruth3",
    ]  # fmt: skip


def test_a_composition_of_ones_own() -> None:
    """Suzuki's five steps of order 4, from either end of a Verlet step."""
    outer = 1 / (4 - 4 ** (1 / 3))
    sizes = (outer, outer, 1 - 4 * outer, outer, outer)
    compiled = model("Henon-Heiles")
    truth = exact(compiled, 3.0).y[:, -1]
    for first in ("drift", "kick"):
        method = composition(sizes, name="suzuki", order=4, first=first)
        assert method.symmetric
        errors = [np.abs(run(compiled, 3.0, method, step=3.0 / n).y[:, -1] - truth).max() for n in (40, 57, 80)]
        assert -np.polyfit(np.log([40, 57, 80]), np.log(errors), 1)[0] == pytest.approx(4, abs=0.15)
    with pytest.raises(StatementError, match="suzuki is not of order 6: the coefficient of"):
        composition(sizes, name="suzuki", order=6)
    with pytest.raises(StatementError, match="first = 'push': a composition starts with a 'drift' or a 'kick'"):
        composition(sizes, name="suzuki", order=4, first="push")
    with pytest.raises(StatementError, match="the composition none has no coefficients: give at least one"):
        composition((), name="none", order=2)


def test_the_last_force_of_a_step_is_the_first_of_the_next() -> None:
    compiled = model("Henon-Heiles")
    for name, calls in {
        "verlet": 11,
        "velocity-verlet": 12,
        "leapfrog": 12,
        "yoshida6": 71,
        "composition8": 171,
    }.items():
        assert run(compiled, 1.0, name, step=0.1).evaluations == calls
