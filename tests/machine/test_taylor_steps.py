"""Taylor drivers of all machines, step by step: the same times, steps, scales, limits and counts after each step.

A wrong decision often only shortens a step, which states do not show. So every entry of `DriverState` is compared, for
series that terminate, fail, overflow, meet a wall, or have gaps, in any units, forwards and backwards. Series of
different machines differ by rounding.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.taylor.memory import PROBES
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine import llvm_machine
from lagrange.machine.drivers import SeriesDriver
from lagrange.machine.llvm import engine
from lagrange.machine.llvm.engine import Module, ObjectCode
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.llvm_series import CompiledJet, LlvmSeries, compiled_steps
from lagrange.machine.numpy_machine import NumpyMachine, NumpySeries
from lagrange.machine.state import DriverState, Outcome
from lagrange.program.taylor import series_program
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.trajectory.events import compiled_loop
from tests.models import SYSTEMS, build, c, hanging_rods, k, m, omega, stated, x, y, z
from tests.systems import unit_pendulum

S = DriverState
ORDERS = (5, 8, 14)


def wall() -> Statement:
    """Return a system with a wall that the series shows only when it is near."""
    return stated(kinetic=x.dot**2 / 2, potential=sp.exp(200 * (x - 1)), initial={x: 0.3, x.dot: 1.0})


def bump() -> Statement:
    """Return a free motion towards a narrow bump. The series terminates, so a step beyond the bump must be rejected."""
    return stated(kinetic=x.dot**2 / 2, potential=sp.exp(-((60 * (x - 1)) ** 2)) / 9, initial={x: 0.3, x.dot: 1.0})


def gaps() -> Statement:
    """Return a system with a force in powers of t^4: three of four coefficients are zero."""
    return stated(kinetic=x.dot**2 / 2, forces={x: t**4 / 5 + t**8}, initial={x: 0.2})


def late() -> Statement:
    """Return a system with a force that is of high order in a small coordinate."""
    return stated(kinetic=x.dot**2 / 2, potential=x**12 / 3, initial={x: 0.01, x.dot: 0.4})


def thrown() -> Statement:
    return stated(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=m * y * 9, initial={y: 1.0, x.dot: 2.0, y.dot: 3.0})


def tiny() -> Statement:
    """Return a system that moves by 1e-30 in 1e-20 s."""
    return stated(
        kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 1e40}, initial={x: 1e-30, x.dot: 3e-11}
    )


def three() -> Statement:
    """Return a system with six entries in its state, which do not fill a block of eight."""
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, potential=sp.exp(x * y) + z**4 / (1 + x**2), initial={z: 1.0}
    )


def driven() -> Statement:
    """Return a system with friction, a force in time, and a mass matrix that depends on coordinates."""
    return stated(
        kinetic=m * (x.dot**2 + (2 + sp.sin(x)) * y.dot**2) / 2,
        potential=k * sp.sqrt(1 + x**2 + y**2),
        forces={x: sp.cos(omega * t) - c * x.dot * y},
        initial={x: 0.4, y.dot: 0.6},
    )


def pole() -> Statement:
    """Return a system with x = 1 / (1 - t): steps decrease to the spacing of doubles."""
    return stated(kinetic=x.dot**2 / 2, potential=-(x**4) / 2, initial={x: 1.0, x.dot: 1.0})


SPECIAL = {made.__name__: made for made in (wall, gaps, late, thrown, tiny, driven, pole)}


def rods() -> Statement:
    """Return a system with constraints, so that each step is projected."""
    return hanging_rods(2)


STATED = {
    "rods": rods,
    "bump": bump,
    "three": three,
    **SPECIAL,
    **{name: SYSTEMS[name] for name in ("double pendulum", "Kepler orbit", "blocks", "charge")},
}
TIMES = {"tiny": 3e-20, "pole": 1.5, "wall": 2.0}


@cache
def drivers(name: str, order: int) -> tuple[Statement, list[Any]]:
    """Return drivers of both machines: interpreted, unrolled with vectors of several widths, and in loops."""
    statement = STATED[name]()
    program = series_program(euler_lagrange(statement))[0]
    given = np.array([*(statement.defaults[p] for p in statement.parameters), *[1.0] * program.sides])
    compiled = [CompiledJet(pack(program, lanes), which) for lanes, which in ((8, order), (1, order), (4, 0))]
    return statement, [
        SeriesDriver(NumpyMachine(), NumpySeries(program), order, given),
        *(SeriesDriver(LlvmMachine(), jet, order, given) for jet in compiled),
    ]


def assert_lockstep(name: str, order: int, direction: int, tolerances: tuple[float, float], **bounds: float) -> Outcome:
    statement, machines = drivers(name, order)
    span = direction * TIMES.get(name, 6.0)
    start = np.array(statement.initial)
    states = [S(0.0, span, start, *tolerances, 0.0) for _ in machines]
    for driver, state in zip(machines, states, strict=True):
        # Without a step to take a run only begins.
        assert driver.advance(state, 0, np.zeros(2), np.zeros((6, len(start)))) is Outcome.PAUSED
        for which, value in bounds.items():
            if which == "longest":
                state.reals[S.LONGEST] = value
            else:
                setattr(state.taylor, which, value)
    outcome = Outcome.PAUSED
    for _ in range(60):
        outcomes = []
        for driver, state in zip(machines, states, strict=True):
            times, rows = np.zeros(2), np.zeros((6, len(start)))
            state.counts[S.ROWS] = 0
            outcomes.append(driver.advance(state, 1, times, rows))
            if state.counts[S.ROWS]:
                assert times[0] == state.t and (rows[0] == state.y).all()
        outcome = outcomes[0]
        assert outcomes == [outcome] * len(machines)
        for state in (states[0], *states[2:]):
            assert_same(state, states[1])
        if outcome is not Outcome.PAUSED:
            break
    assert name != "bump" or states[0].count(S.REJECTED) > 0
    return outcome


def assert_same(state: DriverState, first: DriverState) -> None:
    """Assert that two states are equal up to the rounding of series in different forms."""
    assert (state.counts == first.counts).all()
    assert abs(state.taylor.low - first.taylor.low) <= 1e-15 * abs(first.t)
    assert state.reals == pytest.approx(first.reals, rel=1e-8)
    for name in ("scale", "next_limit", "limit", "rescalings", "failures", "inspect"):
        assert getattr(state.taylor, name) == pytest.approx(getattr(first.taylor, name), rel=1e-8)
    assert (abs(state.y - first.y) <= 1e-7 * np.maximum(abs(first.y), abs(first.y).max() * 1e-6)).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", [name for name in STATED if name != "bump"])
def test_all_machines_take_the_same_taylor_steps(name: str, order: int, direction: int) -> None:
    assert_lockstep(name, order, direction, (1e-8, 1e-40 if name == "tiny" else 1e-10))


MIDDLE, BOUNDS = (1e-8, 1e-10), {"longest": 0.011, "limit": 0.003, "once": 0.007, "scale": 2.0**30}
HARDER: list[tuple[str, int, tuple[float, float], dict[str, float]]] = [
    *((name, 8, MIDDLE, {which: BOUNDS[which]}) for name in ("double pendulum", "thrown") for which in BOUNDS),
    *((name, 14, (1e-3, 0.0), {}) for name in ("driven", "Kepler orbit")),
    *((name, 14, (1e-12, 1e-3), {}) for name in ("driven", "Kepler orbit")),
    *((name, 14, (1e-15, 1e-15), {}) for name in ("driven", "Kepler orbit")),
    *(("bump", order, MIDDLE, {}) for order in (8, 14)),
]
"""Bounds of steps, tolerances, and steps that are rejected."""


@pytest.mark.few(2)
@pytest.mark.parametrize(("name", "order", "tolerances", "bounds"), HARDER)
def test_all_machines_keep_to_the_same_bounds_and_tolerances_and_reject_the_same_steps(
    name: str, order: int, tolerances: tuple[float, float], bounds: dict[str, float]
) -> None:
    assert_lockstep(name, order, 1, tolerances, **bounds)


def test_what_is_probed_does_not_depend_on_how_a_run_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step of a call must know the step before it; else it was probed at 31 points."""
    statement = thrown()
    program = series_program(euler_lagrange(statement))[0]
    looks: list[float] = []
    real = NumpySeries.rows

    def counted(self: NumpySeries, order: int, t: float, *arguments: Any) -> Any:
        looks.append(t)
        return real(self, order, t, *arguments)

    monkeypatch.setattr(NumpySeries, "rows", counted)
    counts = []
    for budget in (1, 30):
        looks.clear()
        values = np.array([statement.defaults[p] for p in statement.parameters])
        driver = SeriesDriver(NumpyMachine(), NumpySeries(program), 14, values)
        state = S(0.0, 2.0, np.array(statement.initial), 1e-8, 1e-8, 0.0)
        state.reals[S.LONGEST] = 0.1
        while driver.advance(state, budget, np.zeros(budget), np.zeros((budget + 4, 4))) is Outcome.PAUSED:
            pass
        counts.append(len(looks) - state.count(S.EVALUATIONS))
        assert state.count(S.STEPS) == 20
    assert counts == [PROBES - 1] * 2


