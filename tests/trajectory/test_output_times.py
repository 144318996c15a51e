"""Output times of all methods: the run and its dense output give the same bits, and a run can store outputs alone."""

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import exp, sqrt

import lagrange as lg
from lagrange.algorithm.dense.polynomials import hermite_polynomial
from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.trajectory.dense_output import OutputPath, StepInterpolant, StepInterpolants, StepPath, step_path
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory
from tests.models import LLVM_FIRST, TARGETS, VALUES, build, c, g, k, l, m, model, x, y
from tests.show.examples import oscillator
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, SPLITTINGS, ball, exact, floor, run

RNG = np.random.default_rng(5)
OURS = [name for name in NAMES if not name.startswith(("scipy-", "cvode"))]
"""The methods that may keep their outputs alone."""


def options(name: str, step: float = 0.1) -> dict[str, Any]:
    return {"step": step} if name in FIXED else {}


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", [2.0, -2.0])
def test_the_states_of_a_run_are_those_of_its_path_to_the_last_bit(name: str, end: float, target: str) -> None:
    compiled = model("Henon-Heiles" if name in SPLITTINGS else "cart and pole", target)
    inner = np.sort(RNG.uniform(0.0, abs(end), 40))
    times = np.sign(end) * np.concatenate([[0.0, 0.0], inner, [abs(end), abs(end)]])
    result = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, **options(name))
    assert (result.at(times) == result.y).all()
    assert all((result.at(time) == state).all() for time, state in zip(times[:9], result.y.T[:9], strict=True))
    mixed = RNG.permutation(np.concatenate([times, times / 2]))
    among = np.isin(mixed, times)
    assert (result.at(mixed)[:, among] == result.y[:, np.searchsorted(np.abs(times), np.abs(mixed[among]))]).all()
    assert result.at(mixed[~among]) == pytest.approx(result.at(mixed)[:, ~among], abs=1e-13)
    none = lg.integrate(compiled, (0.0, end), method=name, t_eval=[], **options(name))
    assert none.y.shape == (len(result.y), 0) and none.status is Status.SUCCESS
    assert none.steps == result.steps and none.at(times) == pytest.approx(result.y, abs=1e-13)


@pytest.mark.parametrize("name", ["taylor", "dop853", "radau5", "scipy-dop853"])
def test_across_resets_too(name: str) -> None:
    """At the time of a reset the output is the state after it."""
    compiled = ball("llvm")
    plain = run(compiled, 3.0, name, events=[floor(0.8)])
    times = np.sort(np.concatenate([np.linspace(0.0, 3.0, 333), plain.t_events[0]]))
    result = run(compiled, 3.0, name, events=[floor(0.8)], t_eval=times)
    assert (result.dense(times) == result.y).all()
    assert result.y == pytest.approx(plain.dense(times), abs=1e-12)
    assert len(plain.t_events[0]) > 3
    at_resets = result.y[1, np.searchsorted(times, plain.t_events[0])]
    assert (at_resets > 0).all()


def few_bytes(count: int) -> int:
    """Return a number of bytes that suffices for the outputs of two coordinates and some steps."""
    return 8 * 5 * count + 3000


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("end", [30.0, -30.0])
def test_a_run_may_keep_its_outputs_alone(name: str, end: float, target: str) -> None:
    compiled, times = model("Henon-Heiles", target), np.linspace(0.0, end, 61)
    steps = options(name, 0.03)
    if name in ADAPTIVE:
        # More steps than the memory has room for, and no more: interpreted ones of radau3 take a millisecond.
        steps = {"rtol": 1e-7 if name in ("bs3", "radau3", "radau5", "radau5-index2") else 1e-10}
    whole = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, **steps)
    limit = few_bytes(61) if name != "taylor" else 8 * 5 * 61 + 1
    result = lg.integrate(compiled, (0.0, end), method=name, t_eval=times, max_memory=limit, **steps)
    assert whole.status is result.status and result.status.at_end
    assert result.steps == whole.steps and result.trajectory.span == whole.trajectory.span
    assert result.y == pytest.approx(whole.y, abs=1e-12) and (result.at(times) == result.y).all()
    if 40 * result.steps > 2 * limit:
        assert isinstance(result.trajectory.dense, OutputPath) and result.trajectory.dense.path is None
        with pytest.raises(lg.RunError, match=r"there is no state at t = .*max_memory = .* bytes, so it kept only"):
            result.at(end / 3.1)
        assert "ask for others in t_eval, or raise max_memory" in result.message
        assert result.stiff is None and result.drift.absolute == pytest.approx(whole.drift.absolute, abs=1e-12)
    else:
        assert name in ("taylor", "verner9", "dop853")


