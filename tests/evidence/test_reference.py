"""Reference values agree with symbolic differentiation, and the quick check refuses wrong accelerations."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, cast

import mpmath
import numpy as np
import pytest
import sympy as sp
from mpmath import libmp

import lagrange as lg
from lagrange.errors import RunError
from lagrange.evidence import differences
from lagrange.evidence.differences import LOCAL_FROM
from lagrange.evidence.precise import OutsideDomain, all_ways, describe_way
from lagrange.evidence.quick_check import quick_check
from lagrange.evidence.reference import Reference
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinate, t
from lagrange.statement.declare import declare
from lagrange.statement.random_states import SAMPLE_KINDS, SamplePoint, Sampler
from lagrange.statement.statement import Statement
from tests.evidence import statements
from tests.evidence.statements import Refusing, StandIn
from tests.evidence.test_check import FAULTS

x, y = coordinate("x"), coordinate("y")
MP = mpmath.MPContext()
MP.dps = 60


def columns_of(statement: Statement) -> list[int]:
    return list(range(2 * len(statement.coordinates)))


@pytest.mark.few
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_every_quantity_agrees_with_symbolic_differentiation(make: Callable[[], Statement]) -> None:
    statement = make()
    reference, symbolic = Reference(statement), StandIn(statement)
    sampler = Sampler(statement, seed=3)
    point = next(p for p in (sampler.point(SAMPLE_KINDS[1], i) for i in range(99)) if inside(reference, p))
    entries = reference.at(point, columns_of(statement))
    n = len(statement.coordinates)
    replace = {**dict(zip(symbolic.q, point.q, strict=True)), **dict(zip(symbolic.v, point.v, strict=True))}
    replace |= {t: point.t, **point.parameters}
    exact = {symbol: sp.Rational(number) for symbol, number in replace.items()}
    for name, part in entries.items():
        target = symbolic.expressions[name]
        if name == "jacobian":
            target = [target[i * 2 * n + j] for j in range(2 * n) for i in range(2 * n)]
        for expression, value, error, size in zip(target, part.value, part.error, part.size, strict=True):
            expected = MP.mpf(str(sp.N(expression.xreplace(exact), 60)))
            assert abs(value - expected) <= error + 1e-19 * size, (name, expression)
            assert error <= 1e-19 * size
            assert size <= 1e-10 or abs(value - expected) <= 1e-30 * size, (name, expression)


def inside(reference: Reference, point: SamplePoint) -> bool:
    try:
        reference.inspect(point)
    except OutsideDomain:
        return False
    return True


def test_the_mass_of_a_velocity_that_is_zero_keeps_its_digits() -> None:
    mass = sp.Symbol("m")
    statement = declare(kinetic=mass * (x.dot**2 + y.dot**2) / 2, potential=0, parameters={mass: 1.7})
    point = SamplePoint((0.3, 0.7), (0.9, 0.0), 0.0, {mass: 1.7}, "")
    entries = Reference(statement).at(point, ())["mass_matrix"].value
    assert abs(entries[3] - MP.mpf(1.7)) < 1e-28  # steps of 1e-30 leave 30 of 90 digits


@pytest.mark.parametrize("make", [statements.pendulum, statements.kepler, statements.driven_oscillator])
def test_sizes_are_those_of_the_terms(make: Callable[[], Statement]) -> None:
    """At a point without cancellation the size is between the value and a small multiple of it."""
    statement = make()
    point = Sampler(statement, seed=1).point(SAMPLE_KINDS[1])
    for name, part in Reference(statement).at(point, columns_of(statement)).items():
        largest = max(map(abs, part.value))
        for value, size in zip(part.value, part.size, strict=True):
            assert abs(value) <= size <= 60 * largest, name


CANCELLING = {
    "forces of a nearly flat potential": ("forces", sp.sin(x) - x, 1e-5, 1e-10, (0.2, 3)),
    # At large u the slope 2 u/(1 + u**2)**2 of u**2/(1 + u**2) is a difference of two terms of the size 2/u.
    # A constant factor on u**2 or on 1 + u**2 changes the slope as little as the value.
    "terms in a slope alone": ("forces", -((1000 * x) ** 2) / (1 + (1000 * x) ** 2), 1.0, 3e-6, (0.5, 10)),
    # A total time derivative in L has no effect but rounding; compiled code may have an error of 1e-13.
    "a bias that is identically zero": ("bias", 1000 * sp.cos(x) * x.dot, 0.5, 1e-30, (50, 2000)),
}
"""A quantity, a term of L, the coordinate, a bound of the value, and bounds of the size."""


@pytest.mark.parametrize(("name", "term", "at", "most", "sizes"), CANCELLING.values(), ids=CANCELLING)
def test_cancelling_terms_make_the_size_larger(
    name: str, term: Any, at: float, most: float, sizes: tuple[float, float]
) -> None:
    statement = declare(lagrangian=x.dot**2 / 2 + term, name="cancelling")
    part = Reference(statement).at(SamplePoint((at,), (0.8,), 0.0, {}, ""), [])[name]
    assert abs(part.value[0]) < most and sizes[0] < part.size[0] < sizes[1]


def test_a_kink_under_the_stencil_is_no_point_to_use() -> None:
    statement = declare(kinetic=x.dot**2 / 2, potential=sp.Abs(x), name="kink")
    with pytest.raises(OutsideDomain, match="no derivative"):
        Reference(statement).at(SamplePoint((0.0,), (1.0,), 0.0, {}, ""), [0])


def test_numbers_that_doubles_cannot_hold_are_outside() -> None:
    statement = declare(kinetic=x.dot**2 / 2, potential=sp.exp(x**2), name="steep")
    reference = Reference(statement)
    with pytest.raises(OutsideDomain, match="range of double"):
        reference.at(SamplePoint((30.0,), (1.0,), 0.0, {}, ""), [0])
    assert reference.at(SamplePoint((3.0,), (1.0,), 0.0, {}, ""), [0])


def sparse(numbers: Sequence[float]) -> differences.Row:
    return {i: MP.mpf(x) for i, x in enumerate(numbers) if x}


def test_factorization_sizes_bound_the_factors() -> None:
    sizes = differences.factorization_sizes([sparse(row) for row in ([4, -2, 0], [-2, 1.5, 1], [0, 1, 5])])
    # L = [[1], [-1/2, 1], [0, 2, 1]], D = (4, 1/2, 3)
    assert sizes == [{0: 4, 1: 2}, {0: 2, 1: 2.5, 2: 1}, {1: 1, 2: 7}]


def test_sizes_without_a_factorization_fall_back_on_the_rows() -> None:
    assert differences.factorization_sizes([sparse((0, 4)), sparse((4, 0))]) == [{0: 4, 1: 4}, {0: 4, 1: 4}]


def test_velocities_that_are_rounding_leave_the_inertia_its_digits() -> None:
    """Projection leaves a velocity of 1e-37 beside 8. A difference step of 1e-55 would change none of 90 digits."""
    statement = declare(kinetic=x.dot**2 / 2 + y.dot**2 / 2, potential=x**2 / 2, initial={x.dot: 8.0, y.dot: 6e-37})
    point = SamplePoint((0.0, 0.0), (8.0, 6e-37), 0.0, {}, "")
    values = Reference(statement).at(point, [])["mass_matrix"].value
    # The energy of 32 is rounded at 1e-90, and the second difference divided by the square of 8e-38.
    assert list(map(float, values)) == pytest.approx([1, 0, 0, 1], rel=1e-13, abs=1e-13)


# --- Terms by the coordinates in them ---


def row(length: int) -> Statement:
    """Return masses in a row with springs, drag between neighbours, and a force on the last one."""
    x = [lg.coordinate(f"x{i}") for i in range(length)]
    k, m, c = lg.parameters("k m c")
    pairs = list(itertools.pairwise(x))
    return declare(
        kinetic=m / 2 * sum(item.dot**2 * (1 + x[0] ** 2 / 9) for item in x),
        potential=k * sum(sp.sqrt(1 + (a - b) ** 2) for a, b in pairs),
        dissipation=c / 2 * sum((a.dot - b.dot) ** 2 for a, b in pairs),
        forces={x[-1]: sp.sin(lg.t) * x[-2]},
        coordinates=x,
    )


def test_local_terms_give_the_same_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    statement = row(4)
    point, columns = Sampler(statement, 0).point(SAMPLE_KINDS[1]), columns_of(statement)
    whole = Reference(statement).at(point, columns)
    monkeypatch.setattr(differences, "LOCAL_FROM", 2)
    local = Reference(statement).at(point, columns)
    for name, entries in whole.items():
        for a, b, size in zip(entries.value, local[name].value, entries.size, strict=True):
            # Differences leave 36 of 90 digits.
            assert abs(a - b) <= 1e-30 * size + 1e-50, name


@pytest.mark.slow
def test_a_column_of_the_jacobian_costs_few_evaluations_of_each_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = 8
    x = [[lg.coordinate(f"{axis}{i}") for axis in "xyz"] for i in range(bodies)]
    pairs = list(itertools.combinations(x, 2))
    statement = declare(
        kinetic=sum(rate.dot**2 for place in x for rate in place) / 2,
        potential=-sum(1 / sp.sqrt(sum((a - b) ** 2 for a, b in zip(*pair, strict=True))) for pair in pairs),
    )
    point, columns = Sampler(statement, 0).point(SAMPLE_KINDS[1]), range(3 * bodies)
    power, count = libmp.mpf_pow, 0

    def counted(*arguments: Any) -> Any:
        nonlocal count
        count += 1
        return power(*arguments)

    reference = Reference(statement)
    reference.at(point, [])
    monkeypatch.setattr(libmp, "mpf_pow", counted)
    reference.at(point, columns)
    # Rows outside columns: 31. With columns outside rows a force repeats all its pairs for each column: 98.
    assert count < 40 * len(columns) * len(pairs)


@pytest.mark.slow
def test_columns_that_are_left_out_are_told() -> None:
    system = lg.System.from_statement(row(LOCAL_FROM))
    report = system.check(points=1)
    assert report and "The Jacobian is checked in 24 of its 26 columns: points=2 checks all of them." in report.notes


# --- which way a switch goes, in words ---


STATEMENT = declare(kinetic=x.dot**2 + y.dot**2, potential=x * y, coordinates=[x, y])


def test_every_kind_of_switch_has_its_ways_and_words() -> None:
    most = sp.Max(x, 2 * y)
    assert all_ways(most) == (0, 1)
    i = most.args.index(2 * y)
    assert describe_way(most, i, STATEMENT) == "2*y is the one that Max(x, 2*y) takes"
    assert all_ways(sp.Abs(x)) == (-1, 1) == all_ways(sp.sign(x))
    assert describe_way(sp.Abs(x.dot), -1, STATEMENT) == "x_dot is negative"
    assert describe_way(sp.sign(x), 1, STATEMENT) == "x is positive"
    assert all_ways(x > 1) == (0, 1)
    assert describe_way(x > 1, 1, STATEMENT) == "x > 1 holds"
    assert describe_way(x <= y, 0, STATEMENT) == "x <= y does not hold"


def test_long_conditions_are_cut() -> None:
    text = describe_way(sum(sp.sin(i * x) for i in range(40)) > 0, 1, STATEMENT)
    assert len(text) < 100 and text.endswith("... holds")


# --- quick check ----------------------------------------------------------------------------------------------


def looked_at(model: StandIn) -> None:
    quick_check(cast("Model", model))


@pytest.fixture
def confirmations(monkeypatch: pytest.MonkeyPatch) -> list[SamplePoint]:
    """Return the points at which the accelerations were tested."""
    points: list[SamplePoint] = []
    look = Reference.at

    def counted(self: Reference, point: SamplePoint, columns: Sequence[int]) -> Any:
        points.append(point)
        return look(self, point, columns)

    monkeypatch.setattr(Reference, "at", counted)
    return points


@pytest.mark.few
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_what_is_right_passes_at_once(make: Callable[[], Statement], confirmations: list[SamplePoint]) -> None:
    model = StandIn(make())
    looked_at(model)
    assert set(model.calls) == {"accelerations"}
    assert not confirmations


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
@pytest.mark.parametrize("quantity", ["accelerations", "bias"])
def test_what_is_wrong_is_refused(make: Callable[[], Statement], quantity: str, fault: str) -> None:
    if make is statements.contact and fault == "drop":
        pytest.skip("what is dropped acts beyond x = 10, and one point does not look there")
    with pytest.raises(RunError, match="fault of lagrange, please report"):
        looked_at(StandIn(make(), {quantity: FAULTS[fault]}))


def test_the_message_names_quantity_place_and_error() -> None:
    model = StandIn(statements.pendulum(), {"accelerations": FAULTS["sign"]})
    with pytest.raises(RunError) as caught:
        looked_at(model)
    for word in ("accelerations of pendulum", "theta_ddot is", "theta = ", "theta_dot = ", "t = ", "m = ", "error"):
        assert word in str(caught.value)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_a_lost_value_is_refused(lost: float) -> None:
    with pytest.raises(RunError, match=r"theta_ddot is (nan|-?inf)"):
        looked_at(StandIn(statements.pendulum(), late=lambda name, value: value * lost))


def test_a_refusal_without_reason_is_refused() -> None:
    with pytest.raises(RunError, match="please report"):
        looked_at(Refusing(statements.kepler()))


def test_a_singular_mass_matrix_is_no_fault_of_the_compiler(confirmations: list[SamplePoint]) -> None:
    statement = declare(kinetic=(x.dot + y.dot) ** 2 / 2, potential=x * y, coordinates=[x, y], name="singular")
    model = Refusing(declare(kinetic=x.dot**2 + y.dot**2, potential=x * y, coordinates=[x, y], name="regular"))
    model.statement = statement
    looked_at(model)
    assert len(confirmations) == 3


@pytest.mark.parametrize(
    "energy",
    [sp.log(-1 - x**2), sp.sqrt(-(x**2)), sp.exp(sp.exp(10 + x**2))],
    ids=["nowhere", "only at zero", "beyond doubles"],
)
def test_a_system_without_usable_points_passes(energy: Any) -> None:
    model = StandIn(declare(kinetic=x.dot**2 / 2, potential=x**2, name="everywhere"), late=lambda name, v: v * np.nan)
    model.statement = declare(kinetic=x.dot**2 / 2, potential=energy, name="nowhere")
    looked_at(model)


def test_the_initial_state_is_the_last_resort() -> None:
    """The potential is defined only for |x - 50| < 1e-9, where no random point is."""
    narrow = sp.sqrt(sp.Rational(1, 10**18) - (x - 50) ** 2)
    statement = declare(kinetic=x.dot**2 / 2, potential=3 * x + narrow, initial={x: 50.0}, name="narrow")
    with pytest.raises(RunError, match="x = 50, "):
        looked_at(StandIn(statement, {"accelerations": FAULTS["sign"]}))


def test_honest_cancellation_raises_no_alarm() -> None:
    statement = declare(
        kinetic=x.dot**2 / 2 + y.dot**2 / 2 + (1 - sp.Rational(1, 10**8)) * x.dot * y.dot,
        potential=sp.cos(x) * y,
        name="nearly singular",
    )
    noise = np.random.default_rng(1)

    def rounded(name: str, value: Any) -> Any:
        return value * (1 + 1e-9 * noise.standard_normal())

    looked_at(StandIn(statement, late=rounded))


@pytest.mark.parametrize("wrong", [1, 2])
def test_a_large_system_is_asked_twice_before_a_full_test(
    wrong: int, monkeypatch: pytest.MonkeyPatch, confirmations: list[SamplePoint]
) -> None:
    monkeypatch.setattr("lagrange.evidence.quick_check.MOST_CONFIRMED", 1)
    left = [wrong]

    def off(name: str, value: Any) -> Any:
        left[0] -= 1
        return value * (1 + 1e-6) if left[0] >= 0 else value

    model = StandIn(statements.kepler(), late=off)
    if wrong == 2:
        with pytest.raises(RunError, match="fault of lagrange"):
            looked_at(model)
    else:
        looked_at(model)
    assert len(confirmations) == wrong - 1
