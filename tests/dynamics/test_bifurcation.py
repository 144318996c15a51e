"""Bifurcation diagrams: period doubling at published values, hysteresis, and branches of equilibria in formulas."""

import re
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, sin, sinh

import lagrange as lg
from lagrange.dynamics.runs import Runs, depends_on_time, driving_period
from lagrange.errors import StatementError
from lagrange.show.dynamics import Bifurcation, EquilibriumBranches
from tests.dynamics.planar import F, duffing, hoop, interrupting, m, mu, pendulum, w, x
from tests.models import shared_scene
from tests.refusals import refusal


def swept(*arguments: Any, **named: Any) -> Bifurcation:
    result = lg.bifurcation(*arguments, **named)
    assert isinstance(result, Bifurcation)
    return result


def branched(*arguments: Any, **named: Any) -> EquilibriumBranches:
    result = lg.bifurcation(*arguments, **named)
    assert isinstance(result, EquilibriumBranches)
    return result


def test_the_periods_of_the_driven_duffing_oscillator_are_the_published_ones() -> None:
    """D. W. Jordan, P. Smith, Nonlinear Ordinary Differential Equations, 4th ed., 2007, section 13.3: with damping 0.3
    and frequency 1.2, from x = 1 at rest, periods are 1, 2, 4 and 5, chaos at 0.5, and 2 at 0.65."""
    result = swept(duffing(), F, [0.20, 0.28, 0.29, 0.37, 0.50, 0.65], follow=False, points=40, skip=400)
    assert result.cycles[:, 0].tolist() == [1, 2, 4, 5, 0, 2]
    assert result.states.shape == (6, 1, 40, 2)
    assert result.periods == pytest.approx([2 * np.pi / 1.2] * 6)
    assert result.status is lg.Status.SUCCESS


def test_rising_and_falling_values_show_hysteresis() -> None:
    """x'' + 0.1 x' + x + x^3 = 0.5 cos(w t) has two stable cycles between the folds of its resonance.

    At w = 1.7 harmonic balance, (1 - w^2 + 3 A^2/4)^2 A^2 + (0.1 w A)^2 = 0.25, gives A = 0.275 and A = 1.84.
    """
    hard = lg.System(
        kinetic=x.dot**2 / 2,
        potential=x**2 / 2 + x**4 / 4,
        forces={x: -x.dot / 10 + cos(w * lg.t) / 2},
        parameters={w: 1.0},
    )
    values = np.linspace(1.2, 2.3, 23)
    up = swept(hard, w, values, points=4, skip=60)
    down = swept(hard, w, values[::-1], points=4, skip=60)
    at = int(np.argmin(np.abs(values - 1.7)))
    large, small = (np.hypot(s[0], s[1] / 1.7) for s in (up.states[at, 0, -1], down.states[22 - at, 0, -1]))
    assert large == pytest.approx(1.84, rel=0.1)
    assert small == pytest.approx(0.275, rel=0.1)
    assert up.states[0, 0, -1] == pytest.approx(down.states[-1, 0, -1], abs=0.05)
    assert up.periods is not None
    assert up.periods == pytest.approx(2 * np.pi / values)


@pytest.mark.slow
def test_any_system_is_looked_at_where_an_event_happens() -> None:
    """Van der Pol's oscillator passes x = 0 upwards with the speed 2 + O(mu^2), and with 2.614973 for mu = 2.

    The last value is from SciPy's DOP853 at rtol = 1e-10.
    """
    system = lg.System(
        kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: mu * (1 - x**2) * x.dot}, parameters={mu: 1.0}
    )
    result = swept(
        system, "mu", [0.1, 2.0], section=lg.event(x, direction=1), starts=[{x: 1.0}, {x: 3.0}], points=6, skip=60
    )
    assert result.cycles.tolist() == [[1, 1], [1, 1]]
    assert result.states[0, :, :, 1] == pytest.approx(np.full((2, 6), 2.0), rel=0.01)
    assert result.states[1, :, :, 1] == pytest.approx(np.full((2, 6), 2.614973), rel=1e-6)
    assert result.event is not None
    assert result.periods is None


