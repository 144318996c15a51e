"""Each step as it was written, in many digits: its order, its symmetry and what it conserves, as they are claimed."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp

from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.program.step import StepProgram
from lagrange.statement.coordinate import t
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.tableaux.verner9 import MATRIX, B
from tests.covering import Share
from tests.models import TARGETS, build, laws, model, phi, statement_of, theta
from tests.trajectory.precisely import (
    DIGITS,
    DOUBLE_PENDULUM,
    DRIVEN_PENDULUM,
    HENON_HEILES,
    KEPLER,
    Law,
    Rhs,
    array,
    precise_step,
)
from tests.trajectory.runs import FIXED, IMPLICIT, MOMENTA, SPLITTINGS, STEPPED, planned, run, stepped

EXPLICIT = tuple(name for name in STEPPED if find(name).claims.explicit)
SOLVED = tuple(name for name in IMPLICIT if name != "bdf2")
"""The implicit methods that are maps of one state."""

PROBLEM = Problem(model("oscillator"), {}, 0.0, 1.0, np.zeros(2))
COARSE = {True: 2, False: 1}
"""A step that is long enough for order 9 to be visibly not symplectic; an implicit one has to converge."""


def program(name: str) -> StepProgram:
    """Return the step of a method, without step control where it can do without."""
    made: Any = stepped(name, 1.0).plan(PROBLEM) if name in EXPLICIT else planned(name, PROBLEM)
    step: StepProgram = made.step
    return step


PRECISE = [
    *(
        (name, law)
        for name in EXPLICIT
        for law in (DRIVEN_PENDULUM, HENON_HEILES if name in SPLITTINGS else DOUBLE_PENDULUM)
    ),
    *((name, DRIVEN_PENDULUM) for name in SOLVED),
]


def verner9_in_digits(f: Rhs, t: Any, y: Any, h: Any) -> Any:
    """The step with the coefficients as they are published: rounded to doubles they hide its order."""
    slopes: list[Any] = []
    for words in map(str.split, MATRIX):
        row = [mpmath.mpf(word) for word in words]
        moved = sum((a * s for a, s in zip(row, slopes, strict=True) if a), y * 0)
        slopes.append(f(t + sum(row) * h, y + h * moved))
    return y + h * sum(mpmath.mpf(b) * s for b, s in zip(B.split(), slopes, strict=True))


@pytest.mark.few
@pytest.mark.parametrize(("name", "law"), PRECISE)
def test_the_order_without_round_off(name: str, law: Law, everything: bool) -> None:
    """At 60 digits, one step less two of half the size is of order p + 1, in the mean over some places.

    What is measured approaches p as the step goes to 0, in proportion to it, and is extrapolated by that. It ends
    where the coefficients are felt that were rounded to doubles.
    """
    step = program(name)
    if name == "verner9":
        step, floor = replace(step, function=verner9_in_digits), 1e-25
    else:
        floor = 3e-16
    rng, changes = np.random.default_rng(1), []
    with mpmath.workdps(DIGITS):
        size = 2 if law is DRIVEN_PENDULUM else 4
        count = 2 if name not in EXPLICIT else 6 if everything else 3
        starts = [array(map(mpmath.mpf, rng.uniform(-0.5, 0.5, size))) for _ in range(count)]
        for power in range(1, 10):
            t, h = mpmath.mpf("0.3"), mpmath.mpf(2) ** -power
            total = mpmath.mpf(0)
            for y in starts:
                half = precise_step(step, law, t + h / 2, precise_step(step, law, t, y, h / 2), h / 2)
                total += sum((precise_step(step, law, t, y, h) - half) ** 2)
            if mpmath.sqrt(total) < floor * h:
                break
            changes.append(mpmath.sqrt(total))
        orders = [float(mpmath.log(a / b, 2)) - 1 for a, b in itertools.pairwise(changes)]
    assert len(orders) >= 2
    assert 2 * orders[-1] - orders[-2] == pytest.approx(find(name).claims.order, abs=0.15), orders


def canonical_step(step: StepProgram, law: Law, y: Any, h: Any, *, lagrange: bool) -> Any:
    """Take a step from y = [q, p] at t = 0: by Hamilton's equations or, with `lagrange`, by those in velocities."""
    zero = mpmath.mpf(0)
    if not lagrange:
        return precise_step(step, law.canonical, zero, y, h)
    q, p = np.split(y, 2)
    q, v = np.split(precise_step(step, law, zero, np.concatenate([q, law.velocities(q, p)]), h), 2)
    return np.concatenate([q, law.mass(q) @ v])


