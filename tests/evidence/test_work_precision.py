"""Races: errors against closed forms, failed runs in the table, references, and refusals."""

import math
import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from sympy import sign

import lagrange as lg
from lagrange.errors import RunError
from lagrange.evidence import trust_horizon as reference_solution
from lagrange.evidence import work_precision
from lagrange.evidence.precise_run import precise_run
from lagrange.evidence.trust_horizon import sensitivity
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import build, k, m, model, shared_scene, x, y
from tests.refusals import refusal

SPRING = lg.System(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 4}, initial={x: 1.0})
END = 5.0
EXACT = np.array([math.cos(2 * END), -2 * math.sin(2 * END)])
HILL = lg.System(kinetic=m * x.dot**2 / 2, potential=-k * x**2 / 2, parameters={m: 1, k: 1}, initial={x: 1.0})
PAIR = lg.System(
    kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * (x**2 + y**2) / 2, parameters={m: 1, k: 4}, initial={x: 1e3}
)


def race(system: Any = SPRING, end: float = END, **options: Any) -> lg.Race:
    quick: dict[str, Any] = {"methods": ["dop853"], "tolerances": [1e-6], "steps": [0.01], "repeats": 1, "digits": 20}
    return lg.race(system, end, **quick | options)


@dataclass(frozen=True)
class Scripted:
    """A method whose runs end with a given status, are said to take a given time, and are counted."""

    status: Status = Status.SUCCESS
    wall: float = 1e-3
    runs: list[float] = field(default_factory=list)
    name: str = "scripted"
    claims: Claims = field(default_factory=lambda: Claims(order=4))

    def integrate(self, problem: Problem) -> Trajectory:
        self.runs.append(problem.t1)
        result: Trajectory = lg.methods.RK4().integrate(problem)
        return replace(result, status=self.status, message="as told", wall=self.wall)


# --- errors, times and costs --------------------------------------------------------------------------------


def test_errors_are_those_against_the_closed_form() -> None:
    result = race(methods=["rk4", "dop853"], tolerances=[1e-4, 1e-8], steps=[0.05, 0.025])
    for entry in result:
        options: dict[str, Any] = {"rtol": entry.setting} if entry.adaptive else {"step": entry.setting}
        end = lg.flow(SPRING.compile(), method=entry.method, **options)([1.0, 0.0], 0.0, END)
        assert entry.error == pytest.approx(np.abs(end - EXACT).max(), rel=1e-3)
        assert entry.resolved and entry.complete and entry.status == "success"
    assert [(entry.method, entry.setting) for entry in result] == [
        ("rk4", 0.05),
        ("rk4", 0.025),
        ("dop853", 1e-4),
        ("dop853", 1e-8),
    ]
    assert result[0].error / result[1].error == pytest.approx(16, rel=0.1)
    assert (result[0].steps, result[0].evaluations) == (100, 401)


def test_the_reference_says_how_well_it_is_known() -> None:
    result = race()
    assert 0 < result.uncertainty < 1e-15
    assert race(digits=30).uncertainty < 1e-22
    assert "30 digits" in race(digits=30).result.reference.about


@pytest.mark.few(2)
@pytest.mark.parametrize(("wall", "at_once"), [(1.0, 1), (1e-3, 1), (0.6e-3, 2), (1e-3 / 7, 7)])
def test_a_short_run_is_repeated_until_it_can_be_timed(wall: float, at_once: int) -> None:
    """There is one run to estimate the cost, one to warm up, and then three repetitions of a millisecond each."""
    method = Scripted(wall=wall)
    entry = race(methods=[method], repeats=3)[0]
    assert entry.timed == 3 and len(method.runs) == 2 + 3 * at_once


def test_relative_errors_are_in_parts_of_each_entry() -> None:
    plain, relative = race(PAIR), race(PAIR, relative=True)
    assert relative.result.unit == pytest.approx((1e3, 1, 2e3, 1), rel=1e-2)
    assert plain.result.unit == (1, 1, 1, 1)
    end = lg.flow(PAIR.compile(), method="dop853", rtol=1e-6, atol=1e-6)([1e3, 0, 0, 0], 0.0, END)
    off = np.abs(end - 1e3 * np.array([EXACT[0], 0, EXACT[1], 0]))
    assert plain[0].error == pytest.approx(off.max(), rel=1e-3)
    assert relative[0].error == pytest.approx((off / relative.result.unit).max(), rel=1e-3)


def test_errors_along_the_way() -> None:
    result = race(methods=["rk4"], outputs=10)
    assert result.result.reference.times == pytest.approx(np.linspace(0.5, 5.0, 10))
    solution = SPRING.run(END, method="rk4", step=0.01, t_eval=result.result.reference.times)
    exact = np.array([np.cos(2 * solution.t), -2 * np.sin(2 * solution.t)])
    assert result[0].error == pytest.approx(np.abs(solution.y - exact).max(), rel=1e-3)


