"""Initial states on the constraints: the nearest one, the note about a moved state, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, Piecewise, cos, sin, sqrt

import lagrange as lg
from lagrange.trajectory.constraints.consistent import consistent_start, violation
from tests.models import g, l, m, theta, x, y, z
from tests.refusals import refusal
from tests.systems import rod_pendulum

LENGTH = {m: 1.3, g: 9.81, l: 1.0}


def pendulum(constraint: Any = None, **options: Any) -> lg.System:
    """Return a pendulum in Cartesian coordinates, or the same particle on another constraint."""
    rod = {} if constraint is None else {"constraints": {"rod": constraint}}
    return rod_pendulum(parameters=LENGTH, **rod, **options)


def test_the_nearest_point_of_a_circle_is_in_line_with_its_centre() -> None:
    result = pendulum().consistent({x: 0.9, y: -1.2, x.dot: 1.0})
    assert list(result.initial) == [x, y, x.dot, y.dot]
    # On the circle along the radius; of the velocity (1, 0) the part along the tangent (0.8, 0.6) is left.
    assert result.initial[x] == pytest.approx(0.6, abs=1e-9) and result.initial[y] == pytest.approx(-0.8, abs=1e-9)
    assert result.initial[x.dot] == pytest.approx(0.64, abs=1e-9)
    assert result.initial[y.dot] == pytest.approx(0.48, abs=1e-9)
    assert result.entry == y.dot and result.moved == pytest.approx(0.48, abs=1e-9)
    assert result.changes[x] == pytest.approx(-0.3, abs=1e-9)
    assert "moved by at most 0.48, in y.dot>" in repr(result)


def test_what_is_held_stays() -> None:
    result = pendulum().consistent({x: 0.7, y: -0.9, x.dot: 1.0}, hold=[x, "x_dot"]).initial
    assert result[x] == 0.7 and result[x.dot] == 1.0
    assert result[y] == pytest.approx(-sqrt(1 - 0.49), abs=1e-12)
    assert result[x] * result[x.dot] + result[y] * result[y.dot] == pytest.approx(0.0, abs=1e-12)


def test_a_state_on_the_constraints_stays_as_it_is() -> None:
    result = pendulum().consistent()
    assert result.moved == 0.0 and result.entry is None and result.initial == {x: 0.6, y: -0.8, x.dot: 0.0, y.dot: 0.0}
    assert repr(result).endswith("nothing moved>")


def test_a_velocity_constraint_moves_velocities_alone() -> None:
    knife = lg.System(
        kinetic=(x.dot**2 + y.dot**2 + theta.dot**2) / 2,
        coordinates=[x, y, theta],
        constraints={"blade": sin(theta) * x.dot - cos(theta) * y.dot},
    )
    result = knife.consistent({theta: 0.3, x.dot: 1.0}).initial
    assert (result[x], result[y], result[theta], result[theta.dot]) == (0.0, 0.0, 0.3, 0.0)
    assert np.tan(0.3) * result[x.dot] == pytest.approx(result[y.dot], abs=1e-12)


def test_a_singular_mass_matrix_that_is_definite_on_the_surface() -> None:
    system = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, potential=x, coordinates=[x, y, z], constraints={"height": z - x * y}
    )
    result = system.consistent({x: 2.0, y: 3.0, z: 5.0, x.dot: 1.0}).initial
    # z has no inertia: its change costs nothing, and it alone moves.
    assert (result[x], result[y]) == pytest.approx((2.0, 3.0), abs=1e-9) and result[z] == pytest.approx(6.0, abs=1e-9)
    assert result[z.dot] == pytest.approx(3.0, abs=1e-9)


@pytest.mark.parametrize("target", ["numpy", "llvm"])
def test_a_run_moves_what_rounding_left_and_says_it(target: str) -> None:
    given = {x: 0.70710678, y: -0.70710678}
    solution = pendulum().run(0.1, given, target=target, check=False)
    assert solution.y[0, 0] ** 2 + solution.y[1, 0] ** 2 == pytest.approx(1.0, abs=1e-15)
    assert "The initial state was moved onto the constraints, by at most 1.2e-09, in x." in solution.message
    exact = pendulum().run(0.1, target=target, check=False)
    assert "moved" not in exact.message and exact.y[:, 0].tolist() == [0.6, -0.8, 0.0, 0.0]


def test_round_off_is_not_moved() -> None:
    angle = 2.0
    state = {x: np.cos(angle), y: np.sin(angle), x.dot: -3 * np.sin(angle), y.dot: 3 * np.cos(angle)}
    solution = pendulum().run(0.1, state, check=False)
    assert solution.y[:, 0].tolist() == list(state.values()) and "moved" not in solution.message
    lying = pendulum(y).run(0.1, {x: 1.0, y: 1e-17}, check=False)
    assert lying.y[1, 0] == 1e-17 and "moved" not in lying.message


def test_the_flow_moves_and_refuses_as_a_run_does() -> None:
    flow = lg.flow(pendulum().compile(check=False))
    near, exact = np.array([0.6, -0.8 + 1e-9, 0.0, 0.0]), np.array([0.6, -0.8, 0.0, 0.0])
    assert flow(near, 0.0, 0.1) == pytest.approx(flow(exact, 0.0, 0.1), abs=1e-8)
    at_once = flow(near, 0.0, 0.0)
    assert at_once[0] ** 2 + at_once[1] ** 2 == pytest.approx(1.0, abs=1e-15)
    assert "'rod'" in refusal(flow, np.array([0.6, -0.7, 0.0, 0.0]), 0.0, 0.1)


def started(constraint: Any, initial: Any) -> str:
    """Return the message that refuses a run of a particle on a constraint."""
    return refusal(pendulum(constraint).run, 1.0, initial, check=False)


KNIFE = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, constraints={"blade": x.dot - 2 * y.dot})
THREE = lg.System(kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2, constraints={"a": x - 1, "b": y - z, "c": z})
HEAVY = lg.System(kinetic=x.dot**2 / x + y.dot**2, coordinates=[x, y], constraints={"line": x - y})
REFUSED: list[tuple[Callable[[], str], tuple[str, ...]]] = [
    (
        lambda: started(None, {x: 0.7, y: -0.7}),
        (
            "the initial state does not satisfy the constraint at t = 0: 'rod' (-l**2 + x**2 + y**2) is -0.02",
            "with terms of size 1.98",
            "or take the nearest ones, system.consistent({'x': 0.7, 'y': -0.7}).initial.",
        ),
    ),
    (
        lambda: started(None, {x.dot: 1.0}),
        (
            "the initial velocities do not satisfy the constraint at t = 0: 'rod' (the rate of change of -l**2",
            "is 1.2, with terms of size 1.2.",
        ),
    ),
    (
        lambda: refusal(KNIFE.run, 1.0, {x.dot: 1.0}, check=False),
        ("'blade' (x_dot - 2*y_dot) is 1, with terms of size 1",),
    ),
    (
        lambda: refusal(THREE.run, 1.0, {y: 0.5}, check=False),
        ("the constraints at t = 0: 'a' (x - 1) is -1, with terms of size 1 and 'b' (y - z) is 0.5",),
    ),
    (
        lambda: refusal(pendulum().consistent, {x: 1.2}, hold=[x]),
        (
            "no state near the one given satisfies the constraint 'rod'",
            "Hold fewer values (held: x), or give others.",
        ),
    ),
    (
        lambda: refusal(pendulum(x**2 + y**2 + l**2).consistent, {x: 1.2}),
        ("Give values that are nearer to them, and look for constraints that contradict one another.",),
    ),
    (
        lambda: refusal(pendulum().consistent, {x: 0.0, y: 0.0}),
        (
            "'rod' (-l**2 + x**2 + y**2) stays at -1",
            "All its derivatives vanish there: give a state away from it.",
        ),
    ),
    (
        lambda: started(sqrt(x**2 + y**2) - l, {x: 0.0, y: 0.0}),
        (
            "the constraint 'rod', -l + sqrt(x**2 + y**2) = 0, is not differentiable at the initial state (x = 0",
            "such as x**2 + y**2 - l**2 for sqrt(x**2 + y**2) - l",
        ),
    ),
    (
        lambda: started(y - Abs(x), {x: 0.0, y: 0.0}),
        ("the constraint 'rod', y - Abs(x) = 0, is not differentiable at the initial state",),
    ),
    (
        lambda: started(sp.log(x) - y, {x: -1.0, y: 0.0}),
        ("the constraint 'rod', -y + log(x) = 0, has no finite value at the initial state (x = -1, y = 0",),
    ),
    (
        lambda: refusal(HEAVY.consistent, {y: 1.0}),
        ("the mass matrix is not finite at the initial state (x = 0, y = 1",),
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=lambda case: case[0][:30] if isinstance(case, tuple) else "")
def test_a_start_is_refused_by_name(call: Callable[[], str], words: tuple[str, ...]) -> None:
    text = call()
    assert all(part in text for part in words), text
    assert "'c'" not in text


def test_a_constraint_that_is_differentiable_enough_is_run() -> None:
    smooth = pendulum(y - Piecewise((x**3, x > 0), (0, True)))
    assert smooth.run(0.1, {x: 0.0, y: 0.0, x.dot: 1.0}, check=False).status is lg.Status.SUCCESS


@pytest.mark.parametrize("hold", [3, x, [z], ["nothing"], [[x]]])
def test_what_is_held_must_be_entries_of_the_state(hold: Any) -> None:
    text = refusal(pendulum().consistent, {}, hold=hold)
    assert "hold is " in text or "which is not a coordinate or velocity of this system: they are x, x_dot" in text


def test_a_start_on_the_constraints_is_not_projected(monkeypatch: pytest.MonkeyPatch) -> None:
    model = pendulum().compile(check=False)
    state, parameters = np.array([0.6, -0.8, 0.0, 0.0]), model.parameter_array()
    monkeypatch.delattr("lagrange.trajectory.constraints.consistent.Projection")
    assert consistent_start(model, 0.0, state, parameters) is state
    with pytest.raises(NameError):
        consistent_start(model, 0.0, state + 1e-8, parameters)


def test_a_run_that_ends_off_its_constraints_is_unreliable() -> None:
    """Friction hides the loss of energy. Solvers of other packages do not project onto constraints."""
    damped = pendulum(forces={x: -x.dot / 10})
    solution = damped.run(100.0, method="scipy-rk45", rtol=1e-2, atol=1e-2)
    assert solution.status is lg.Status.UNRELIABLE, solution.message
    assert "The state at the end violates the constraint 'rod' by" in solution.message


@pytest.mark.parametrize("method", ["dop853", "dopri5", "taylor"])
def test_a_run_that_ends_where_a_pendulum_turns_around_is_reliable(method: str) -> None:
    """All velocities are errors there, in any direction: the run was called unreliable."""
    released = lg.System((x.dot**2 + y.dot**2) / 2, 9.81 * y, constraints={"rod": x**2 + y**2 - 1})
    start = {x: 0.6, y: -0.8}
    solution = released.run(20.0, start, method=method, rtol=1e-8, events=[lg.event(x.dot, terminal=1)])
    assert solution.status is lg.Status.EVENT, solution.message


def test_a_state_on_a_corner_is_no_end_of_a_run() -> None:
    """Methods of other packages may end on a corner of a constraint."""
    model = pendulum(y - Abs(x)).compile(check=False)
    told = violation(model, 0.0, np.array([0.0, 0.0, 1.0, 1.0]), model.parameter_array(), 1.0, np.zeros(2))
    assert told.startswith("The run ends on a corner of the constraint 'rod', where velocities jump")


@pytest.mark.parametrize(("speed", "unreliable"), [(1e-17, False), (1e-10, True)])
def test_round_off_of_a_structure_that_cannot_move_is_not_unreliable(speed: float, unreliable: bool) -> None:
    """There are as many bars as coordinates, so only rounding errors of a velocity are allowed."""
    truss = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=y,
        constraints={"left": x - y - 1, "right": x - 2 * y - 1},
        initial={x: 1.0},
    ).compile()
    told = violation(truss, 1.0, np.array([1.0, 0.0, speed, -speed]), truss.parameter_array(), 1.0, np.zeros(2))
    assert bool(told) is unreliable


def test_the_advice_on_an_initial_state_may_be_pasted() -> None:
    """The call in the message can be executed: it has the parameters, the time, and all entries."""
    x0 = {"x": 0.6, "y": -0.8, "x_dot": 0.8, "y_dot": 0.6}
    system = pendulum()
    text = refusal(system.run, 1.0, x0, parameters={"l": 2}, t_start=1.5, check=False)
    call = text.rpartition("or take the nearest ones, ")[2].removesuffix(".initial.")
    assert call == f"system.consistent({x0}, parameters={{'l': 2.0}}, t=1.5)"
    result = eval(call, {"system": system})
    assert system.run(1.0, result.initial, parameters={"l": 2}, t_start=1.5, check=False).status is lg.Status.SUCCESS


def test_where_no_nearest_state_is_found_none_is_advised() -> None:
    text = refusal(pendulum(initial={}).run, 1.0, check=False)
    assert "consistent" not in text
    assert "no nearest state is found from this one, so give initial values, of coordinates first." in text


def test_states_and_constraints_near_the_ends_of_doubles_are_refused_in_words() -> None:
    """Matrices with such entries are scaled without underflow, and no step overflows."""
    assert "no state" in refusal(pendulum().consistent, {x: 1e-300, y: 0.0})
    tiny = pendulum((x**2 + y**2 - l**2) * 1e-170)
    run = tiny.run(0.1, check=False)
    assert run.status is lg.Status.SINGULAR or np.abs(run[x] ** 2 + run[y] ** 2 - 1).max() < 1e-9
