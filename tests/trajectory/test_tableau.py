"""Butcher tableaus: claims hold, and a wrong tableau is refused with the violated condition and its error."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate
import sympy as sp

from lagrange.compiler import machine, model_of
from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.program.step import StepProgram
from lagrange.statement.coordinate import t
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.tableaux.butcher import (
    ButcherTableau,
    DenseOutput,
    ErrorEstimate,
    row,
    triangle,
)
from lagrange.trajectory.tableaux.explicit import (
    BS3,
    EULER,
    HEUN,
    MIDPOINT,
    RK4,
    VERNER_MATRIX,
    VERNER_WEIGHTS,
    dop853,
    dopri5,
    tsit5,
    verner9,
)
from tests.covering import Share
from tests.models import TARGETS, build, laws, model, phi, statement_of, theta
from tests.trajectory.precisely import (
    DIGITS,
    DOUBLE_PENDULUM,
    DRIVEN_PENDULUM,
    HENON_HEILES,
    Law,
    Rhs,
    array,
    precise_step,
)
from tests.trajectory.runs import FIXED, IMPLICIT, MOMENTA, SPLITTINGS, STEPPED, planned, run, stepped

ALL = (EULER, HEUN, MIDPOINT, RK4, BS3, dopri5(), tsit5(), dop853(), verner9())


def test_the_error_weights_are_those_of_scipy() -> None:
    fifth, eighth = dopri5().error, dop853().error
    assert fifth and eighth
    # The sign of an error does not matter.
    theirs = -scipy.integrate.RK45.E, scipy.integrate.DOP853.E5, scipy.integrate.DOP853.E3
    for ours, expected in zip((fifth.weights, eighth.weights, eighth.damping), theirs, strict=True):
        np.testing.assert_allclose(np.array(ours, float), expected, rtol=0, atol=1e-14)


def test_what_is_derived() -> None:
    assert RK4.c == (0, Fraction(1, 2), Fraction(1, 2), 1) and RK4.stages == 4 and len(RK4.rows) == 5
    assert [tableau.fsal for tableau in ALL] == [
        False, False, False, False, True, True, True, True, False,
    ]  # fmt: skip
    assert all(isinstance(a, Fraction) for line in dopri5().A for a in line)
    assert dopri5().hermite().rows == dopri5().A, "the last stage is the slope at the end already"
    assert dop853().abscissae[-3:] == (Fraction(1, 10), Fraction(1, 5), Fraction(7, 9))
    assert all(tableau.source for tableau in ALL)
    root = math.sqrt(6)
    closed = [(12 - 2 * root) / 135, (6 - root) / 45, (6 - root) / 30, (6 + root) / 30]
    np.testing.assert_allclose([float(c) for c in dop853().c[1:5]], closed, rtol=1e-15)


THIRD: dict[str, Any] = {"name": "third", "order": 3, "A": ((), row("1/2"), row("-1 2")), "b": row("1/6 2/3 1/6")}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"order": 4}, "order 4, sum b_i c_i a_ij c_j = 1/8, fails by 0.0417 (1/6 instead of 1/8)"),
        ({"b": row("1/6 2/3 1/3")}, "order 1, sum b_i = 1, fails by 0.167 (7/6 instead of 1)"),
        ({"b": row("1/6 2/3 0.16666666")}, "order 1, sum b_i = 1, fails by -6.67e-09 (0.99999999"),
        ({"A": ((), row("1/2"), row("0 1"))}, "order 3, sum b_i a_ij c_j = 1/6, fails by -0.0833 (1/12 instead"),
        ({"c": row("0 1/2 3/4")}, "c_3 is the sum of row 3 of A, fails by -0.25 (3/4 instead of 1)"),
        ({"c": row("0 1/2")}, "c has 2 entries for 3 stages"),
        ({"A": ((), row("1/2"))}, "b has 3 weights and A has 2 rows"),
        ({"A": ((), row("1/2"), row("-1 2 1"))}, "row 3 of A has 3 entries, not the 2 of an explicit method"),
        ({"b": (1 / 6, math.nan, 1 / 6)}, "a coefficient is not a finite number"),
        ({"order": 0}, "a method needs at least one stage and an order of at least 1"),
        ({"error": ErrorEstimate(row("1 -1"), order=1)}, "its error weights are not one for each of the 3 stages"),
        ({"error": ErrorEstimate(row("1 -1 0"), order=2)}, "order 2, sum e_i c_i = 0, fails by -0.5"),
        ({"dense": DenseOutput((row("1"),), order=1)}, "its dense output has 1 rows of weights for 3 stages"),
        (
            {"dense": DenseOutput((row("1/6"), row("2/3"), row("1/6")), order=2)},
            "order 2, theta^1 in sum b_i(theta) c_i = 0, fails by 0.5",
        ),
        (
            {"dense": DenseOutput((row("1"), row("0"), row("0")), order=1)},
            "the dense weight b_1(1) = b_1 fails by 0.833 (1 instead of 1/6)",
        ),
        (
            {"dense": DenseOutput((row("1/6"), row("2/3"), row("1/6"), row("0")), 1, (THIRD["b"],), row("1 1"))},
            "its dense output has 2 abscissae for 1 stages",
        ),
    ],
)
def test_what_does_not_hold_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(StatementError) as refusal:
        ButcherTableau(**{**THIRD, **change})
    text = str(refusal.value)
    assert text.startswith("The tableau 'third' is not what it claims: ") and text.endswith(".")
    assert words in text


def test_a_claim_of_one_order_more_is_refused_for_every_method() -> None:
    for tableau in ALL:
        with pytest.raises(StatementError, match=f"the condition of order {tableau.order + 1}, "):
            replace(tableau, order=tableau.order + 1, dense=None, error=None)


@pytest.mark.parametrize("tableau", [RK4, BS3, dopri5(), tsit5(), dop853()], ids=lambda tableau: tableau.name)
def test_every_wrong_coefficient_is_refused(tableau: ButcherTableau) -> None:
    """An error of 1e-6 in any entry of A or b is refused."""
    wrong = Fraction(1, 10**6)
    for i, line in enumerate(tableau.A):
        for j in range(len(line)):
            changed = (*line[:j], line[j] + wrong, *line[j + 1 :])
            with pytest.raises(StatementError):
                replace(tableau, A=(*tableau.A[:i], changed, *tableau.A[i + 1 :]))
    for i in range(tableau.stages):
        with pytest.raises(StatementError, match="b_"):
            replace(tableau, b=(*tableau.b[:i], tableau.b[i] + wrong, *tableau.b[i + 1 :]))


# --- steps precisely ------------------------------------------------------------------------------------------
# Each step as it was written, in many digits: its order, its symmetry and what it conserves, as they are claimed.

EXPLICIT = tuple(name for name in STEPPED if find(name).claims.explicit)
SOLVED = tuple(name for name in IMPLICIT if name != "bdf2")
"""The implicit methods that are maps of one state."""

PROBLEM = Problem(model("oscillator"), {}, 0.0, 1.0, np.zeros(2))
COARSE = {True: 2, False: 1}
"""A step that is long enough for order 9 to be visibly not symplectic; an implicit one has to converge."""


def program(name: str) -> StepProgram:
    """Return the step program of a method, without step control if possible."""
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
    """The step of verner9 with its published coefficients. Coefficients rounded to doubles would hide its order."""
    slopes: list[Any] = []
    for words in triangle(VERNER_MATRIX.split()):
        row = [mpmath.mpf(word) for word in words]
        moved = sum((a * s for a, s in zip(row, slopes, strict=True) if a), y * 0)
        slopes.append(f(t + sum(row) * h, y + h * moved))
    return y + h * sum(mpmath.mpf(b) * s for b, s in zip(VERNER_WEIGHTS.split(), slopes, strict=True))


@pytest.mark.few(2)
@pytest.mark.parametrize(("name", "law"), PRECISE)
def test_the_order_without_round_off(name: str, law: Law, everything: bool) -> None:
    """With 60 digits, the difference of one step and two half steps is of order p + 1.

    The measured order converges linearly to p as the step tends to 0, and is extrapolated. The smallest step is limited
    by coefficients that are rounded to doubles.
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
    """Return the state [q, p] after a step by Hamilton's equations, or by those in velocities with `lagrange`."""
    zero = mpmath.mpf(0)
    if not lagrange:
        return precise_step(step, law.canonical, zero, y, h)
    q, p = np.split(y, 2)
    q, v = np.split(precise_step(step, law, zero, np.concatenate([q, law.velocities(q, p)]), h), 2)
    return np.concatenate([q, law.mass(q) @ v])


