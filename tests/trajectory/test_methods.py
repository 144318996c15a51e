"""Each method is tested against its formula and its claims: order, symplecticity, symmetry, energy, and refusals."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp

from lagrange.errors import StatementError
from lagrange.evidence.precise_run import precise_run
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.statement.coordinate import coordinates, t
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.implicit import BITS, ImplicitMethod, gauss_tableau
from lagrange.trajectory.methods.radau import continued
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.splitting import Splitting, composition
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.trajectory import Status
from tests.models import LLVM_FIRST, SYSTEMS, TARGETS, B, build, g, k, l, m, model, x, y
from tests.refusals import refusal
from tests.trajectory.runs import (
    ADAPTIVE,
    CONSTRAINED,
    EQUAL,
    FIXED,
    IMPLICIT,
    MOMENTA,
    SPLITTINGS,
    STEPPED,
    equal,
    exact,
    implicit,
    run,
)


@pytest.mark.few(1)
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
    assert "the drifts of half add up to 2" in refusal(Splitting, "half", 1, ((1.0, 2.0),))
    assert "the kicks of half add up to nan" in refusal(Splitting, "half", 1, ((math.nan, 1.0),))


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
    assert "suzuki is not of order 6: the coefficient of" in refusal(composition, sizes, name="suzuki", order=6)
    assert "first = 'push': give 'drift' or 'kick'" in refusal(composition, sizes, name="suzuki", order=4, first="push")
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


def test_first_guesses_of_radau_continue_a_polynomial_of_the_last_step() -> None:
    points, following = (0.0, 0.3, 0.6, 1.0), (0.25, 1.0)
    guesses = continued(points, following, 2.0, [s**3 - 2 * s for s in points])
    assert guesses == pytest.approx([s**3 - 2 * s for s in (1.5, 3.0)])


@pytest.mark.parametrize("name", MOMENTA)
def test_a_mass_may_depend_on_time(name: str) -> None:
    """With the mass exp(t) the motion is x'' + x' + x = 0 (Caldirola, Kanai). The run does not begin at t = 0."""
    held = {"both": x - y} if name in CONSTRAINED else {}
    energies = {key: sp.exp(t) * (u**2 + v**2) / 2 for key, u, v in (("kinetic", x.dot, y.dot), ("potential", x, y))}
    compiled = build("llvm", coordinates=[x, y], constraints=held, **energies)
    decay, sine, cosine = math.exp(-0.5), math.sin(0.75**0.5) / 3**0.5, math.cos(0.75**0.5)
    true = np.repeat([decay * (cosine + sine), -2 * decay * sine], 2)
    ends = [run(compiled, 2.0, equal(name), 1.0, {x: 1.0, y: 1.0}, step=1 / steps).y[:, -1] for steps in (20, 40)]
    first, second = (np.abs(end - true).max() for end in ends)
    assert second < max(1e-12, 0.3 * first) and first < 1e-3


# --- rounding errors of long runs -----------------------------------------------------------------------------
# Long runs of implicit methods with fixed steps: errors of invariants grow only by random rounding.
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


# --- implicit methods against their formulas and their claims --------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
def test_bdf2_is_a_parabola_through_three_states(target: str) -> None:
    compiled = model("cart and pole", target)
    h = 0.02
    result = run(compiled, 10.5 * h, "bdf2", step=h)
    assert result.steps == 11
    for i in range(1, 10):
        before, y, new = result.y[:, i - 1 : i + 2].T
        slope = (3 * new - 4 * y + before) / (2 * h)
        assert slope == pytest.approx(compiled.rhs(result.t[i + 1], new), rel=1e-11, abs=1e-12)


TWINS = {
    "variational-midpoint": "implicit-midpoint",
    "variational-trapezoid": "velocity-verlet",
    "galerkin4": "gauss2",
    "galerkin6": "gauss3",
    "rattle": "velocity-verlet",
    "constrained-midpoint": "implicit-midpoint",
}