def test_an_error_below_the_reference_is_not_told() -> None:
    free = lg.System(kinetic=m * x.dot**2 / 2, potential=0, parameters={m: 1}, initial={x: 0.0, x.dot: 1.0})
    entry = race(free, 1.0, reference=[1.0, 1.0], methods=["rk4"], steps=[0.25])[0]
    assert not entry.resolved
    assert entry.error == np.spacing(1.0) / 2


# --- what fails stays in the table --------------------------------------------------------------------------


@pytest.mark.slow
def test_a_method_that_is_not_legal_is_refused_in_the_table() -> None:
    elastic = shared_scene("elastic-pendulum")
    entry = race(elastic, 1.0, methods=["verlet"])[0]
    assert (entry.status, entry.complete, math.isnan(entry.error)) == ("refused", False, True)
    assert "mass matrix changes" in entry.message
    default = race(elastic, 1.0, methods=None)
    assert not {"velocity-verlet", "yoshida6", "composition8"} & set(default.methods)
    left_out = [note for note in default.notes if "Left out" in note]
    assert len(left_out) == 1, "one reason is told once"
    assert left_out[0].startswith("Left out: velocity-verlet, yoshida6 and composition8. velocity-verlet moves ")


@pytest.mark.slow
def test_the_default_choice() -> None:
    methods = race(methods=None, end=1.0).methods
    assert methods == work_precision.RACED
    assert set(methods) <= set(lg.methods.names()) and len(methods) == 12
    kinds = [find(name).claims for name in methods]
    assert {claim.adaptive for claim in kinds} == {claim.symplectic for claim in kinds} == {True, False}


def test_a_run_out_of_time_is_kept_and_finer_ones_are_skipped() -> None:
    result = race(methods=[Scripted(Status.MAX_WALL)], steps=[0.01, 0.02], max_wall=0.5)
    assert [(entry.setting, entry.status, entry.complete) for entry in result] == [
        (0.02, "max_wall", False),
        (0.01, "skipped", False),
    ]
    assert "0.02" in result[1].message and "0.5 s" in result[1].message


@pytest.mark.few
@pytest.mark.parametrize("status", [Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.MAX_STEPS])
def test_every_end_is_kept_with_its_words(status: Status) -> None:
    entry = race(methods=[Scripted(status)])[0]
    assert (entry.status, entry.message, entry.complete, entry.timed) == (status.value, "as told", False, 0)


def test_ctrl_c_ends_the_race() -> None:
    with pytest.raises(KeyboardInterrupt):
        race(methods=[Scripted(Status.INTERRUPTED)])


def test_two_of_a_name_are_told_apart() -> None:
    assert race(methods=["rk4", lg.methods.RK4(), Scripted()]).methods == ("rk4", "rk4 (2)", "scripted")


# --- the reference ------------------------------------------------------------------------------------------


def test_a_reference_of_the_users() -> None:
    assert race(reference=EXACT + 1e-3)[0].error == pytest.approx(1e-3, rel=1e-2)
    result = race(reference=EXACT)
    assert result[0].error == pytest.approx(race()[0].error, rel=1e-3)
    assert result.uncertainty == np.spacing(np.abs(EXACT)).max() / 2


@pytest.mark.parametrize("reference", ["dop853", "dopri5", lg.methods.RK4(step=1e-3)])
def test_a_method_as_reference_is_held_against_another(reference: Any) -> None:
    result = race(reference=reference, outputs=2)
    assert 0 < result.uncertainty < 1e-10
    assert result[0].error == pytest.approx(race(outputs=2)[0].error, rel=1e-3)
    assert "compared with" in result.result.reference.about


def test_a_poor_reference_is_refused() -> None:
    with pytest.raises(RunError, match=r"has an error of .*, too large"):
        race(reference=lg.methods.Euler(step=0.1))


def test_a_system_that_no_digits_follow_points_to_another_reference() -> None:
    brake = lg.System(
        kinetic=m * x.dot**2 / 2,
        potential=k * x**2 / 2,
        forces={x: -0.1 * sign(x)},
        parameters={m: 1, k: 4},
        initial={x: 1.0},
    )
    with pytest.raises(RunError, match=r"derivatives, jump there.* reference="):
        race(brake, 2.0)
    assert race(brake, 2.0, reference="dop853").uncertainty < 1e-6


def test_the_time_of_the_reference_is_not_that_of_the_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    right = reference_solution.reference_solution

    def slow(problem: Problem, *others: Any) -> Any:
        object.__setattr__(problem, "began", problem.began - 1000.0)
        return right(problem, *others)

    monkeypatch.setattr(work_precision, "reference_solution", slow)
    assert [entry.status for entry in race(reference=EXACT)] == ["success"]


