"""Options of methods are checked when the method is made, not when it runs."""

from __future__ import annotations

import inspect
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.trajectory.methods.registry import BUILT_IN

made: Any = lg
"""The package, of which nobody has told the types here."""

WRONG: list[Any] = [
    "nan", "0.1", b"1", [0.1], (0.1,), {}, set(), float("nan"), float("inf"), -0.0, -1.0, 1j, True, np.array([0.1]),
    np.array(["a"]), np.ma.masked, object(), 10**400,
]  # fmt: skip

TAKES = [(name, option) for name, make in BUILT_IN.items() for option in inspect.signature(make).parameters]
SCIPY = [name for name in lg.methods.__all__ if name.startswith("Scipy")]


@pytest.mark.parametrize(("name", "option"), TAKES)
def test_an_option_that_no_run_could_use_is_refused(name: str, option: str) -> None:
    for value in WRONG:
        with pytest.raises(lg.StatementError, match=option):
            BUILT_IN[name](**{option: value})


@pytest.mark.parametrize("name", [*SCIPY, "CVODE"])
@pytest.mark.parametrize("option", ["max_step", "first_step"])
def test_a_bound_of_steps_that_is_none_is_refused(name: str, option: str) -> None:
    for value in WRONG:
        if not (option == "max_step" and value == float("inf")):
            with pytest.raises(lg.StatementError, match=option):
                getattr(lg.methods, name)(**{option: value})
    with pytest.raises(lg.StatementError, match="max_step"):
        getattr(lg.methods, name)(max_step=None)


@pytest.mark.parametrize("size", [0.1, 1, Fraction(1, 10), np.float64(0.1), np.array(0.1)])
def test_a_number_of_any_kind_is_a_step(size: Any) -> None:
    assert lg.methods.RK4(step=size).step == size


def test_a_tolerance_of_zero_is_one() -> None:
    assert lg.methods.Tsit5(rtol=0, atol=0.0).rtol == 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: made.Claims(order="a"), "order is 'a'"),
        (lambda: made.Claims(order=4, symplectic="no"), "symplectic = 'no': give True or False"),
        (lambda: made.methods.ImplicitMethod("mine", None, print), "the claims of mine are None: give an lg.Claims"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), 3), "the function of mine is 3: give a function"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), print, law="x"), "of a method is not 'x': give"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), print, control=3), "the control of mine is 3: give"),
        (lambda: made.methods.RungeKutta("rk4"), "'rk4' is not a tableau: make one with lg.methods.tableau"),
        (lambda: made.methods.Splitting("mine", 1, "ab"), "the stages of mine is the text 'ab'"),
        (lambda: made.methods.Splitting("mine", 1, [(1.0, 1j)]), "stage 0 of mine has entries of type complex128"),
        (lambda: made.methods.Splitting("mine", 1, [(1.0,)]), "give pairs"),
        (lambda: made.methods.tableau([[0]], ["1e999999999"], order=1), "has an entry that is not a number"),
        (lambda: made.methods.tableau([[0]], [True], order=1), "has an entry that is not a number"),
        (lambda: made.methods.ButcherTableau("mine", 1, [[]], [1]), "b, c and the rows of A are tuples of numbers"),
        (lambda: made.methods.RK4().integrate(3), "rk4 cannot run 3: give an lg.Problem"),
        (lambda: made.methods.plot_stability("rk4", left=1, right=0), "give left < right and top > 0"),
        (lambda: made.methods.growth("rk4", ["a"]), "z has entries of type <U1: give numbers"),
        (lambda: made.Model("x", "y", "z"), "a model is made by system.compile()"),
        (lambda: made.Solution(1, 2, 3), "a solution is made by system.run() or lg.integrate()"),
        (lambda: made.Race(1, "a", (0, 1)), "a race is made by lg.race()"),
        (lambda: made.System.from_statement("x"), "'x' is not a statement: give the .statement of a system"),
    ],
)  # fmt: skip
def test_records_are_checked_when_they_are_made(make: Any, words: str) -> None:
    with pytest.raises(lg.StatementError) as refusal:
        make()
    assert words in str(refusal.value)
