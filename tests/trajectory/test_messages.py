"""The sentence of every status: who, where, why, and what to do."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lagrange.equations.euler_lagrange import StateLayout
from lagrange.trajectory.integrator import Problem, Tolerances
from lagrange.trajectory.messages import coarse, message, unsolved
from lagrange.trajectory.trajectory import Status

NAMES = ("r", "phi")
EQUATIONS = SimpleNamespace(accelerations=())
MODEL: Any = SimpleNamespace(
    statement=SimpleNamespace(names=NAMES), layout=StateLayout(NAMES, NAMES), equations=EQUATIONS
)
PROBLEM = Problem(MODEL, {}, 1.0, -3.0, np.zeros(4), max_steps=7, max_wall=0.5)
STATE = np.array([1.0, -2.0, 3e9, 4.0])
WHERE = "at t = 0.25 on the way from 1 to -3"


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (Status.SUCCESS, "rk4 reached t = 0.25. Time ran backwards."),
        (Status.EVENT, "rk4 stopped at an event at t = 0.25."),
        (Status.UNRELIABLE, "rk4 reached t = 0.25, and does not follow the motion."),
        (Status.MAX_STEPS, f"rk4 used up max_steps = 7 {WHERE}, where r_dot is 3e+09. Raise max_steps, or"),
        (Status.MAX_WALL, f"rk4 used up max_wall = 0.5 s {WHERE}, where r_dot is 3e+09. Raise max_wall, or"),
        (Status.NON_FINITE, f"rk4 stopped {WHERE}: the derivative of the state is nan or infinite, soon after "),
        (Status.SINGULAR, f"rk4 stopped {WHERE}: the mass matrix is singular there, so "),
        (Status.STEP_TOO_SMALL, f"rk4 stopped {WHERE}: the step that the tolerances ask for is below "),
        (Status.DIVERGED, f"rk4 stopped {WHERE}: the step did not converge. The largest entry of the state: r_dot is "),
        (Status.INTERRUPTED, f"rk4 was interrupted {WHERE}; what was computed until then is kept."),
    ],
)
def test_every_status_has_a_sentence(status: Status, words: str) -> None:
    text = message(status, PROBLEM, 0.25, STATE, "rk4")
    assert text.startswith(words) and text.endswith(".") and "  " not in text


def test_no_status_is_forgotten() -> None:
    assert all(message(status, PROBLEM, 0.25, STATE, "rk4") for status in Status)


def test_what_is_not_finite_is_named_the_state_before_its_derivative() -> None:
    bad = np.array([1.0, np.nan, 0.0, -np.inf])
    slope = np.array([0.0, np.inf, np.nan, 1.0])
    assert "phi is nan and phi_dot is -inf." in message(Status.NON_FINITE, PROBLEM, 0, bad, "rk4", slope=slope)
    text = message(Status.NON_FINITE, PROBLEM, 0, STATE, "rk4", slope=slope)
    assert "the velocity of phi is inf and the acceleration of r is nan." in text
    text = message(Status.NON_FINITE, PROBLEM, 0, np.full(4, np.nan), "rk4")
    assert "r is nan, phi is nan and 2 more." in text


def test_a_known_cause_is_told() -> None:
    text = message(Status.DIVERGED, PROBLEM, 0, STATE, "rk4", detail="The moon is full.")
    assert "4" in text and "The moon is full. Take a shorter step" in text
    text = message(Status.SINGULAR, PROBLEM, 0, STATE, "rk4", detail="the mass matrix is singular at r = 1.")
    assert text.endswith(": the mass matrix is singular at r = 1.")


def test_an_unsolved_step_says_how_far_it_was() -> None:
    text = message(Status.DIVERGED, PROBLEM, 0.25, STATE, "gauss2", detail=unsolved(3.14159e-3))
    assert "The last correction of its unknowns was still 0.0031 of their size" in text
    assert "Take a shorter step, or a method with step control such as radau5" in text


def test_corrections_that_creep_are_not_called_large() -> None:
    text = unsolved(3e-9)
    assert text.startswith("The corrections of its unknowns shrink too slowly: the last was 3e-09 of their size")
    assert "double root" in text and "double root" not in unsolved(3e-3)


SMALL = np.array([1.0, -2.0, 3.0, 4.0])
FROM_ONE = replace(PROBLEM, y0=np.ones(4))
GIVEN_UP = (Status.MAX_STEPS, Status.MAX_WALL)
FINER = (*GIVEN_UP, Status.NON_FINITE, Status.STEP_TOO_SMALL)


@pytest.mark.parametrize("status", FINER)
@pytest.mark.parametrize(
    ("rtol", "words"), [(None, "shorten the step"), (1e-9, r"lower rtol (now 1e-09) and atol"), (1e-2, "lower rtol")]
)
def test_a_state_that_blew_up_asks_for_finer_steps(status: Status, rtol: float | None, words: str) -> None:
    text = message(status, FROM_ONE, 0.25, STATE, "rk4", rtol=rtol)
    assert words in text and "loosen" not in text and "lengthen" not in text


@pytest.mark.parametrize("status", FINER)
def test_a_state_of_its_own_size_asks_for_coarser_ones_unless_they_are_coarse(status: Status) -> None:
    tight, loose, equal = (message(status, FROM_ONE, 0.25, SMALL, "rk4", rtol=rtol) for rtol in (1e-9, 1e-2, None))
    assert "lower" not in tight and ("loosen rtol" in tight or status is Status.NON_FINITE)
    assert ("lengthen the step" if status in GIVEN_UP else "shorten the step") in equal and "rtol" not in equal
    assert ("loosen rtol" if status in GIVEN_UP else "lower rtol (now 0.01) and atol") in loose


def test_a_method_that_diverged_is_not_advised_against_itself() -> None:
    text = message(Status.DIVERGED, FROM_ONE, 0.25, SMALL, "radau5", rtol=1e-9)
    assert "Take another method, such as taylor;" in text and "radau5;" not in text and "shorter" not in text
    assert "such as radau5;" in message(Status.DIVERGED, FROM_ONE, 0.25, SMALL, "scipy-radau", rtol=1e-9)


def test_what_runs_out_of_steps_or_time_may_be_stiff() -> None:
    for status in (Status.MAX_STEPS, Status.MAX_WALL):
        text = message(status, PROBLEM, 0.25, STATE, "rk4")
        assert text.endswith("a stiff system wants an implicit method such as radau5.")


def test_without_a_limit_there_is_no_number_to_quote() -> None:
    endless = Problem(MODEL, {}, 0.0, 1.0, np.zeros(4))
    assert "used up its time at t = 0.5" in message(Status.MAX_WALL, endless, 0.5, STATE, "rk4")


@pytest.mark.parametrize(
    ("status", "limit"), [(Status.MAX_STEPS, "Raise max_steps, or"), (Status.MAX_WALL, "Raise max_wall, or")]
)
def test_a_run_with_events_is_not_sent_to_a_solver_that_refuses_them(status: Status, limit: str) -> None:
    event: Any = SimpleNamespace()
    text = message(status, replace(PROBLEM, events=(event,)), 0.25, STATE, "rk4")
    assert limit in text and "at an event with terminal=True" in text and "such as radau5" in text
    assert "scipy" not in text and "cvode" not in text


def test_an_absolute_tolerance_that_leaves_an_entry_few_digits_is_spoken_of() -> None:
    states = np.array([[1.0, -3e-7, 2.0, 0.0], [0.5, 2e-7, 1.0, 0.0]])
    given = Tolerances(1e-9, 1e-12)
    assert [*coarse(PROBLEM, Status.SUCCESS, states, given)] == [
        "phi does not exceed 3e-07, so atol = 1e-12 leaves it fewer digits than rtol = 1e-09 asks for: leave atol out, "
        "and it follows the size of each entry, or lower it to some 3e-16."
    ]
    assert not [*coarse(PROBLEM, Status.SUCCESS, states, Tolerances(1e-9, 1e-16))]
    assert not [*coarse(PROBLEM, Status.SUCCESS, states, Tolerances(1e-9, 1e-300, 1e-12))]  # it follows the scale
    assert not [*coarse(PROBLEM, Status.SUCCESS, states, Tolerances(step=0.1))]
    assert not [*coarse(PROBLEM, Status.MAX_STEPS, states, given)]  # what ended the run is said, and nothing beside it
    least = Tolerances(1e-9, 1e-300, 1e-12)
    assert [*coarse(PROBLEM, Status.SUCCESS, 1e-300 * states, least)] == [
        "phi does not exceed 3e-307, near the smallest of all doubles, and has fewer digits than rtol = 1e-09 asks "
        "for: choose units in which its numbers are larger."
    ]
    noise = np.array([[1.0, 1e-16, 2.0, 1e-15]])
    assert not [*coarse(PROBLEM, Status.SUCCESS, noise, given)]  # round-off needs no digits
    mixed = [*coarse(PROBLEM, Status.SUCCESS, np.array([[1.0, -3e-7, 2.0, 1e-15]]), given)]
    assert mixed[0].endswith("asks for: lower it to some 3e-16.")  # without atol steps would follow phi_dot