def test_output_times_that_do_not_fit_are_refused() -> None:
    compiled = model("Henon-Heiles")
    with pytest.raises(
        lg.StatementError,
        match="t_eval has 1000 times, which take 4e\\+04 bytes with their states, more than max_memory = 39999 bytes",
    ):
        lg.integrate(compiled, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 1000), max_memory=39_999)
    result = lg.integrate(compiled, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 1000), max_memory=40_000)
    assert result.y.shape == (4, 1000)


# --- outputs --------------------------------------------------------------------------------------------------
# States at output times of a Taylor run, which its steps write, are those of its path.


def assert_on_the_path(result: Trajectory, plain: Trajectory, times: FloatArray) -> None:
    """Assert that outputs equal the dense output of the same run without output times, up to rounding of its states."""
    assert result.status is plain.status and result.steps == plain.steps and result.rejected == plain.rejected
    assert np.array_equal(result.t, times)
    size = np.abs(plain.y).max(axis=1, keepdims=True)
    moving = np.flatnonzero(np.diff(plain.t))
    rate = np.abs(np.diff(plain.y)[:, moving] / np.diff(plain.t)[moving]).max(axis=1, keepdims=True)
    # The path begins each step from the rounded state and time, half a unit away, and rounds its own sums.
    allowed = 2.0**-52 * (8 * size + 4 * rate * np.abs(times))
    assert (np.abs(result.y - plain.dense(times)) <= allowed).all()


@pytest.mark.parametrize("target", TARGETS)
def test_a_step_that_is_taken_back_leaves_no_outputs(target: str) -> None:
    """A narrow bump in the potential is detected after the step, which is rejected; its outputs are written again."""
    bump = exp(-((10 * (x - 0.5)) ** 2)) / 10
    hidden = build(target, kinetic=x.dot**2 / 2, potential=x**2 / 2 + bump, initial={x: 1.0, x.dot: 2.0})
    times = np.linspace(0.0, 20.0, 800)
    result = run(hidden, 20.0, "taylor", rtol=1e-6, t_eval=times)
    assert result.rejected > 0
    assert_on_the_path(result, run(hidden, 20.0, "taylor", rtol=1e-6), times)


@pytest.mark.parametrize("target", TARGETS)
def test_over_a_point_without_a_series(target: str) -> None:
    """A run from rest with drag |v| v begins with a short step of another method, whose outputs are right."""
    speed = sqrt(x.dot**2 + y.dot**2)
    drag = {x: -c * speed * x.dot, y: -c * speed * y.dot}
    thrown = build(target, kinetic=(x.dot**2 + y.dot**2) / 2, potential=9.81 * y, forces=drag)
    plain = run(thrown, 1.5, "taylor")
    leaps = np.flatnonzero(np.diff(plain.t) <= 1.6e-6)
    assert len(leaps), "the run leaps"
    starts, ends = plain.t[leaps], plain.t[leaps + 1]
    times = np.sort(np.concatenate([np.linspace(0.0, 1.5, 40), (starts + ends) / 2]))
    assert_on_the_path(run(thrown, 1.5, "taylor", t_eval=times), plain, times)


# --- sampling -------------------------------------------------------------------------------------------------
# States at times that a user chooses, and files with lines at a stated rate.


def rows(path: Path) -> Any:
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


