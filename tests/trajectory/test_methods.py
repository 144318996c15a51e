"""Each method is tested against its formula and its claims: order, symplecticity, symmetry, energy, and refusals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.implicit import BITS, gauss_tableau
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.splitting import Splitting, composition
from tests.models import build, model, x, y
from tests.trajectory.runs import ADAPTIVE, MOMENTA, SPLITTINGS, STEPPED, exact, implicit, run

# --- claims ---------------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("name", ADAPTIVE)
def test_errors_follow_the_tolerance(name: str) -> None:
    compiled = model("double pendulum")
    truth = exact(compiled, 3.0).y[:, -1]
    tolerances = (1e-5, 1e-7, 1e-9, 1e-11)
    errors = []
    for rtol in tolerances:
        result = run(compiled, 3.0, name, rtol=rtol, atol=rtol)
        errors.append(np.abs(result.y[:, -1] - truth).max())
        assert errors[-1] < 300 * rtol
    # The order of a series follows the tolerance, and with it the ratio of error to tolerance, up or down.
    least = 10 if name in STEPPED else 5
    assert all(b < a / least for a, b in itertools.pairwise(errors)), errors


# --- splitting ------------------------------------------------------------------------------------------------
# Splittings: their coefficients, held to what they claim, and where they are refused.


def test_the_parts_of_a_splitting_add_up_to_a_step() -> None:
    with pytest.raises(
        StatementError, match=r"the kicks of half add up to 0\.5: these fractions of the step must add up to 1"
    ):
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
    """A user's composition: Suzuki's five steps of order 4."""
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
    with pytest.raises(StatementError, match="first = 'push': give 'drift' or 'kick'"):
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


# --- gauss ----------------------------------------------------------------------------------------------------
# Coefficients of collocation to all the digits that they are kept in, twice those of a double and more.
#
# A coefficient that is wrong in its seventeenth digit shows in no order of convergence, only in what drifts over
# millions of steps.

CLOSE = Fraction(1, 2 ** (BITS - 10))
"""Some thousand roundings to so many bits."""


def moments(weights: Sequence[Any], points: Sequence[Any], end: Any, most: int) -> list[Any]:
    """Return the errors of a quadrature for the integrals of 1, x, x^2, ... from 0 to `end`."""
    pairs = list(zip(weights, points, strict=True))
    return [abs(sum(w * x**k for w, x in pairs) - end ** (k + 1) / Fraction(k + 1)) for k in range(most)]


@pytest.mark.parametrize("stages", [1, 2, 3, 4, 5])
def test_gauss_integrates_twice_as_many_powers_as_it_has_stages(stages: int) -> None:
    A, b, c = gauss_tableau(stages)
    assert all(isinstance(entry, Fraction) for entry in (*b, *c, *(entry for row in A for entry in row)))
    assert max(moments(b, c, Fraction(1), 2 * stages)) < CLOSE
    assert moments(b, c, Fraction(1), 2 * stages + 1)[-1] > Fraction(1, 10**7)
    assert max(miss for row, end in zip(A, c, strict=True) for miss in moments(row, c, end, stages)) < CLOSE
    assert [float(x) for x in c] == pytest.approx((1 + np.polynomial.legendre.leggauss(stages)[0]) / 2, rel=1e-15)


# --- rounding errors of long runs -----------------------------------------------------------------------------
# Long runs of implicit methods with equal steps: errors of invariants grow only by random rounding.
#
# By Brouwer's law the error of an invariant is then a random walk: some units of round-off times the square root of the
# number of steps. An error of the same sign at each step would grow in proportion to the number of steps.


STEPS = 200_000


def end_of(compiled: Model, name: str, step: float, start: Any) -> Any:
    """Return the state after many steps, without storing them."""
    problem = Problem(compiled, compiled.parameter_values(), 0.0, step * STEPS, start)
    driver = replace(implicit(name), step=step).plan(problem).driver(compiled, compiled.parameter_array())
    state = DriverState(0.0, step * STEPS, start, 1e-6, 1e-6, step)
    state.counts[DriverState.RECORD] = 0
    driver.adopt(state)
    assert driver.advance(state, STEPS, np.empty(0), np.empty((0, len(start)))) in (Outcome.DONE, Outcome.PAUSED)
    assert state.count(DriverState.STEPS) == STEPS
    return state.y


def walked(errors: Any) -> float:
    """Return the root mean square of errors in units of round-off times the root of the number of steps."""
    return float(np.sqrt(np.mean(np.square(errors))) / 2.0**-53 / np.sqrt(STEPS))


def allowed(name: str) -> float:
    """Each step computes the momentum from a rounded velocity, with an error of half a unit of round-off."""
    return 2.0 if name in MOMENTA else 0.4


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "name", ["implicit-midpoint", "gauss2", "gauss3", "variational-midpoint", "galerkin4", "galerkin6"]
)
def test_angular_momentum_walks_at_random(name: str) -> None:
    """Methods with Gauss's points conserve angular momentum exactly, for any step size.

    Without compensated sums the measured errors were 0.7 (gauss3) and 50 (galerkin6).
    """
    compiled = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sp.sqrt(x**2 + y**2), coordinates=[x, y])
    errors, rng = [], np.random.default_rng(7)
    for _ in range(8):
        e, turn = rng.uniform(0.1, 0.5), rng.uniform(0.0, 6.0)
        place, speed = 1 - e, np.sqrt((1 + e) / (1 - e))
        start = np.array([place * np.cos(turn), place * np.sin(turn), -speed * np.sin(turn), speed * np.cos(turn)])
        result = [moment(state) for state in (start, end_of(compiled, name, 0.01, start))]
        errors.append(float(result[1] / result[0] - 1))
    assert walked(errors) < allowed(name)


def moment(state: Any) -> Any:
    a, b, c, d = state.astype(np.longdouble)
    return a * d - b * c


def test_one_symplectic_euler_method_kicks_first_and_the_other_drifts_first() -> None:
    oscillator, h = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0}), 0.125
    for name, expected in (("symplectic-euler", [1 - h**2, -h]), ("symplectic-euler-b", [1.0, -h])):
        assert run(oscillator, h, name, step=h).y[:, -1] == pytest.approx(expected, abs=1e-15)