def test_a_bead_leaves_the_bottom_of_a_hoop_at_a_pitchfork() -> None:
    """theta = acos(g/(r w^2)) exists from w^2 = g/r on, where the bottom loses its stability."""
    result = branched(hoop(), "w", (2.0, 8.0, 25))
    critical = np.sqrt(9.81 / 0.5)
    assert len(result.branches) == 4
    by_end = sorted(result.branches, key=lambda branch: branch.coordinates[-1, 0])
    low, bottom, high, top = by_end
    for branch, sign in ((high, 1), (low, -1)):
        there = np.isfinite(branch.coordinates[:, 0])
        assert branch.values[there].min() == pytest.approx(critical, rel=1e-12)
        expected = sign * np.arccos(np.minimum(1.0, critical**2 / branch.values[there] ** 2))
        assert branch.coordinates[there, 0] == pytest.approx(expected, abs=1e-6)
        assert (branch.stable[there][1:] == 1).all()
    assert np.array_equal(bottom.stable == 1, bottom.values < critical)
    assert (top.stable == 0).all()
    assert result.axis == "theta"


@pytest.mark.slow
def test_branches_without_formulas_are_followed_from_several_values() -> None:
    """x'' = mu + x - sinh(x^3) - x' has three equilibria between two folds, and one elsewhere."""
    system = lg.System(
        kinetic=x.dot**2 / 2, potential=-mu * x - x**2 / 2, forces={x: -sinh(x**3) - x.dot}, parameters={"mu": 0.0}
    )
    result = branched(system, "mu", np.linspace(-1, 1, 41))
    middle = [branch.coordinates[20, 0] for branch in result.branches if np.isfinite(branch.coordinates[20, 0])]
    assert len(np.unique(np.round(middle, 6))) == 3
    assert all(not branch.formula for branch in result.branches)
    for branch in result.branches:
        there = np.isfinite(branch.coordinates[:, 0])
        place = branch.coordinates[there, 0]
        assert np.abs(branch.values[there] + place - np.sinh(place**3)).max() < 1e-9
        assert np.array_equal(branch.stable[there] == 1, 3 * place**2 * np.cosh(place**3) > 1)


def test_the_period_of_a_driving_is_read_from_its_waves() -> None:
    def driven(force: Any) -> Any:
        return lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: force}, parameters={w: 1.5}).statement

    t = lg.t
    assert driving_period(driven(cos(w * t)), {w: 1.5}) == pytest.approx(2 * np.pi / 1.5)
    assert driving_period(driven(cos(2 * t) + sin(3 * t + 1)), {}) == pytest.approx(2 * np.pi)
    assert driving_period(driven(cos(2 * t) ** 2), {}) == pytest.approx(np.pi / 1)
    assert not depends_on_time(driven(x.dot))
    assert depends_on_time(driven(t))
    for force, says in (
        (t, "the period of the driving of system was not found, because t appears outside"),
        (cos(t**2), "was not found"),
        (cos(t) + t * sin(t), "was not found"),
        (cos(t) + cos(2**0.5 * t), "has the frequencies 1 and 1.41421, which have no common period"),
        (cos(0 * w + (w - 1.5) * t), "has the frequency zero"),
    ):
        assert re.search(says, refusal(driving_period, driven(force), {w: 1.5}))


def test_ctrl_c_keeps_the_values_that_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Runs, "__call__", interrupting(3)(Runs.__call__))
    result = swept(duffing(), F, (0.2, 0.3, 10), points=5, skip=1)
    assert result.status is lg.Status.INTERRUPTED
    assert result.message == "interrupted: 3 of 10 values of F were computed and are kept."
    assert np.isfinite(result.states).all(axis=(1, 2, 3)).tolist() == [True] * 3 + [False] * 7


def test_motions_that_run_away_leave_gaps_and_begin_anew() -> None:
    system = lg.System(
        kinetic=x.dot**2 / 2, potential=x**2 / 2 - x**4 / 4, forces={x: -x.dot / 5 + F * cos(lg.t)}, parameters={F: 0.1}
    )
    result = swept(system, F, [0.1, 5.0, 0.1], points=4, skip=40)
    assert np.isfinite(result.states).all(axis=(1, 2, 3)).tolist() == [True, False, True]
    assert "1 ended early" in result.message
    assert not result.status.complete
    assert result.states[2] == pytest.approx(result.states[0], abs=1e-3)