def defect(name: str, law: Law, *, lagrange: bool) -> float:
    """Return the largest entry of J^T W J - W for the Jacobian J of a step in (q, p).

    The error of central differences with the step 1e-20 is about 1e-40.
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


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "law"), EACH)
def test_the_step_itself_is_symplectic_or_clearly_not(name: str, law: Law) -> None:
    """Methods of slopes integrate Hamilton's equations, also for energies that do not separate."""
    error = defect(name, law, lagrange=program(name).law != "rhs")
    if find(name).claims.symplectic:
        # The fractions of a splitting are doubles, and each of its flows is symplectic; Gauss's numbers have 60 digits.
        assert error < (1e-12 if name in EXPLICIT else 1e-38)
    else:
        assert error > 1e-6


@pytest.mark.few(3)
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


@cache
def compiled(law: Law, target: str) -> Model:
    """Return the compiled model of a law, stated by energies."""
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
    """The compiled step equals the step in multiple precision up to round-off."""
    model = compiled(law, target)
    start, worst = np.array(law.start, dtype=float), 0.0
    names = (*model.statement.names, *(f"{name}_dot" for name in model.statement.names))
    rng = np.random.default_rng(4)
    method = stepped(name, 0.125)
    for _ in range(share(8)):
        y = start + rng.uniform(-0.1, 0.1, len(start))
        result = run(model, 0.125, method, initial=dict(zip(names, y, strict=True)))
        assert result.steps == 1
        with mpmath.workdps(DIGITS):
            exact = precise_step(program(name), law, mpmath.mpf(0), array(map(mpmath.mpf, y)), mpmath.mpf(1) / 8)
            worst = max(worst, float(max(abs(array(result.y[:, -1]) - exact))))
    # The state is rounded once, and what it is made of with some units of less than itself: no more than two ulps.
    assert worst < 4 * 2.0**-53