# --- tiers ----------------------------------------------------------------------------------------------------
# Tiered compilation: quick code first, code that is compiled well after many steps, and the same bits from both.

TOLERANCES = [10.0**-k for k in range(3, 17)]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which the text of each compiled module is appended."""
    result = []
    compiling = Module.__init__

    def noted(self: Module, text: str, **how: bool) -> None:
        result.append(text)
        compiling(self, text, **how)

    monkeypatch.setattr(Module, "__init__", noted)
    return result


def ran(model: Any, method: str, **options: Any) -> list[bytes]:
    result = lg.integrate(model, (0.0, 9.0), method=method, **options)
    assert result.status is lg.Status.SUCCESS
    return [each.tobytes() for each in (result.t, result.y, *result.t_events)]


RUNS = {"taylor": {"rtol": 1e-9}, "dop853": {"rtol": 1e-12}, "rk4": {"step": 0.01}, "radau5": {"rtol": 1e-6}}


@pytest.mark.few(1)
@pytest.mark.parametrize("method", RUNS)
@pytest.mark.parametrize("watched", [False, True])
def test_code_that_is_compiled_well_gives_the_same_bits(
    method: str, watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first run uses quickly compiled code. During the second run optimized code replaces it, as in the third."""
    options = dict(RUNS[method], events=[lg.coordinate("theta")]) if watched else RUNS[method]

    def fresh() -> Any:
        for cached in (compiled_steps, llvm_machine.compiled_loop, llvm_machine._event_loop):
            cached.cache_clear()
        return unit_pendulum().compile(check=False)

    monkeypatch.setattr(compiled_loop, "WORTH_COMPILING", 1)
    monkeypatch.setattr(compiled_loop, "ENOUGH", 1)
    first = ran(fresh(), method, **options)
    monkeypatch.setattr(engine, "STEPS_BEFORE_OPTIMIZING", 1)
    monkeypatch.setattr(engine, "STEPS_BEFORE_LATE_OPTIMIZING", 1)
    model = fresh()
    assert [ran(model, method, **options) for _ in range(2)] == [first] * 2
    assert llvm_machine._event_loop().module.is_final or not watched or method == "taylor"