@pytest.mark.parametrize("system", ["Henon-Heiles", "coupled masses", "saddle"])
@pytest.mark.parametrize("name", TWINS)
def test_with_a_constant_mass_matrix_a_variational_method_is_a_known_one(name: str, system: str) -> None:
    """Sources: Marsden and West, 2001, sections 2.6.1 and 2.6.2; Hairer, Lubich and Wanner, section VI.6.4."""
    compiled = model(system)
    ours, theirs = (run(compiled, 1.0, each, step=0.05) for each in (name, TWINS[name]))
    assert ours.y == pytest.approx(theirs.y, rel=1e-12, abs=1e-13)


# --- claims ---------------------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("system", ["pendulum", "double pendulum", "elastic pendulum", "Henon-Heiles"])
@pytest.mark.parametrize("name", EQUAL)
def test_what_claims_to_conserve_energy_does_and_the_rest_does_not(name: str, system: str) -> None:
    """In 2000 steps the energy error of methods that claim conservation is round-off; that of the others is not."""
    compiled = model(system)
    result = run(compiled, 40.0, name, step=0.02)
    n = compiled.dimension
    energy = compiled.energy(result.y[:n], result.y[n:])
    scale = np.abs(energy).max() + np.abs(compiled.evaluate("lagrangian", result.y[:n], result.y[n:])).max()
    error = np.abs(energy - energy[0]).max() / scale
    if find(name).claims.energy:
        assert error < 1e-12
    elif find(name).claims.order <= 2:
        assert error > 1e-6


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [name for name in IMPLICIT if find(name).claims.a_stable])
def test_what_claims_to_be_stable_damps_what_is_too_fast_for_its_steps(name: str) -> None:
    """Overdamped and oscillating motions a thousand times faster than the step do not grow."""
    for damping in (0.0, 2e4):
        compiled = build(
            kinetic=x.dot**2 / 2,
            potential=k * x**2 / 2,
            dissipation=damping * x.dot**2 / 2,
            parameters={k: 1e8},
            initial={x: 1.0},
        )
        o: Any = {"step": 0.1} if name in FIXED else {"rtol": 1e-3, "atol": 1e-3}
        result = run(compiled, 10.0, name, **o)
        # Without friction what is damped is energy that the motion keeps.
        assert result.status is Status.SUCCESS or (not damping and result.status is Status.UNRELIABLE)
        assert np.abs(result.y[0]).max() < 1 + 1e-9, (damping, np.abs(result.y[0]).max())


# --- newton ---------------------------------------------------------------------------------------------------
# How Newton's method begins, stops and fails: machines, cost, units, round-off, and methods of one's own.


@pytest.mark.few(1)
@pytest.mark.parametrize("name", EQUAL)
def test_units_do_not_matter(name: str) -> None:
    """Lengths and times in units from 1e-30 to 1e30 give the same corrections and the same result."""
    compiled = model("elastic pendulum")
    counts, ends = [], []
    for length, time in itertools.product((1e-30, 1.0, 1e30), repeat=2):
        result = run(
            compiled,
            0.75 * time,
            name,
            step=0.013 * time,
            parameters={l: 0.7 * length, g: 9.81 * length / time**2, k: 3.2 / time**2},
            initial={"r": 1.1 * length, "theta": 0.4, "theta_dot": 0.3 / time},
        )
        assert result.status.complete, result.message
        counts.append(result.evaluations)
        ends.append(result.y[:2, -1] / [length, 1])
    assert np.ptp(counts) <= 0.15 * max(counts)  # by chance, as between machines
    assert np.abs(np.array(ends) - ends[0]).max() < 1e-12