@pytest.mark.parametrize(
    ("system", "arguments", "says"),
    [
        (duffing, (F, [1.0, 2.0], {"points": 1}), "points = 1"),
        (duffing, (F, [1.0, 2.0], {"follow": 2}), "follow = 2: give True or False"),
        (hoop, (w, [1.0, 2.0], {"starts": [{}]}), "is not driven in time, so .* equilibria, which need no starts"),
        (duffing, ("f", [1.0]), "'f' is not a parameter of this system; its parameters are F and w"),
        (duffing, (x, [1.0]), "x is not a parameter but an entry of the state of Duffing"),
        (duffing, (F, (0.3, 0.3, 9)), "the range of F is empty: all values are 0.3"),
        (duffing, (F, np.ones(5000)), "there are 5000 values of F, more than a picture has columns: give 4096 at most"),
        (hoop, ("r", [1.0, -1.0]), "parameter r is -1"),
        (pendulum, ("g", [1.0]), "'g' is not a parameter of this system; its parameters are none"),
    ],
)
def test_what_cannot_be_meant_is_refused(system: Any, arguments: tuple[Any, ...], says: str) -> None:
    name, values, *options = arguments
    assert re.search(says, refusal(lg.bifurcation, system(), name, values, **(options[0] if options else {})))


# --- mode shapes ----------------------------------------------------------------------------------------------
# Shapes of modes, compared with closed forms of linear systems.


k = lg.parameters("k")


def test_displacements_are_the_derivatives_of_the_positions() -> None:
    """Displacements of a double pendulum with one arm upright are compared with differences."""
    system = shared_scene("double-pendulum")
    modes = system.modes({"theta2": np.pi})
    shapes = modes.shapes_in_numbers()
    expected = [complex(f.subs(system.parameters)) for f in modes.frequencies]
    assert np.asarray(shapes.frequencies, complex) == pytest.approx(np.array(expected), abs=1e-12)
    assert np.abs(shapes.components).max(axis=1) == pytest.approx(1)
    names = [q.name for q in system.statement.plain.values()]
    assert names[0] == "theta1"
    values = {p.name: v for p, v in system.parameters.items()}
    l1, l2 = values["l1"], values["l2"]

    def second(q1: float, q2: float) -> Any:
        return np.array([l1 * np.sin(q1) + l2 * np.sin(q2), -l1 * np.cos(q1) - l2 * np.cos(q2)])

    last = list(system.statement.positions)[-1]
    assert shapes.points[last] == pytest.approx(second(0.0, np.pi))
    for row, (b1, b2) in zip(shapes.displacements[last], shapes.components, strict=True):
        h = 1e-6
        assert row == pytest.approx(
            (second(h * b1, np.pi + h * b2) - second(-h * b1, np.pi - h * b2)) / (2 * h), abs=1e-8
        )


def test_shapes_want_values_of_the_parameters() -> None:
    open_ended = lg.System(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1.0})
    assert "shapes are drawn at values of the parameters, and k has no v" in refusal(lambda: open_ended.modes().plot())


def test_an_equilibrium_at_a_jump_of_a_force_is_no_branch() -> None:
    k = lg.parameters("k")
    sliding = lg.System(x.dot**2 / 2, k * x**2 / 2 - cos(x), forces={x: -sympy.sign(x.dot)}, parameters={k: 1})
    with pytest.raises(StatementError, match=r"the forces on x have a corner or a jump at x = 0.*, where x_dot is zer"):
        lg.bifurcation(sliding, k, [0.5, 1.0, 2.0])
    assert "the forces on x have a corner or a jump at x = 0, w" in refusal(sliding.eigenvalues, k, [1.0, 2.0], {x: 0})
    smooth = lg.System(x.dot**2 / 2, k * x**2 / 2 - cos(x), forces={x: -abs(x.dot) * x.dot}, parameters={k: 1})
    assert smooth.eigenvalues(k, [1.0, 2.0], {x: 0}).stable.all()