def test_a_series_is_compiled_well_behind_many_steps(made: list[str]) -> None:
    program = series_program(euler_lagrange(SYSTEMS["Kepler orbit"]()))[0]
    jet = LlvmSeries(program).code(9)
    quick = jet.address
    jet.module.count(engine.STEPS_BEFORE_OPTIMIZING - 1)
    assert (len(made), jet.address, jet.module.is_final) == (1, quick, False)
    jet.module.count(1)
    assert made == [jet.ir] * 2
    assert jet.address != quick
    jet.module.count(engine.STEPS_BEFORE_OPTIMIZING)
    assert jet.module.is_final
    assert len(made) == 2


def test_drivers_go_on_with_the_code_that_another_run_has_had_compiled(
    made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "STEPS_BEFORE_OPTIMIZING", 400)
    compiled_steps.cache_clear()
    flow = lg.flow(unit_pendulum().compile(check=False), method="taylor", rtol=1e-9, atol=1e-9)
    y = np.array([1.0, 0.0])
    ends = [flow(y, 0.0, 200.0).tobytes() for _ in range(3)]
    assert ends[1:] == ends[:-1]
    assert sum("@taylor_steps(" in text for text in made) == 2


@pytest.mark.few(1)
@pytest.mark.parametrize("watching", [False, True])
def test_another_tolerance_compiles_its_series_once_and_no_loop_over_steps(watching: bool, made: list[str]) -> None:
    """The loop over steps serves all orders, also with events."""
    theta = lg.coordinate("theta")
    model = unit_pendulum().compile(check=False)
    events = [lg.Event(theta)] if watching else None
    lg.integrate(model, (0.0, 3.0), rtol=1e-9, events=events)
    made.clear()
    for rtol in TOLERANCES:
        lg.integrate(model, (0.0, 3.0), rtol=rtol, events=events)
    series = [text for text in made if "@taylor_jet(" in text]
    assert 8 < len(series) == len(dict.fromkeys(series))
    assert not any("@taylor_steps(" in text for text in made)


# --- object code ----------------------------------------------------------------------------------------------
# The same text is compiled once in a process, and what is kept of it is bounded.


def test_a_system_that_is_stated_again_is_not_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[str] = []
    emitting: Any = engine._compiled

    def noted(text: str, *how: object) -> bytes:
        compiled.append(text)
        return bytes(emitting(text, *how))

    monkeypatch.setattr(engine, "COMPILED", ObjectCode())
    monkeypatch.setattr(engine, "_compiled", noted)

    def rates(stiffness: Any) -> list[float]:
        made = build(kinetic=m * x.dot**2 / 2, potential=stiffness * x**2 / 2, forces={x: -c * x.dot})
        return [float(rate) for rate in made.rhs(0.0, [0.5, 0.25])]

    first, count = rates(k), len(compiled)
    assert rates(k) == first and len(compiled) == count > 0
    assert rates(2 * k) != first and len(compiled) > count


def test_what_is_kept_is_bounded_and_the_oldest_goes_first() -> None:
    made: list[str] = []
    kept = ObjectCode(room=250)

    def compiled(text: str) -> bytes:
        made.append(text)
        return text.encode() * 100

    def ask(text: str) -> bytes:
        return kept.of(text, "", lambda: compiled(text))

    assert [ask(text) for text in "abab"] == [text.encode() * 100 for text in "abab"] and made == ["a", "b"]
    for text in "aca":
        ask(text)
    assert made == ["a", "b", "c"], "a was asked for after b, which goes"
    ask("b")
    assert made == ["a", "b", "c", "b"]
    assert ask("wide") == b"wide" * 100, "what is larger than the room is not kept, and comes all the same"
    kept.forget()
    ask("b")
    assert made[4:] == ["wide", "b"]