@pytest.mark.parametrize("times", [[0.0, 5.0], [1.0, -0.5]])
def test_a_file_has_lines_at_a_stated_rate_from_dense_output(times: list[float], tmp_path: Path) -> None:
    solution = oscillator(times)
    result = rows(solution.to_csv(tmp_path / "run.csv", rate=10))
    forward = np.sign(times[1] - times[0])
    np.testing.assert_allclose(result[:, 0], times[0] + forward * np.arange(abs(times[1] - times[0]) * 10 + 1) / 10)
    np.testing.assert_allclose(result[:, 1], np.cos(2 * result[:, 0]), atol=1e-14)
    assert result[-1, 0] == times[1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate": 0}, "rate = 0: give a positive number of lines per unit of time"),
        ({"rate": float("inf")}, "rate is inf: give a finite number"),
        ({"rate": 1e8}, r"rate = 1e\+08 gives 5e\+08 lines from t = 0 to 5, more than the limit of"),
        ({"rate": 2, "t": [1.0]}, "rate and t are both given"),
        ({"t": [6.0]}, "t = 6 is outside the run, which went from 0 to 5"),
    ],
)
def test_lines_that_cannot_be_written_are_refused(given: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(StatementError, match=message):
        oscillator().to_csv(tmp_path / "run.csv", **given)
    assert not list(tmp_path.iterdir())


# --- sampled --------------------------------------------------------------------------------------------------
# The polynomial that is read off a solver's interpolant.


def curve(times: FloatArray) -> FloatArray:
    return np.array([times**4 - times, 3 * times**3])


def interpolant(first: float, last: float, degree: int = 5, off: float = 0.0) -> StepInterpolant:
    ends = curve(np.array([first, last])).T
    return StepInterpolant.read(
        (first, last), (ends[0], ends[1]), (first - off, last - off), lambda s: curve(s + off), degree
    )


def test_paths_are_read_when_they_are_asked_for_and_once() -> None:
    asked: list[float] = []

    def seen(times: FloatArray) -> FloatArray:
        asked.append(float(times[0]))
        return curve(times)

    def later(first: float, last: float) -> partial[StepInterpolant]:
        ends = curve(np.array([first, last])).T
        return partial(StepInterpolant.read, (first, last), (ends[0], ends[1]), (first, last), seen, 5)

    entries: list[Any] = [later(0.0, 0.5), interpolant(0.5, 0.75), later(0.75, 2.0)]
    paths = StepInterpolants(entries)
    assert len(paths) == 3 and not asked
    times = np.linspace(0.75, 2.0, 11)
    for _ in range(2):
        np.testing.assert_allclose(paths[2](times), curve(times), atol=1e-14)
    assert len(asked) == 1 and asked[0] > 0.75
    assert len(StepInterpolants(entries, 1)) == 2 and StepInterpolants(entries, 1)[-1] is paths[2] and len(asked) == 1
    copied = pickle.loads(pickle.dumps(paths))
    assert len(asked) == 2 and all(isinstance(one, StepInterpolant) for one in copied)
    assert all(np.array_equal(one.values, other.values) for one, other in zip(copied, paths, strict=True))


# --- dense ----------------------------------------------------------------------------------------------------
# The path between steps: as accurate as its method, through every step, at any times, also after an early end.


def path_round_off(name: str) -> float:
    """Return the rounding error of the dense output. The weights of verner9 reach 13,293, those of others 545."""
    return 2e-12 if name == "verner9" else 1e-13


def hermite(compiled: Model, times: FloatArray, states: FloatArray, order: int) -> StepPath:
    return step_path(compiled, compiled.parameter_array(), hermite_polynomial(order), times, states)


CLAIMED: dict[str, Planned] = {
    **{name: method for name in NAMES if isinstance(method := find(name), Planned) and name != "taylor"},
    **{f"taylor, order {order}": Taylor(order=order) for order in (4, 5, 8, 12)},
}
"""Every method of ours, by its own name or as it is asked for: the order of taylor follows from the tolerance."""


def measured_order(method: Any, system: str, end: float) -> float:
    """Return the order of the dense output between exact states, where its error is proportional to h^(order + 1).

    It is fitted to the four grids with the smallest errors above round-off, of 2 to 1448 steps.
    """
    compiled, times = model(system), np.linspace(0.0, end, 499)
    truth, kept = exact(compiled, end, t_eval=times).y, []
    problem = Problem(compiled, compiled.parameter_values(), 0.0, end, truth[:, 0])
    for count in (round(2 * 2 ** (i / 2)) for i in range(20)):
        grid = np.linspace(0.0, end, count + 1)
        path = method.plan(problem).path(problem, grid, exact(compiled, end, t_eval=grid).y.T, None)
        error = np.abs(path(times) - truth).max()
        if error < (3e-11 if method.name in ("verner9", "dop853") else 1e-12):
            break
        kept.append((count, error))
    assert len(kept) >= 4, kept
    counts, errors = zip(*kept[-4:], strict=True)
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1)


