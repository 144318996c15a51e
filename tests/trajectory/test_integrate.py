"""What comes back from a run: shapes, the start, the parameters' values, and limits on what is kept."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.integrate import integrate
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, VALUES, build, k, m, model, x, y
from tests.trajectory.runs import NAMES, run


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_trajectory_has_its_start_its_end_and_its_shapes(name: str, target: str) -> None:
    compiled = model("Henon-Heiles", target)
    found = run(compiled, 1.0, name, initial={x: 0.25, y.dot: 0.5})
    assert found.t[0] == 0.0 and found.t[-1] == 1.0 and found.span == (0.0, 1.0)
    assert list(found.y[:, 0]) == [0.25, 0.2, 0.3, 0.5]  # what is not named keeps the statement's value
    assert found.y.shape == (4, found.steps + 1) and found.t.shape == (found.steps + 1,)
    assert found.y.dtype == found.t.dtype == np.float64
    assert found.method == name and found.status is Status.SUCCESS and found.wall > 0
    assert found.message.startswith(f"{name} reached t = 1.")
    assert isinstance(found.steps, int) and isinstance(found.evaluations, int)


def test_the_values_of_all_parameters_come_back() -> None:
    compiled = build(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2)
    _, values = integrate(compiled, (0, 1), {"x": 1}, RunOptions(parameters={"k": 5}))
    assert {symbol.name: value for symbol, value in values.items()} == {"m": VALUES[m], "k": 5.0}


def test_the_default_method_is_the_one_that_is_documented() -> None:
    found, _ = integrate(model("oscillator"), (0.0, 1.0))
    assert found.method == DEFAULT_METHOD == "taylor"


@pytest.mark.parametrize("span", [(0, 1), [0.0, 1.0], np.array([0.0, 1.0]), (np.float64(0), np.int64(1))])
def test_a_span_is_any_two_numbers(span: Any) -> None:
    found, _ = integrate(model("oscillator"), span)
    assert found.span == (0.0, 1.0)


def test_the_start_may_be_keyed_by_symbol_or_name() -> None:
    starts: list[Any] = [{x: 0.5, x.dot: 2}, {"x": 0.5, "x_dot": 2}, {"x": np.float64(0.5), x.dot: 2.0}]
    for start in starts:
        assert list(run(model("oscillator"), 0.1, "rk4", initial=start).y[:, 0]) == [0.5, 2.0]


def test_output_times_may_be_whole_numbers_and_repeat() -> None:
    found = run(model("oscillator"), 4.0, "dop853", t_eval=[0, 1, 1, 4])
    assert list(found.t) == [0, 1, 1, 4] and (found.y[:, 1] == found.y[:, 2]).all()


def test_a_run_does_not_touch_what_it_was_given() -> None:
    times = np.linspace(0, 1, 5)
    start, values = {"x": 0.5}, {"k": 2.0}
    run(model("oscillator"), 1.0, "dop853", initial=start, parameters=values, t_eval=times)
    assert start == {"x": 0.5} and values == {"k": 2.0} and (times == np.linspace(0, 1, 5)).all()


def test_runs_do_not_share_their_arrays() -> None:
    first, second = (run(model("oscillator"), 1.0, "rk4", step=0.1) for _ in range(2))
    kept = second.y.copy()
    first.y[:] = 0.0
    first.t[:] = 0.0
    assert (second.y == kept).all() and second.t[-1] == 1.0


def falling(potential: Any, **given: Any) -> Any:
    return build(kinetic=x.dot**2 / 2, potential=potential, initial={x: 1.0}, **given)


LOST = r"The energy, which the equations of motion conserve, went from -1 to \S+: the run does not follow the motion\. "


def test_a_run_that_loses_the_energy_is_unreliable() -> None:
    """Equal steps jump through the centre of an attraction, and come out with an energy of their own."""
    found = run(falling(-1 / x), 3.0, "verlet", step=1e-3)
    assert found.status is Status.UNRELIABLE and not found.status.complete
    assert re.search(LOST + "Shorten the step, or take an adaptive method such as dop853", found.message)
    sound = run(falling(-1 / x), 1.0, "verlet", step=1e-3)
    assert sound.status is Status.SUCCESS and not re.search("energy", sound.message)


@pytest.mark.parametrize(("method", "other"), [("dop853", "taylor"), ("scipy-rk45", "taylor"), ("taylor", "dop853")])
def test_a_loss_of_energy_by_step_control_asks_for_a_lower_tolerance(method: str, other: str) -> None:
    """Tolerances far above the state: no method is advised against itself."""
    pendulum = build(kinetic=x.dot**2 / 2, potential=-sp.cos(x), initial={x: 2.0})
    found = run(pendulum, 4000.0, method, rtol=0.9, atol=100.0)
    assert found.status is Status.UNRELIABLE
    assert f"Lower rtol (now 0.9) and atol, or take another method, such as {other}." in found.message
    assert "Shorten" not in found.message


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e4])
def test_where_the_potential_is_zero_does_not_matter(offset: float) -> None:
    found = run(falling(offset - 1 / x), 3.0, "verlet", step=1e-3)
    assert found.status is Status.UNRELIABLE
    euler = run(build(kinetic=x.dot**2 / 2, potential=offset + x**2 / 2, initial={x: 1.0}), 10.0, "euler", step=0.05)
    assert euler.status is Status.UNRELIABLE and euler.y[0, -1] ** 2 + euler.y[1, -1] ** 2 > 1.5


def test_where_the_run_ends_does_not_matter() -> None:
    """From rest through the centre, where both parts of the energy are large, and out again: wrong from there on."""
    well = build(kinetic=x.dot**2 / 2, potential=-1 / sp.sqrt(x**2 + sp.Rational(1, 10**8)), initial={x: 1.0})
    whole = run(well, 6.0, "rk4", step=2e-3)
    assert whole.status is Status.UNRELIABLE
    passed = int(np.argmin(np.abs(whole.y[0])))
    for t in whole.t[passed + 1 : passed + 20]:
        assert run(well, float(t), "rk4", step=2e-3).status is Status.UNRELIABLE, t


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
@pytest.mark.parametrize("times", [None, [0.0, 7.416298709205487]])
def test_a_run_that_ends_where_the_motion_turns_is_sound(method: str, times: Any) -> None:
    """A pendulum from 90 degrees, where V = 0, for one period: nothing moves at either end, and E0 is not a scale."""
    pendulum = build(kinetic=x.dot**2 / 2, potential=-sp.cos(x), initial={x: math.pi / 2})
    found = run(pendulum, 7.416298709205487, method, t_eval=times)
    assert found.status is Status.SUCCESS and abs(found.y[1, -1]) < 1e-6


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_a_body_at_rest_is_sound(method: str) -> None:
    """0.3 is not the double 0.1 + 0.2: the energy is that of round-off, and grows."""
    spring = build(kinetic=x.dot**2 / 2, potential=(x - 0.1 - 0.2) ** 2 / 2, initial={x: 0.3})
    found = run(spring, 200.0, method)
    assert found.status is Status.SUCCESS and abs(found.y[0, -1] - 0.3) < 1e-9


@pytest.mark.parametrize("system", ["coupled masses", "pendulum", "double pendulum"])
def test_a_rough_run_is_not_called_wrong(system: str) -> None:
    """From rest for one step and more: the energy is off by all that moves at first, and the state by 1e-4."""
    for method in ("euler", "backward-euler"):
        for end in (0.01, 0.1, 0.5):
            assert run(model(system), end, method, step=0.013).status is Status.SUCCESS, (method, end)


def test_a_run_with_resets_is_held_to_the_energy_until_the_first() -> None:
    far = lg.event(x + 20, reset={x.dot: -x.dot / 2})
    lost = run(falling(-1 / x), 3.0, "verlet", step=1e-3, events=[far])
    assert lost.t_events[0].size and lost.status is Status.UNRELIABLE
    never = lg.event(x + 1e6, reset={x.dot: -x.dot / 2})
    assert run(falling(-1 / x), 3.0, "verlet", step=1e-3, events=[never]).status is Status.UNRELIABLE


def test_an_event_at_the_end_of_a_lost_run_is_no_excuse() -> None:
    found = run(falling(-1 / x), 3.0, "verlet", step=1e-3, events=[lg.event(x + 20, terminal=True)])
    assert found.status is Status.UNRELIABLE and "stopped at an event" in found.message and len(found.t_events[0]) == 1


def test_an_energy_that_is_free_to_change_is_not_spoken_of() -> None:
    pushed = build(kinetic=x.dot**2 / 2, forces={x: 1}, coordinates=[x], initial={x.dot: 1.0})
    assert "energy" not in run(pushed, 10.0, "euler", step=0.1).message
    bounced = lg.event(x, direction=-1, reset={x.dot: -x.dot / 2})
    stopped = run(falling(x), 2.0, "taylor", events=[bounced])
    assert len(stopped.t_events[0]) == 1 and "energy" not in stopped.message


def test_an_energy_without_a_value_at_the_end_is_spoken_of() -> None:
    """Two steps jump from x = 1 over the edge of log(x), whose force 1/x has values on both sides."""
    found = run(falling(sp.log(x)), 4.0, "euler", step=2.0, initial={x: 1.0, x.dot: -3.0})
    assert re.search("went from 4.5 to nan: the run does not follow the motion", found.message)


def test_an_energy_that_overflows_at_the_end_is_spoken_of() -> None:
    """A method that leaves for 1e98 at a speed of 1e99: T = x^2 v^2/2 has no double, and its parts are infinite."""

    class Leaving:
        name, claims = "leaving", lg.Claims(order=2)

        def integrate(self, problem: lg.Problem) -> lg.Trajectory:
            ends = np.array([problem.t0, problem.t1])
            y = np.stack([problem.y0, [1e98, 7e99]], axis=1)
            return lg.Trajectory(ends, y, Status.SUCCESS, "leaving.", "leaving", 1, 0, 1, 0.1, (0.0, 1.0), lambda t: y)

    heavy = build(kinetic=x**2 * x.dot**2 / 2, coordinates=[x], initial={x: 1.0, x.dot: -1.0})
    assert "went from 0.5 to inf: the run does not follow" in run(heavy, 1.0, Leaving()).message