def defect(name: str, law: Law, *, lagrange: bool) -> float:
    """Return how far J^T W J is from W, for the Jacobian J of a step in (q, p).

    Central differences of 1e-20 leave some 1e-40.
    """
    step, d = program(name), mpmath.mpf(10) ** -20
    with mpmath.workdps(DIGITS):
        y, h, columns = law.start, mpmath.mpf(COARSE[name in EXPLICIT]), []
        for e in np.eye(len(y), dtype=int):
            there, back = (canonical_step(step, law, y + side * d * e, h, lagrange=lagrange) for side in (1, -1))
            columns.append((there - back) / (2 * d))
        jacobian = np.array(columns).T
        w = np.kron(np.array([[0, 1], [-1, 0]]), np.eye(len(y) // 2, dtype=int))
        return float(np.abs(jacobian.T @ w @ jacobian - w).max())


EACH = [
    (name, law)
    for name in (*EXPLICIT, *SOLVED)
    for law in (DRIVEN_PENDULUM, HENON_HEILES, DOUBLE_PENDULUM)
    if law is not DOUBLE_PENDULUM or name not in SPLITTINGS
]


@pytest.mark.few
@pytest.mark.parametrize(("name", "law"), EACH)
def test_the_step_itself_is_symplectic_or_clearly_not(name: str, law: Law) -> None:
    """Methods of slopes get Hamilton's equations, where kinetic energy and potential need not separate."""
    error = defect(name, law, lagrange=program(name).law != "rhs")
    if find(name).claims.symplectic:
        # The fractions of a splitting are doubles, and each of its flows is symplectic; Gauss's numbers have 60 digits.
        assert error < (1e-12 if name in EXPLICIT else 1e-38)
    else:
        assert error > 1e-6


@pytest.mark.parametrize("name", [name for name in SOLVED if find(name).claims.symplectic and name not in MOMENTA])
def test_in_velocities_a_method_of_slopes_is_not_symplectic_where_the_mass_matrix_moves(name: str) -> None:
    assert defect(name, DOUBLE_PENDULUM, lagrange=True) > 1e-6


@pytest.mark.parametrize("name", [*EXPLICIT, *SOLVED])
def test_a_step_back_undoes_a_step_where_that_is_claimed(name: str) -> None:
    law = DOUBLE_PENDULUM if name in MOMENTA else HENON_HEILES
    with mpmath.workdps(DIGITS):
        h = mpmath.mpf(1)
        there = precise_step(program(name), law, mpmath.mpf(0), law.start, h)
        error = float(max(abs(precise_step(program(name), law, h, there, -h) - law.start)))
    if find(name).claims.symmetric:
        assert error < 1e-50
    else:
        assert error > 1e-12


@pytest.mark.parametrize("name", [*EXPLICIT, *SOLVED])
def test_what_is_symplectic_conserves_angular_momentum(name: str) -> None:
    """Noether's theorem for steps: an action that rotations leave alone; Marsden and West, 2001, section 1.3.3."""
    with mpmath.workdps(DIGITS):
        start = KEPLER.start
        end = precise_step(program(name), KEPLER, mpmath.mpf(0), start, mpmath.mpf(COARSE[name in EXPLICIT]) / 4)
        error = float(abs(moment(end) - moment(start)))
    if find(name).claims.symplectic:
        assert error < 1e-50
    else:
        assert error > 1e-12


def moment(y: Any) -> Any:
    return y[0] * y[3] - y[1] * y[2]


@pytest.mark.parametrize("name", [*EXPLICIT, *SOLVED])
def test_what_claims_to_conserve_energy_does_so_in_a_step(name: str) -> None:
    """The energy of Henon and Heiles is a cubic, on which the quadrature of a mean gradient is exact."""
    with mpmath.workdps(DIGITS):
        start = HENON_HEILES.start
        end = precise_step(program(name), HENON_HEILES, mpmath.mpf(0), start, mpmath.mpf(1) / 2)
        error = float(abs(energy(end) - energy(start)))
    if find(name).claims.energy:
        assert error < 1e-50
    else:
        assert error > 1e-12


def energy(state: Any) -> Any:
    x, y, vx, vy = state
    return (vx**2 + vy**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3


@cache
def compiled(law: Law, target: str) -> Model:
    """Return the model of a law, stated by its energies."""
    a, b = theta, phi
    if law is DRIVEN_PENDULUM:
        return build(target, kinetic=a.dot**2 / 2, potential=-(1 + t) * sp.cos(a))
    if law is HENON_HEILES:
        return model_of(statement_of("Henon-Heiles"), machine(target), laws("Henon-Heiles"))
    kinetic = a.dot**2 + b.dot**2 / 2 + a.dot * b.dot * sp.cos(a - b)
    return build(target, kinetic=kinetic, potential=-2 * sp.cos(a) - sp.cos(b), coordinates=[a, b])


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("name", "law"), [(name, law) for name, law in EACH if name in EXPLICIT or name in FIXED])
def test_the_compiled_step_is_the_step_that_was_written(name: str, law: Law, target: str, share: Share) -> None:
    """So that what is proven of the step in many digits holds for the one that runs, to round-off."""
    model = compiled(law, target)
    start, worst = np.array(law.start, dtype=float), 0.0
    names = (*model.statement.names, *(f"{name}_dot" for name in model.statement.names))
    rng = np.random.default_rng(4)
    method = stepped(name, 0.125)
    for _ in range(share(8)):
        y = start + rng.uniform(-0.1, 0.1, len(start))
        found = run(model, 0.125, method, initial=dict(zip(names, y, strict=True)))
        assert found.steps == 1
        with mpmath.workdps(DIGITS):
            exact = precise_step(program(name), law, mpmath.mpf(0), array(map(mpmath.mpf, y)), mpmath.mpf(1) / 8)
            worst = max(worst, float(max(abs(array(found.y[:, -1]) - exact))))
    # The state is rounded once, and what it is made of with some units of less than itself: no more than two ulps.
    assert worst < 4 * 2.0**-53
