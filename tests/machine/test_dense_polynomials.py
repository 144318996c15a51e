"""Polynomials of steps: each kind of dense output has the same values on both machines and in the interpreter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.dense.collocation import collocation_polynomial
from lagrange.algorithm.dense.polynomials import hermite_polynomial, runge_kutta_polynomial
from lagrange.algorithm.linear.gauss_jordan import invert_columns
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.procedure.interpreter import run
from lagrange.statement.coordinate import t
from lagrange.trajectory.methods.implicit import collocation_tableau
from lagrange.trajectory.methods.radau import POINTS
from lagrange.trajectory.tableaux.butcher import ButcherTableau
from lagrange.trajectory.tableaux.explicit import dop853
from tests.models import TARGETS, build, k, m, model, x, z
from tests.trajectory.runs import exact

GRID = np.array([0.0, 0.1, 0.25, 0.4, 0.6, 0.65, 0.9, 1.0, 1.2, 1.3])


def of_tableau(tableau: ButcherTableau) -> tuple[StepPolynomial, FloatArray, FloatArray, FloatArray]:
    """Return the dense output of a tableau, and its rows, abscissae and weights."""
    assert tableau.dense is not None
    rows = np.array([[*map(float, row), *[0.0] * (len(tableau.rows) - len(row))] for row in tableau.rows])
    abscissae = np.array([float(c) for c in tableau.abscissae])
    powers = max(map(len, tableau.dense.weights))
    weights = np.array([[*map(float, line), *[0.0] * (powers - len(line))] for line in tableau.dense.weights])
    return runge_kutta_polynomial(rows, abscissae, weights), rows, abscissae, weights


def of_points(stages: int) -> StepPolynomial:
    A, _, c = collocation_tableau(POINTS[stages])
    return collocation_polynomial(A, c)


KINDS: dict[str, StepPolynomial] = {
    "dop853": of_tableau(dop853())[0],
    **{f"Hermite, order {order}": hermite_polynomial(order) for order in (3, 4, 7)},
    **{f"collocation, {stages} stages": of_points(stages) for stages in POINTS},
}


def states_of(compiled: Model) -> FloatArray:
    return np.ascontiguousarray(exact(compiled, GRID[-1], t_eval=GRID).y.T)


def dense_of(compiled: Model, kind: StepPolynomial) -> Any:
    derivative = compiled.kernel("jacobian") if kind.derivative else None
    return compiled.machine.dense(kind, compiled.kernel("rhs"), compiled.parameter_array(), derivative)


@pytest.mark.parametrize("target", TARGETS)
def test_a_path_of_stages_is_the_formula_of_its_tableau(target: str) -> None:
    compiled = model("cart and pole", target)
    path, rows, abscissae, weights = of_tableau(dop853())
    states = states_of(compiled)
    c = dense_of(compiled, path).coefficients(GRID, states, np.array([3]))[:, :, 0]
    h, slopes = GRID[4] - GRID[3], np.zeros((len(rows), states.shape[1]))
    for i, row in enumerate(rows):
        slopes[i] = compiled.rhs(GRID[3] + abscissae[i] * h, states[3] + h * row @ slopes)
    for theta in (0.0, 0.3, 0.77, 1.0):
        share = weights @ theta ** np.arange(1, weights.shape[1] + 1)
        result = np.polynomial.polynomial.polyval(theta, c)
        # Weights up to 545 multiply what rounding does to 16 slopes near 1.
        assert result == pytest.approx(states[3] + h * share @ slopes, abs=1e-12)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_one_step_gets_does_not_depend_on_the_steps_of_its_block(kind: str, target: str) -> None:
    compiled = model("cart and pole", target)
    dense, states = dense_of(compiled, KINDS[kind]), states_of(compiled)
    together = dense.coefficients(GRID, states, np.arange(len(GRID) - 1))
    for step in range(len(GRID) - 1):
        assert (dense.coefficients(GRID, states, np.array([step]))[:, :, 0] == together[:, :, step]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", KINDS)
def test_accepted_states_are_exact_forwards_and_back(kind: str, target: str) -> None:
    compiled = model("cart and pole", target)
    states = states_of(compiled)
    for times, rows in ((GRID, states), (GRID[::-1].copy(), states[::-1].copy())):
        out = np.empty((states.shape[1] + 1, 3 * len(times)))
        expected = np.repeat(times, 3)
        dense_of(compiled, KINDS[kind]).at(times, rows, expected, out[1:])
        assert (out[1:] == np.repeat(rows, 3, axis=0).T).all()


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("target", TARGETS)
def test_each_time_is_evaluated_on_its_step(target: str, direction: float) -> None:
    """There are few or many times on a step, unused steps, and a step of zero length at a jump."""
    compiled, rng = model("Henon-Heiles", target), np.random.default_rng(3)
    times = direction * np.sort(np.concatenate([rng.uniform(0.0, 9.0, 400), [4.0, 4.0]]))
    states = rng.normal(size=(len(times), 4))
    dense = dense_of(compiled, hermite_polynomial(3))
    c = dense.coefficients(times, states, np.arange(len(times) - 1))
    for count in (1, 2, 9, 5000):
        expected = direction * np.sort(rng.uniform(direction * times[0], direction * times[-1], count))
        out = np.empty((4, count))
        dense.at(times, states, expected, out)
        result = np.searchsorted(direction * times, direction * expected, side="right") - 1
        theta = (expected - times[result]) / (times[result + 1] - times[result])
        assert out == pytest.approx(np.polynomial.polynomial.polyval(theta, c[:, :, result], tensor=False), abs=1e-12)
    jump = np.array([direction * 4.0])
    out = np.empty((4, 1))
    dense.at(times, states, jump, out)
    assert (out[:, 0] == states[np.flatnonzero(times == jump[0])[-1]]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", ["dop853", "Hermite, order 3", "Hermite, order 7"])
def test_a_step_into_a_singular_configuration_is_a_parabola_and_the_others_keep_their_path(
    kind: str, target: str
) -> None:
    """At t = 1 the mass of z is round-off. The polynomial of that step is a parabola."""
    compiled = build(
        target,
        kinetic=m * (x.dot + z.dot) ** 2 / 2 + sp.Max(sp.Float(4e-15), 1 - t) * m * z.dot**2 / 2,
        potential=k * (x - z) ** 2 / 2,
        coordinates=[x, z],
        initial={x: 0.3},
    )
    times = np.array([0.0, 0.3, 0.6, 1.0])
    states = np.array([[0.3, 0.1, 0.0, 0.2], [0.31, 0.15, 0.1, 0.2], [0.33, 0.22, 0.1, 0.25], [0.4, 0.3, 0.2, 0.3]])
    dense = dense_of(compiled, KINDS[kind])
    c = dense.coefficients(times, states, np.arange(3))
    assert np.isfinite(c).all() and (np.abs(c[3, :, :2]) > 0).any()
    first = 0.4 * compiled.rhs(0.6, states[2])
    assert c[:3, :, 2] == pytest.approx(np.array([states[2], first, states[3] - states[2] - first]), rel=1e-12)
    assert (c[3:, :, 2] == 0).all()
    assert (dense.coefficients(times[:3], states[:3], np.arange(2)) == c[:, :, :2]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("stages", POINTS)
def test_the_stages_of_a_step_alone_solve_their_equations(stages: int, target: str) -> None:
    """The residuals of the stage equations are round-off, and the last stage is the end of the step."""
    compiled, h = model("double pendulum", target), 0.1
    states = np.ascontiguousarray(exact(compiled, h, t_eval=[0.0, h]).y.T)
    c = dense_of(compiled, of_points(stages)).coefficients(np.array([0.0, h]), states, np.array([0]))[:, :, 0]
    points = POINTS[stages]
    result = np.array([np.polynomial.polynomial.polyval(point, c) for point in points])
    slopes = [compiled.rhs(h * point, state) for point, state in zip(points, result, strict=True)]
    A, _, _ = collocation_tableau(points)
    assert (result - states[0])[:-1] == pytest.approx((h * np.array(A) @ slopes)[:-1], abs=1e-14)
    assert result[-1] == pytest.approx(states[1], abs=1e-14)


def test_inverses_of_many_matrices_are_those_of_each() -> None:
    rng, order, count = np.random.default_rng(4), 5, 6
    matrices = rng.normal(size=(count, order, order))
    matrices[1] = np.eye(order)[::-1]
    matrices[2] = 0.0
    a = np.zeros((order, 2 * order, count))
    a[:, :order] = np.moveaxis(matrices, 0, -1)
    flat = a.ravel().tolist()
    run(invert_columns.form(), order, count, flat, [0.0] * count)
    result = np.moveaxis(np.array(flat).reshape(a.shape)[:, order:], -1, 0)
    for i in (0, 1, 3, 4, 5):
        assert result[i] @ matrices[i] == pytest.approx(np.eye(order), abs=1e-12)
    assert not np.isfinite(result[2]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("order", [4, 11, 20])
@pytest.mark.parametrize("span", [0.3, -0.7, 1e-5, 3.0])
def test_the_polynomial_of_a_taylor_step_is_its_series(span: float, order: int, target: str) -> None:
    """The polynomial is in the fraction of the step, for any ratio of the step to the time scale of the series."""
    compiled = model("cart and pole", target)
    series, _ = compiled.series()
    start, parameters = np.array(compiled.statement.initial), compiled.parameter_array()
    times, states = np.array([0.5, 0.5 + span]), np.array([start, start + 1.0])
    c = series.dense(order, parameters).coefficients(times, states, np.array([0]))[:, :, 0]
    rows = series.rows(order, 0.5, start, 1.0, parameters)[:, : len(start)]
    h = times[1] - times[0]
    assert c == pytest.approx(rows * h ** np.arange(order + 1)[:, None], rel=1e-13)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("length", [2.0, 1.0])
def test_a_step_whose_stages_have_no_solution_is_a_straight_line(length: float, target: str) -> None:
    """For x'' = x with a_11 = 1/2 the matrix I - h J / 2 is singular at h = 2."""
    compiled = build(target, kinetic=x.dot**2 / 2, potential=-(x**2) / 2)
    kind = collocation_polynomial([[0.5, 0.0], [0.75, 0.25]], [0.5, 1.0])
    times, states = np.array([0.0, 2.0, 3.0]), np.array([[1.0, 0.0], [2.0, 1.0], [2.5, 1.5]])
    step = int(length == 1.0)
    part = slice(step, step + 2)
    result = dense_of(compiled, kind).coefficients(times[part], states[part], np.array([0]))[:, :, 0]
    straight = np.array([states[step], states[step + 1] - states[step]])
    assert result[:2] == pytest.approx(straight, abs=1e-15) if step == 0 else np.isfinite(result).all()
    assert (np.abs(result[2]).max() < 1e-15) == (step == 0)
    both = dense_of(compiled, kind).coefficients(times, states, np.arange(2))
    assert np.isfinite(both).all()
