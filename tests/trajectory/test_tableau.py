"""Butcher tableaus: claims hold, and a wrong tableau is refused with the violated condition and its error."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from lagrange.trajectory.tableaux.butcher import ButcherTableau, DenseOutput, ErrorEstimate, row, triangle
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
from tests.refusals import refusal
from tests.trajectory.runs import FIXED, IMPLICIT, MOMENTA, SPLITTINGS, STEPPED, planned, run, stepped

Rhs = Callable[[Any, Any], Any]
"""y' of y = [q, v]."""

DIGITS = 60

TURNS = 40
"""Corrections of Newton's method, at most; it takes 4 to 8."""


@dataclass(frozen=True, eq=False)
class Law:
    """A system y' = rhs(t, y) with y = [q, v], and an initial state.

    `momentum(t, q, v)` returns p and f with dp/dt = f, and `mass(q)` returns M.
    """

    rhs: Rhs
    momentum: Callable[..., Any]
    mass: Callable[[Any], Any]
    places: tuple[str, ...]

    @property
    def start(self) -> Any:
        """The initial state, which has no symmetry."""
        return array(map(mpmath.mpf, self.places))

    @property
    def canonical(self) -> Law:
        """The law whose state is [q, p]."""
        return replace(self, rhs=self.hamilton)

    def hamilton(self, t: Any, y: Any) -> Any:
        q, p = np.split(y, 2)
        v = self.velocities(q, p)
        return np.concatenate([v, self.momentum(t, q, v)[1]])

    def constrained(self, t: Any, q: Any, v: Any, multipliers: Any) -> Any:
        """Return the law for methods with multipliers.

        The system has no constraints, so the multipliers have no effect.
        """
        return (*self.momentum(t, q, v), multipliers * 0, multipliers, multipliers)

    def velocities(self, q: Any, p: Any) -> Any:
        return array(mpmath.lu_solve(mpmath.matrix(self.mass(q).tolist()), mpmath.matrix(p.tolist())))

    def accelerations(self, t: Any, q: Any) -> Any:
        return self.rhs(t, np.concatenate([q, q * 0]))[len(q) :]


def array(numbers: Any) -> Any:
    return np.array(list(numbers), dtype=object)


def unit_mass(q: Any) -> Any:
    return np.eye(len(q), dtype=int)


def _driven_pendulum(t: Any, y: Any) -> Any:
    return array([y[1], -mpmath.sin(y[0]) * (1 + t)])


def _henon_heiles(t: Any, y: Any) -> Any:
    return array([y[2], y[3], -y[0] - 2 * y[0] * y[1], -y[1] - y[0] ** 2 + y[1] ** 2])


def separable(rhs: Rhs, *start: str) -> Law:
    """Return a law with unit masses, so that momenta equal velocities."""
    return Law(rhs, lambda t, q, v: (v, rhs(t, np.concatenate([q, v]))[len(q) :]), unit_mass, start)


def _double_pendulum(t: Any, y: Any) -> Any:
    """Right-hand side of a double pendulum with equal masses and rods. Its kinetic energy depends on the angles."""
    a, b, va, vb = y
    c, s = mpmath.cos(a - b), mpmath.sin(a - b)
    f, g = -(vb**2) * s - 2 * mpmath.sin(a), va**2 * s - mpmath.sin(b)
    return array([va, vb, (f - c * g) / (2 - c**2), (2 * g - c * f) / (2 - c**2)])


def _momenta_of_double_pendulum(t: Any, q: Any, v: Any) -> Any:
    pull = v[0] * v[1] * mpmath.sin(q[0] - q[1])
    return _mass_of_double_pendulum(q) @ v, array([-pull - 2 * mpmath.sin(q[0]), pull - mpmath.sin(q[1])])


def _mass_of_double_pendulum(q: Any) -> Any:
    c = mpmath.cos(q[0] - q[1])
    return np.array([[2, c], [c, 1]])


DRIVEN_PENDULUM = separable(_driven_pendulum, "0.4", "0.3")
HENON_HEILES = separable(_henon_heiles, "0.4", "0.3", "0.2", "-0.5")

DOUBLE_PENDULUM = Law(
    _double_pendulum, _momenta_of_double_pendulum, _mass_of_double_pendulum, ("0.4", "0.3", "0.2", "-0.5")
)


class Newton:
    """The argument `solve` of an implicit step function: Newton's method in multiple precision.

    The Jacobian is a difference quotient, inverted in doubles, so that a correction gains some 15 digits.
    """

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Any = None) -> Any:
        guess = guess() if callable(guess) else guess
        several = isinstance(guess, tuple)
        parts = guess if several else (guess,)
        count, z = len(parts), np.concatenate(parts)

        def value(unknowns: Any) -> Any:
            result = residual(*np.split(unknowns, count))
            return np.concatenate(result) if isinstance(result, (tuple, list)) else result

        inverse, size = np.empty((0, 0)), 1.0
        for _ in range(TURNS):
            off = value(z)
            if size > 1e-8:
                d = mpmath.mpf(10) ** -20
                columns = [(value(z + d * e) - off) / d for e in np.eye(len(z), dtype=int)]
                inverse = np.linalg.inv(np.array(columns).T.astype(float))
            correction = inverse @ off
            z = z - correction
            size = float(max(abs(correction)))
            if size < mpmath.mpf(10) ** (4 - mpmath.mp.dps):
                return tuple(np.split(z, count)) if several else z
        raise AssertionError(f"Newton's method left a correction of {size}")

    def damp(self, factor: Any, vector: Any) -> Any:
        """Return the error vector unchanged, since no step size follows from it here."""
        return vector


def precise_step(step: StepProgram, law: Law, t: Any, y: Any, h: Any) -> Any:
    """Return the state after one step from y = [q, v], in the arithmetic of the arguments."""
    solve = [Newton()] if step.solves else []
    if step.states == 2:
        return np.concatenate(step.function(getattr(law, step.law), t, *np.split(y, 2), h, *solve)[:2])
    result = step.function(law.rhs, t, y, h, *solve)
    return result if step.control is None else result[0]


# --- butcher tableaus: claims hold, and a wrong tableau is refused with the violated condition and its error ---


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
    text = refusal(ButcherTableau, **{**THIRD, **change})
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
        assert "b_" in refusal(replace, tableau, b=(*tableau.b[:i], tableau.b[i] + wrong, *tableau.b[i + 1 :]))


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