def test_the_reference_has_a_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference_solution, "REFERENCE_SECONDS", 1e-9)
    with pytest.raises(RunError, match="time limit"):
        race()


# --- growth of errors ---------------------------------------------------------------------------------------


def test_errors_on_a_hill_grow_with_the_exponential() -> None:
    end = 12.0
    result = race(HILL, end)
    assert result.growth == pytest.approx(math.cosh(end) + math.sinh(end), rel=1e-3)
    assert result.floor == pytest.approx(2.0**-53 * math.cosh(end), rel=1e-3)
    assert any("grow up to" in note and "chance" in note for note in result.notes)
    assert race(SPRING).notes == ()


def test_growth_on_the_way_counts_too() -> None:
    statement_model = SPRING.compile()
    run = SPRING.run(END, method="dop853", rtol=1e-11, atol=1e-11).trajectory
    size = np.abs(run.y).max(axis=1)
    result = sensitivity(statement_model, run, statement_model.parameter_values(), size, np.ones(2))
    assert result.growth == pytest.approx(math.sqrt(2), rel=2e-2)
    backwards = HILL.run(-3.0, method="dop853", rtol=1e-11, atol=1e-11).trajectory
    hill = HILL.compile()
    there = sensitivity(hill, backwards, hill.parameter_values(), np.ones(2), np.ones(2))
    assert there.growth == pytest.approx(math.exp(3), rel=1e-3)


def test_chaos_has_no_winner() -> None:
    pendulum, start = shared_scene("double-pendulum"), {"theta1": 2.0, "theta2": 2.5}
    result = race(pendulum, 24.0, initial=start, reference=np.zeros(4))
    assert result.growth > 1e14
    assert result.floor > 1e-2
    assert result.notes[0].startswith("No method can win")
    with pytest.raises(RunError, match=r"grows .* times .* of 22 digits"):
        lg.race(pendulum, 40.0, start)


# --- refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"methods": ["rk5"]}, "no method 'rk5'.*Did you mean 'rk4'"),
        ({"methods": []}, "methods is empty"),
        ({"methods": [lg.methods.RK4]}, "give a name"),
        ({"tolerances": [1e-6, 0]}, "tolerances contains 0"),
        ({"tolerances": [math.nan]}, "entry of tolerances is nan"),
        ({"tolerances": [-1e-6]}, "tolerances contains -1e-06"),
        ({"tolerances": []}, "tolerances is empty"),
        ({"tolerances": 1e-6}, "give a list"),
        ({"tolerances": "1e-6"}, "give a list"),
        ({"steps": [0.0]}, "steps contains 0"),
        ({"steps": []}, "steps is empty"),
        ({"repeats": 0}, "repeats = 0"),
        ({"repeats": 1.5}, "repeats = 1.5"),
        ({"outputs": 0}, "outputs = 0"),
        ({"max_wall": 0}, "max_wall = 0"),
        ({"digits": 5}, "digits = 5"),
        ({"reference": [1.0, 2.0, 3.0]}, r"reference has shape \(3,\)"),
        ({"reference": [math.nan, 0.0]}, "finite"),
        ({"reference": "rk5"}, "no method 'rk5'"),
        ({"end": 0.0}, "no length"),
        ({"end": math.inf}, "t_end is inf"),
        ({"parameters": {"q": 1}}, "'q' is not a parameter"),
        ({"initial": {"z": 1}}, "'z'"),
        ({"system": 3}, "3 is not a system"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_refusals(options: dict[str, Any], words: str) -> None:
    assert re.search(words, refusal(race, **options))


def test_one_method_needs_no_list() -> None:
    assert race(methods="rk4").methods == ("rk4",)
    assert race(methods=lg.methods.RK4()).methods == ("rk4",)


def test_a_motion_without_an_end_cannot_be_raced() -> None:
    escape = lg.System(kinetic=m * x.dot**2 / 2, potential=-(x**4), parameters={m: 1}, initial={x: 1.0})
    with pytest.raises(RunError, match="no end state, because the first run stopped early: dop853"):
        race(escape, 10.0)


# --- trust horizon --------------------------------------------------------------------------------------------
# The time for which a run claims to be right, compared with its known error.


OSCILLATOR = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0}, name="oscillator")


def test_euler_on_an_oscillator_holds_as_long_as_its_formula_says() -> None:
    """Euler's solution is x + iv = (1 - ih)^n. The claimed time may be shorter by the safety factor, but not longer."""
    h, error = 1e-3, 1e-2
    horizon = lg.trust_horizon(OSCILLATOR, (0.0, 100.0), error=error, method="euler", step=h)
    n = np.arange(round(100 / h))
    off = (1 - 1j * h) ** n - np.exp(-1j * h * n)
    apart = np.maximum(abs(off.real), abs(off.imag))
    until = {level: h * int(np.argmax(apart > level)) for level in (error / 20, error)}
    assert until[error / 20] <= float(horizon) <= until[error]
    assert not horizon.complete and "not known" in repr(horizon)