def off(method: Any) -> float:
    """Return the difference between the measured and the claimed order of the dense output."""
    system, end = ("Henon-Heiles", 3.0) if method.name in SPLITTINGS else ("cart and pole", 1.2)
    claimed: int = method.claims.dense
    return abs(measured_order(method, system, end) - claimed)


@pytest.mark.few(4)
@pytest.mark.parametrize("name", CLAIMED)
def test_the_observed_order_of_the_path_is_the_claimed_one(name: str) -> None:
    """Measured orders differ from the claimed ones by at most 0.17."""
    assert off(CLAIMED[name]) < 0.25


def test_a_method_of_ours_that_has_a_path_claims_its_order() -> None:
    assert [name for name in NAMES if find(name).claims.dense == 0] == []


@pytest.mark.few(1)
@pytest.mark.parametrize("stretched", [0.0, 1e-6])
def test_the_path_of_a_stiff_run_is_as_good_as_its_steps(stretched: float) -> None:
    """The stiffness is 1e4 or 1e8. Slopes from the right-hand side would multiply errors of the states by it."""
    compiled = model("elastic pendulum")
    rate = 1e8 if stretched == 0 else 1e4
    length = (VALUES[l] + VALUES[m] * VALUES[g] * np.cos(0.5) / rate) * (1 + stretched)
    given: Any = {"parameters": {k: rate}, "initial": {"r": length, "theta": 0.5, "theta_dot": 0}}
    fine = run(compiled, 5.0, "radau5", rtol=1e-10, atol=1e-12, **given)
    result = run(compiled, 5.0, "radau5", rtol=1e-6, atol=1e-8, **given)
    times = np.linspace(0.0, 5.0, 2003)
    at_steps = np.abs(result.y - fine.dense(result.t)).max(axis=1)
    between = np.abs(result.dense(times) - fine.dense(times)).max(axis=1)
    # The spring's own part, of 1e-9 and less, counts for nothing beside the tolerance.
    assert (between < 1.02 * at_steps + 1e-9).all(), between / at_steps


def test_a_hermite_path_of_a_stiff_step_stays_the_cubic() -> None:
    """For x'' = -1e8 x' - x with steps of 0.1, improving the cubic would multiply errors by 1e7."""
    compiled = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, dissipation=sp.Integer(10) ** 8 * x.dot**2 / 2)
    grid = np.linspace(0.0, 1.0, 11)
    values = np.exp(-1e-8 * grid)
    states = np.stack([values, -1e-8 * values], axis=1)
    times = np.linspace(0.0, 1.0, 101)
    for order in (3, 5, 8):
        assert hermite(compiled, grid, states, order)(times)[0] == pytest.approx(np.exp(-1e-8 * times), abs=1e-7)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", [2.0, -2.0])
def test_the_path_goes_through_every_step_and_is_continuous(name: str, target: str, end: float) -> None:
    result = run(model("Henon-Heiles", target), end, name, **({"step": 0.1} if name in FIXED else {}))
    assert result.dense(result.t) == pytest.approx(result.y, abs=path_round_off(name))
    inner = result.t[1:-1]
    near = [result.dense(np.nextafter(inner, side)) for side in (-9.0, 9.0)]
    assert np.abs(near[0] - near[1]).max() < 10 * path_round_off(name)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_put_out_beyond_the_last_accepted_step(name: str, target: str) -> None:
    compiled = build(target, kinetic=m * x.dot**2 / 2, forces={x: sp.Piecewise((k, x < 1))}, initial={x.dot: 1.0})
    options: dict[str, Any] = {"step": 0.01} if name in FIXED else {}
    times = np.linspace(0, 5, 501)
    result = run(compiled, 5.0, name, t_eval=times, **options)
    assert result.status is Status.NON_FINITE and f"{name} stopped at t = " in result.message
    assert "x_dot is nan" in result.message or "the acceleration of x is nan" in result.message
    assert "Look for a division by zero" in result.message
    last = result.span[1]
    assert (result.t == times[times <= last]).all() and last < 0.75
    assert np.isfinite(result.y).all() and result.y.shape == (2, len(result.t))
    nowhere = run(compiled, 5.0, name, t_eval=[4.0, 5.0], **options)
    assert nowhere.t.shape == (0,) and nowhere.y.shape == (2, 0)