# --- how it fails ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
def test_a_step_without_a_solution_is_told(target: str) -> None:
    """Backward Euler for v' = v^2 has no real solution beyond v h = 1/4."""
    compiled = build(target, kinetic=x.dot**2 / 2, forces={x: x.dot**2}, initial={x.dot: 1.0})
    result = run(compiled, 2.0, "backward-euler", step=0.1)
    assert result.status is Status.DIVERGED
    assert result.y[1, -1] * 0.1 > 0.2 and np.isfinite(result.y).all() and len(result.t) == result.steps + 1
    assert "backward-euler stopped at t = " in result.message and "the step did not converge" in result.message
    assert "The last correction of Newton's method was still " in result.message
    assert result.message.endswith("smooth the jump, such as by tanh(v/0.001).")


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("name", EQUAL)
def test_newton_does_not_leap_to_another_root(name: str, target: str) -> None:
    """v' = v^2 and x'' = 6x^2 have a pole at t = 1. The mass x^2 is zero at x = 0, which is reached at t = 0.5.

    A step may end so close to x = 0 that the mass matrix is singular there; rounding decides.
    """
    pole = build(target, kinetic=x.dot**2 / 2, forces={x: x.dot**2}, initial={x: 0.0, x.dot: 1.0})
    double = build(target, kinetic=x.dot**2 / 2, forces={x: 6 * x**2}, initial={x: 1.0, x.dot: 2.0})
    shrinking = build(target, kinetic=x**2 * x.dot**2 / 2, initial={x: 1.0, x.dot: -1.0})
    for compiled, step, end in ((pole, 0.01, 1.0), (double, 0.01, 1.0), (shrinking, 1e-3, 0.5)):
        if compiled is double and name in ("variational-trapezoid", "rattle"):
            continue  # Its equations are linear here, as Verlet's: they have one root.
        result = run(compiled, 3.0, name, step=step)
        singular = (Status.SINGULAR,) if compiled is shrinking else ()
        assert result.status in (Status.DIVERGED, *singular), result.message
        assert 0.9 * end <= result.t[-1] <= end and np.abs(result.y).max() < 3e6


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EQUAL)
@pytest.mark.parametrize("size", [100.0, 1000.0])
def test_a_law_that_rounds_more_than_its_terms_show(size: float, name: str, target: str) -> None:
    """The force is a difference of cubes of `size`, so corrections stop decreasing far above round-off."""
    compiled = build(target, kinetic=x.dot**2 / 2, potential=(x + B) ** 4 / 4 - B**3 * x, initial={x: 1.0})
    result = run(compiled, 0.4 / size, name, step=2e-3 / size, parameters={B: size})
    assert result.status is Status.SUCCESS, result.message
    fine = exact(compiled, 0.4 / size, parameters={B: size})
    assert result.y[0, -1] == pytest.approx(fine.y[0, -1], abs=0.5 if name == "backward-euler" else 1e-3)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", IMPLICIT)
def test_a_mass_matrix_that_becomes_singular_is_told(name: str, target: str) -> None:
    """From x = 1 on only y + z has inertia.

    Methods of momenta detect it when Newton's matrix is updated, within 64 steps.
    """
    y, z = coordinates("y z")
    compiled = build(
        target,
        kinetic=x.dot**2 / 2 + (y.dot + z.dot) ** 2 / 2 + sp.Max(0, 1 - x) * z.dot**2 / 2,
        coordinates=[x, y, z],
        initial={x: 0.5, x.dot: 1.0, y.dot: -0.4},
    )
    o: Any = {"step": 0.01} if name in FIXED else {}
    result = run(compiled, 5.0, name, **o)
    assert result.status is Status.SINGULAR, result.message
    assert np.isfinite(result.y).all() and 0.4 < result.t[-1] < (0.51 if implicit(name).law == "rhs" else 1.15)
    assert "the mass matrix is singular at t = " in result.message