def test_a_run_that_holds_to_its_end_says_so() -> None:
    horizon = lg.trust_horizon(OSCILLATOR, (0.0, 10.0), error=1e-6)
    result = lg.integrate(OSCILLATOR, (0.0, 10.0))
    wrong = np.abs(result["x"] - np.cos(result.t)).max()
    assert horizon.complete and horizon.time == 10.0
    assert wrong <= horizon.bounds[-1] <= 1e-6
    assert "until the end" in repr(horizon)
    assert (lg.trust_horizon(OSCILLATOR, 10.0, error=1e-6).bounds == horizon.bounds).all()
    backwards = lg.trust_horizon(OSCILLATOR, (0.0, -10.0), error=1e-6)
    assert backwards.complete and backwards.time == -10.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_it_is_not_over_claimed(seed: int) -> None:
    """Random starts of a chaotic double pendulum are compared with runs in multiple precision."""
    rng = np.random.default_rng(seed)
    pendulum = model("double pendulum")
    start = [*rng.uniform(-math.pi, math.pi, 2), *rng.uniform(-6.0, 6.0, 2)]
    initial = dict(zip(("a0", "a1", "a0_dot", "a1_dot"), start, strict=True))
    options: dict[str, Any] = {"method": "dop853", "rtol": 1e-6, "atol": 1e-6}
    horizon = lg.trust_horizon(pendulum, (0.0, 20.0), initial, error=1e-3, **options)
    times = [horizon.time / 2, horizon.time]
    truth = precise_run(pendulum, pendulum.parameter_values(), 0.0, start, times, digits=18)
    run = lg.integrate(pendulum, (0.0, 20.0), initial, **options)
    errors = [
        np.abs(run.at(t) - [float(value) for value in right]).max() for t, right in zip(times, truth, strict=True)
    ]
    assert 0.5 < horizon.time < 20.0
    assert max(errors) <= 1e-3
    assert errors[1] > 1e-3 / 200  # nor so timid that it says nothing


def test_rounding_is_part_of_it() -> None:
    """At the smallest tolerance the growth of rounding errors is still detected."""
    initial = {"a0": 2.0, "a1": 2.5}
    pendulum = model("double pendulum")
    tight = {
        method: lg.trust_horizon(pendulum, (0.0, 60.0), initial, method=method, rtol=1e-15, atol=1e-16)
        for method in ("taylor", "dop853")
    }
    for horizon in tight.values():
        assert not horizon.complete
        assert len(horizon.witnesses) == 3 and horizon.witnesses[-1].endswith("from a perturbed start")
    a, b = (lg.integrate(pendulum, (0.0, 60.0), initial, method=m, rtol=1e-15, atol=1e-16) for m in tight)
    common = np.linspace(0.0, min(float(horizon) for horizon in tight.values()), 50)
    assert np.abs(a.at(common) - b.at(common)).max() <= 2e-3


def test_relative_errors_follow_the_size_of_the_state() -> None:
    small: dict[str, Any] = {"initial": {x: 1e-20}, "atol": 1e-40}
    assert lg.trust_horizon(OSCILLATOR, (0.0, 10.0), error=1e-6, relative=True, **small).complete
    coarse = lg.trust_horizon(OSCILLATOR, (0.0, 10.0), {x: 1e-20}, error=1e-6, relative=True, method="euler", step=0.1)
    assert coarse.time < 0.1
    assert lg.trust_horizon(OSCILLATOR, (0.0, 10.0), {x: 1e-20}, error=1e-6, method="euler", step=0.1).complete


def test_it_ends_where_the_motion_does() -> None:
    pole = build(kinetic=x.dot**2 / 2, potential=-2 * x**3, initial={x: 1.0, x.dot: 2.0}, name="pole")
    horizon = lg.trust_horizon(pole, (0.0, 5.0), error=1e-3)
    assert not horizon.complete and 0.8 < horizon.time < 1.0


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"error": 0.0}, "error = 0: give a positive one"),
        ({"error": math.nan}, "error is nan"),
        ({"method": "rk5"}, "no method 'rk5'"),
    ],
)
def test_what_cannot_be_meant_is_refused(request_: dict[str, Any], words: str) -> None:
    assert re.search(words, refusal(lg.trust_horizon, OSCILLATOR, (0.0, 1.0), **request_))


def test_it_takes_a_system_too() -> None:
    assert lg.trust_horizon(shared_scene("pendulum"), (0.0, 1.0)).complete
    untyped: Any = lg.trust_horizon
    for given in ("pendulum", lg.System):
        assert "is not a system: give an" in refusal(untyped, given, (0.0, 1.0))
