"""Tableaus: what is claimed holds, and what does not hold is refused with the condition and by how much."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.integrate

from lagrange.errors import StatementError
from lagrange.trajectory.methods.explicit import runge_kutta_step
from lagrange.trajectory.tableaux.butcher import HIGHEST_CHECKED, ButcherTableau, DenseOutput, ErrorEstimate, row, rows
from lagrange.trajectory.tableaux.classical import BS3, EULER, HEUN, MIDPOINT, RK4
from lagrange.trajectory.tableaux.dop853 import DOP853
from lagrange.trajectory.tableaux.dopri5 import DOPRI5
from lagrange.trajectory.tableaux.rooted_trees import density, formula, size, trees
from lagrange.trajectory.tableaux.tsit5 import TSIT5
from lagrange.trajectory.tableaux.verner9 import verner9

ALL = (EULER, HEUN, MIDPOINT, RK4, BS3, DOPRI5, TSIT5, DOP853, verner9())
Rhs = Callable[[float, Any], Any]


def pendulum(t: float, y: Any) -> Any:
    return np.array([y[1], -np.sin(y[0]) * (1 + t)])


def stages(tableau: ButcherTableau, rhs: Rhs, t: float, y: Any, h: float) -> Any:
    """Return k, (dim, stages), those of the dense output included."""
    k: list[Any] = []
    for line, c in zip(tableau.rows, tableau.abscissae, strict=True):
        change = sum((float(a) * slope for a, slope in zip(line, k, strict=True)), np.zeros_like(y))
        k.append(rhs(t + float(c) * h, y + h * change))
    return np.array(k).T


def step(tableau: ButcherTableau, rhs: Rhs, t: float, y: Any, h: float) -> Any:
    k = stages(tableau, rhs, t, y, h)
    return y + h * k[:, : tableau.stages] @ np.array(tableau.b, dtype=float)


def path(tableau: ButcherTableau, rhs: Rhs, t: float, y: Any, h: float, theta: Any) -> Any:
    assert tableau.dense
    weights = np.array(list(itertools.zip_longest(*tableau.dense.weights, fillvalue=0)), dtype=float).T
    powers = np.array([theta ** (m + 1) for m in range(weights.shape[1])])
    return y[:, None] + h * stages(tableau, rhs, t, y, h) @ (weights @ powers)


def slope_of(errors: Any, sizes: Any) -> float:
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def reference(t: float, y: Any, times: Any) -> Any:
    found = scipy.integrate.solve_ivp(
        pendulum, (t, times[-1]), y, method="DOP853", rtol=3e-14, atol=1e-16, t_eval=times, max_step=0.02
    )
    return found.y


def test_trees_are_counted_and_weighed() -> None:
    assert [len(trees(order)) for order in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]
    # Sum of n!/(gamma sigma) over the trees of n nodes counts the monotonic labellings: (n - 1)! of them.
    assert sum(Fraction(math.factorial(5), density(tree) * symmetry(tree)) for tree in trees(5)) == math.factorial(4)
    assert density(((), ((),))) == 8 and size(((), ((),))) == 4
    assert formula(((), (), (((),),))) == "c_i^2 a_ij a_jk c_k"


def test_step_control_belongs_to_the_tableau_and_not_to_its_name() -> None:
    """A tableau that is registered under another name steps as it did."""
    named, renamed = runge_kutta_step(DOPRI5).control, runge_kutta_step(replace(DOPRI5, name="mine")).control
    assert named == renamed and named is not None and named.memory == 0.04


def test_every_condition_that_is_checked_can_be_told() -> None:
    """The tall tree has a letter for each stage but the last."""
    formulas = [formula(tree) for tree in trees(HIGHEST_CHECKED)]
    assert "a_ij a_jk a_kl a_lm a_mn a_no a_op a_pq c_q" in formulas


def symmetry(tree: Any) -> int:
    return math.prod(math.factorial(tree.count(child)) * symmetry(child) ** tree.count(child) for child in {*tree})


@pytest.mark.parametrize("tableau", ALL, ids=lambda tableau: tableau.name)
def test_the_path_has_its_order_and_meets_both_ends(tableau: ButcherTableau) -> None:
    assert tableau.dense
    y0, theta = np.array([1.0, 0.2]), np.linspace(0, 1, 11)
    sizes = {7: [0.8, 0.4, 0.2], 8: [1.0, 0.7, 0.5]}.get(tableau.dense.order, [0.2, 0.1, 0.05])
    round_off = 5e-12 if tableau.name == "verner9" else 2e-14  # its dense weights reach 13,293 and cancel
    errors = []
    for h in sizes:
        found = path(tableau, pendulum, 0.3, y0, h, theta)
        np.testing.assert_allclose(found[:, -1], step(tableau, pendulum, 0.3, y0, h), rtol=0, atol=round_off)
        np.testing.assert_array_equal(found[:, 0], y0)
        errors.append(np.abs(found - reference(0.3, y0, 0.3 + h * theta)).max())
    assert slope_of(errors, sizes) > tableau.dense.order + 1 - 0.25


@pytest.mark.parametrize(("tableau", "solver"), [(DOPRI5, scipy.integrate.RK45), (DOP853, scipy.integrate.DOP853)])
@pytest.mark.parametrize("h", [0.01, 0.1, 1.0])
def test_same_step_error_norm_and_path_as_scipy(tableau: ButcherTableau, solver: Any, h: float) -> None:
    y0, theta = np.array([1.0, 0.2]), np.linspace(0, 1, 101)
    theirs = solver(pendulum, 0.3, y0, 5.0, rtol=1e-3, atol=1e3, first_step=h, max_step=h)
    theirs.step()
    h = theirs.t - theirs.t_old
    k = stages(tableau, pendulum, 0.3, y0, h)
    scale = np.array([0.7, 1.3])
    np.testing.assert_allclose(step(tableau, pendulum, 0.3, y0, h), theirs.y, rtol=0, atol=5e-15)
    norm = theirs._estimate_error_norm(theirs.K, h, scale)
    np.testing.assert_allclose(error_norm(tableau, k, h, scale), norm, rtol=1e-6, atol=1e-20)
    # SciPy's own path for DOP853 carries a round-off of 4e-14 at h = 1, ours of 5e-14 (against exact fractions).
    np.testing.assert_allclose(
        path(tableau, pendulum, 0.3, y0, h, theta),
        theirs.dense_output()(theirs.t_old + theta * h),
        rtol=0,
        atol=2e-13 if h == 1.0 and tableau is DOP853 else 2e-14,
    )


def error_norm(tableau: ButcherTableau, k: Any, h: float, scale: Any) -> float:
    assert tableau.error
    k = k[:, : tableau.stages]
    scaled = k @ np.array(tableau.error.weights, dtype=float) / scale
    if not tableau.error.damping:
        return float(np.linalg.norm(h * scaled) / scaled.size**0.5)
    damping = k @ np.array(tableau.error.damping, dtype=float) / scale
    e5, e3 = (scaled**2).sum(), (damping**2).sum()
    return float(h * e5 / math.sqrt((e5 + 0.01 * e3) * scaled.size))


@pytest.mark.parametrize("tableau", [DOPRI5, DOP853], ids=lambda tableau: tableau.name)
def test_the_error_norm_shrinks_with_the_power_that_control_says(tableau: ButcherTableau) -> None:
    assert tableau.error and tableau.error.control == {5: 5, 8: 8}[tableau.order]
    sizes = np.array([0.1, 0.07, 0.05, 0.03] if tableau.order == 5 else [0.2, 0.15, 0.1, 0.07])
    norms = [error_norm(tableau, stages(tableau, pendulum, 0.3, np.array([1.0, 0.2]), h), h, np.ones(2)) for h in sizes]
    assert slope_of(norms, sizes) == pytest.approx(tableau.error.control, abs=0.25)


def test_what_is_derived() -> None:
    assert RK4.c == (0, Fraction(1, 2), Fraction(1, 2), 1) and RK4.stages == 4 and len(RK4.rows) == 5
    assert [tableau.fsal for tableau in ALL] == [
        False, False, False, False, True, True, True, True, False,
    ]  # fmt: skip
    assert all(isinstance(a, Fraction) for line in DOPRI5.A for a in line)
    assert DOPRI5.hermite().rows == DOPRI5.A, "the last stage is the slope at the end already"
    assert DOP853.abscissae[-3:] == (Fraction(1, 10), Fraction(1, 5), Fraction(7, 9))
    assert all(tableau.source for tableau in ALL)
    root = math.sqrt(6)
    closed = [(12 - 2 * root) / 135, (6 - root) / 45, (6 - root) / 30, (6 + root) / 30]
    np.testing.assert_allclose([float(c) for c in DOP853.c[1:5]], closed, rtol=1e-15)


def test_the_hermite_path_meets_values_and_slopes_at_both_ends() -> None:
    tableau, y0, h = DOPRI5.hermite(), np.array([1.0, 0.2]), 0.5
    end, tiny = step(tableau, pendulum, 0.3, y0, h), 1e-6
    near = path(tableau, pendulum, 0.3, y0, h, np.array([0.0, tiny, 1 - tiny, 1.0]))
    np.testing.assert_allclose(near[:, 3], end, atol=1e-15)
    np.testing.assert_allclose((near[:, 1] - near[:, 0]) / (tiny * h), pendulum(0.3, y0), atol=1e-5)
    np.testing.assert_allclose((near[:, 3] - near[:, 2]) / (tiny * h), pendulum(0.3 + h, end), atol=1e-5)


THIRD: dict[str, Any] = {"name": "third", "order": 3, "A": ((), row("1/2"), row("-1 2")), "b": row("1/6 2/3 1/6")}


def test_kuttas_third_order_method_passes() -> None:
    assert ButcherTableau(**THIRD).hermite().dense == DenseOutput(
        (row("1 -3/2 2/3"), row("0 2 -4/3"), row("0 1/2 -1/3"), row("0 -1 1")), 3, (THIRD["b"],), row("1")
    )


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
        ({"order": 0}, "a method has at least one stage and an order of at least 1"),
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


@pytest.mark.parametrize("tableau", [RK4, BS3, DOPRI5, TSIT5, DOP853], ids=lambda tableau: tableau.name)
def test_every_wrong_coefficient_is_refused(tableau: ButcherTableau) -> None:
    """Each entry of A and b in turn is off by 1e-6."""
    wrong = Fraction(1, 10**6)
    for i, line in enumerate(tableau.A):
        for j in range(len(line)):
            changed = (*line[:j], line[j] + wrong, *line[j + 1 :])
            with pytest.raises(StatementError):
                replace(tableau, A=(*tableau.A[:i], changed, *tableau.A[i + 1 :]))
    for i in range(tableau.stages):
        with pytest.raises(StatementError, match="b_"):
            replace(tableau, b=(*tableau.b[:i], tableau.b[i] + wrong, *tableau.b[i + 1 :]))


def test_rows_are_read_line_by_line() -> None:
    assert rows("\n 1/5\n\n 3/40 -9/40 \n") == ((Fraction(1, 5),), (Fraction(3, 40), Fraction(-9, 40)))
    assert row("0.5 2 1/3") == (0.5, Fraction(2), Fraction(1, 3))
    assert isinstance(row("0.5")[0], float) and isinstance(row("2")[0], Fraction)