@pytest.mark.parametrize("target", LLVM_FIRST)
def test_a_method_of_ones_own(target: str) -> None:
    """A user's method: Alexander's two-stage singly diagonally implicit method of order 2, with two solves."""
    gamma = 1 - 0.5**0.5

    def step(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
        a = solve(lambda a: f(t + h * gamma, y + a * (h * gamma)) - a, lambda: f(t, y))
        start = y + a * (h * (1 - gamma))
        b = solve(lambda b: f(t + h, start + b * (h * gamma)) - b, a)
        return start + b * (h * gamma)

    alexander = ImplicitMethod("sdirk2", Claims(order=2, a_stable=True, explicit=False), step)
    compiled = model("cart and pole", target)
    truth = exact(compiled, 1.0).y[:, -1]
    errors = [np.abs(run(compiled, 1.0, alexander, step=1.0 / n).y[:, -1] - truth).max() for n in (50, 71, 100)]
    assert -np.polyfit(np.log([50, 71, 100]), np.log(errors), 1)[0] == pytest.approx(2, abs=0.15)


SMOOTH = ("pendulum", "double pendulum", "Kepler orbit", "cart and pole", "charge", "Henon-Heiles", "bead on a hoop")


@cache
def truth(name: str, end: float) -> Any:
    """Return the end state by collocation in multiple precision, from the stated energies."""
    statement = SYSTEMS[name]()
    values = {p: statement.defaults[p] for p in statement.parameters}
    return np.array(precise_run(model(name, "numpy"), values, 0.0, statement.initial, [end], digits=18)[0], dtype=float)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("end", [1.5, -1.5])
@pytest.mark.parametrize("name", SMOOTH)
def test_the_error_is_what_was_asked_for(name: str, end: float, target: str) -> None:
    """The error is at most the tolerance times the growth of errors by the motion, up to 20 in this time."""
    expected = truth(name, end)
    size = max(1.0, np.abs(expected).max())
    for rtol in (1e-4, 1e-8, 1e-12, 1e-16):
        result = run(model(name, target), end, "taylor", rtol=rtol, atol=rtol)
        assert result.status is Status.SUCCESS and result.rejected == 0
        assert np.abs(result.y[:, -1] - expected).max() < 20 * max(rtol, 2e-15) * size, rtol


def test_the_phase_of_an_oscillator_after_many_steps() -> None:
    """The motion is cos t, with compensated sums of state and time.

    Each of n = 10^5 steps adds an error of about h eps. Random errors add to sqrt(n) h eps = 1e-13. Without
    compensation the error would be 1e-11 or more.
    """
    compiled = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0})
    end = 1.0e5
    result = run(compiled, end, Taylor(rtol=1e-16, atol=1e-16, order=20))
    assert result.steps > 5e4
    with mpmath.workdps(30):
        expected = [float(mpmath.cos(mpmath.mpf(end))), -float(mpmath.sin(mpmath.mpf(end)))]
    assert result.y[:, -1] == pytest.approx(expected, abs=2e-12)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("end", [1.0, 3.7, -2.0, 1e5])
def test_a_rock_without_air(end: float, target: str) -> None:
    """The series ends with t^2. The run takes one step with an error of one unit in the last place."""
    rock = build(
        target,
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        parameters={m: 1.5, g: 9.75},
        initial={x: 0.25, y: 1.5, x.dot: 3.5, y.dot: 12.0},
    )
    result = run(rock, end, "taylor")
    assert result.steps <= 2
    parts = np.array([[0.25, 3.5 * end, 0.0], [1.5, 12 * end, -9.75 * end**2 / 2], [3.5, 0, 0], [12, -9.75 * end, 0]])
    assert (np.abs(result.y[:, -1] - parts.sum(axis=1)) <= np.spacing(np.abs(parts).max(axis=1))).all()
    middle = result.dense(np.array([end / 2]))[:, 0]
    halves = parts * np.array([1.0, 0.5, 0.25])
    assert (np.abs(middle - halves.sum(axis=1)) <= np.spacing(np.abs(halves).max(axis=1))).all()


STOPPED = (Status.STEP_TOO_SMALL, Status.NON_FINITE)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("start", "after"), [(0.0, 0.1), (7.0, 1e-100), (7.08, 1e-100)])
def test_coefficients_that_overflow(start: float, after: float, target: str) -> None:
    """In the potential exp(100 x) the motion diverges at once; at x = 7.0 already the second coefficient overflows."""
    steep = build(target, kinetic=x.dot**2 / 2, forces={x: sp.exp(100 * x)}, initial={x: start, x.dot: 1.0})
    result = run(steep, 1.0, "taylor", max_steps=10_000)
    assert result.status in STOPPED and np.isfinite(result.y).all() and 0 <= result.t[-1] < after
    assert "taylor stopped at t = " in result.message and ("x is" in result.message or "x_dot is" in result.message)
