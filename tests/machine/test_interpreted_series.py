"""What a series in Python prepares: numbers of the parameters, and matrices ready for right-hand sides."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.series import interpreted_driver, interpreted_jet
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.series.interpreted_jet import Jet
from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from tests.models import SYSTEMS


def system(name: str) -> tuple[Statement, SeriesProgram]:
    statement = SYSTEMS[name]()
    return statement, series_program(euler_lagrange(statement))[0]


def test_what_depends_on_parameters_alone_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """An array of parameters that is written over has other numbers, and is not the array that was asked for before."""
    made = []

    def counted(*args: Any) -> Jet:
        made.append(args)
        return Jet(*args)

    monkeypatch.setattr(interpreted_driver, "Jet", counted)
    statement, program = system("elastic pendulum")
    values, state = np.array([statement.defaults[p] for p in statement.parameters]), np.array(statement.initial)
    series, given = NumpySeries(program), values.copy()
    rows = [series.rows(6, 0.0, state, 1.0, given) for _ in range(2)]
    assert len(made) == 1
    given *= 2.0
    other = series.rows(6, 0.0, state, 1.0, given)
    assert len(made) == 2
    given[:] = 0.0
    assert (series.rows(6, 0.0, state, 1.0, 2.0 * values) == other).all()
    assert len(made) == 2
    assert (rows[0] == rows[1]).all() and not (other == rows[0]).all()
    assert copy.deepcopy(series) is series
    assert (pickle.loads(pickle.dumps(series)).rows(6, 0.0, state, 1.0, values) == rows[0]).all()


def test_a_matrix_is_eliminated_once_a_step_or_once_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was eliminated again at every order."""
    real, made = interpreted_jet.Eliminated, []

    def counted(matrix: Any) -> interpreted_jet.Eliminated:
        made.append(matrix)
        return real(matrix)

    monkeypatch.setattr(interpreted_jet, "Eliminated", counted)
    for name, times in (("double pendulum", 2), ("coupled masses", 1)):
        statement, program = system(name)
        series, values = NumpySeries(program), np.array([statement.defaults[p] for p in statement.parameters])
        for _ in range(2):
            series.rows(6, 0.0, np.array(statement.initial) + 0.1, 1.0, values)
        assert len(made) == times
        made.clear()


@pytest.mark.parametrize("exact", [False, True])
def test_eliminated_rows_are_swapped_in_every_right_hand_side(exact: bool) -> None:
    """Small integers, which both kinds of numbers have exactly; pivots lie below the diagonal in each column."""
    matrix = np.array([[0.0, 2.0, 1.0, 0.0], [1.0, 0.0, 0.0, 3.0], [4.0, 1.0, 0.0, 1.0], [2.0, 0.0, 8.0, 1.0]])
    given = np.array([[sp.Rational(int(entry)) for entry in row] for row in matrix]) if exact else matrix
    eliminated = interpreted_jet.Eliminated(given)
    for solution in np.array([[1.0, -2.0, 3.0, 0.5], [0.0, 1.0, 0.0, 0.0]]):
        found = eliminated.solve([sp.nsimplify(entry) for entry in matrix @ solution] if exact else matrix @ solution)
        assert np.array(found, dtype=float) == pytest.approx(solution, rel=1e-15, abs=1e-15)
