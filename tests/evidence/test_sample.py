"""Random states of systems in any units, and comparisons at them."""

import itertools
import math
import random
import sys
from typing import Any, cast

import pytest
import sympy

import lagrange as lg
from lagrange.errors import RunError
from lagrange.evidence.formula_comparison import compared
from lagrange.evidence.quick_check import quick_check
from lagrange.evidence.reference import Reference
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinate, parameters
from lagrange.statement.declare import declare
from lagrange.statement.random_states import SAMPLE_KINDS, SampleKind, SamplePoint, Sampler, Scales, holds
from tests.evidence import statements
from tests.evidence.statements import StandIn
from tests.evidence.test_check import FAULTS
from tests.models import shared_scene

x, y, z = (coordinate(name) for name in "xyz")
mass, charge, drag, free = parameters("mass charge drag free", positive=False)
(length,) = (parameters("length"),)
STATEMENT = declare(
    kinetic=mass * (x.dot**2 + y.dot**2 + z.dot**2),
    potential=charge * x * y * z * length * free + drag,
    coordinates=[x, y, z],
    parameters={mass: 3.0, charge: -2e-19, drag: 0.0},
    initial={x: 1.5e11, y: -2.0},
    name="sampled",
)
INITIAL, ALL_OF_ORDER_ONE, _, NEAR_INITIAL, _ = SAMPLE_KINDS


def points(kind: SampleKind, count: int = 60) -> list[SamplePoint]:
    sampler = Sampler(STATEMENT, seed=2)
    return [sampler.point(kind) for _ in range(count)]


def test_the_first_kind_keeps_the_defaults_and_the_neighbourhood() -> None:
    for point in points(INITIAL):
        assert 0.4 * 1.5e11 < point.q[0] < 1.6 * 1.5e11 and point.q[0] != 1.5e11
        assert -3.1 < point.q[1] < -0.9
        assert 0.05 < abs(point.q[2]) < 1e11
        assert point.parameters[mass] == 3.0 and point.parameters[charge] == -2e-19 and point.parameters[drag] == 0.0


def test_later_attempts_come_nearer() -> None:
    sampler = Sampler(STATEMENT, seed=2)
    assert all(abs(sampler.point(INITIAL, 20).q[1] + 2) < 1e-4 for _ in range(20))


def test_of_order_one_means_everything() -> None:
    for point in points(ALL_OF_ORDER_ONE):
        assert all(0.2 <= abs(value) <= 2.0 for value in (*point.q, *point.v, *point.parameters.values()))
        assert point.parameters[charge] < 0 < point.parameters[mass]
    assert {point.parameters[free] > 0 for point in points(ALL_OF_ORDER_ONE)} == {True, False}
    assert all(point.parameters[length] > 0 for point in points(ALL_OF_ORDER_ONE))


def test_near_a_default_is_off_it_and_zero_is_left() -> None:
    for point in points(NEAR_INITIAL):
        assert 2.0 < point.parameters[mass] < 4.3 and point.parameters[mass] != 3.0
        assert -3e-19 < point.parameters[charge] < -1.3e-19
        assert point.parameters[drag] != 0.0


def test_all_numbers_differ() -> None:
    """Equal numbers would hide exchanged indices."""
    for kind in SAMPLE_KINDS[1:]:
        for point in points(kind, 5):
            values = [*point.q, *point.v, *point.parameters.values()]
            assert len(set(values)) == len(values) and 0.0 not in values


def test_the_initial_state_is_available_as_it_is() -> None:
    point = Sampler(STATEMENT, seed=0).initial()
    assert point.q == (1.5e11, -2.0, 0.0) and point.v == (0.0, 0.0, 0.0) and point.t == 0.0


def test_far_points_span_many_scales() -> None:
    sampler = Sampler(statements.contact(), seed=0)
    sizes = [abs(sampler.far().q[0]) for _ in range(300)]
    assert min(sizes) < 0.01 and max(sizes) > 300


def test_the_same_seed_draws_the_same_points() -> None:
    first, second, other = (Sampler(STATEMENT, seed) for seed in (1, 1, 2))
    assert first.point(INITIAL) == second.point(INITIAL) != other.point(INITIAL)
    assert first.far() == second.far()


def test_a_point_describes_itself_in_the_users_symbols() -> None:
    (symbol,) = (parameters("m"),)
    text = SamplePoint((0.1,), (2.0,), 3.0, {symbol: 4.0}, "").describe(["theta"])
    assert text == "theta = 0.10000000000000001, theta_dot = 2, t = 3, m = 4"


# --- What counts as agreement at random states ---


def test_the_first_false_decides_and_too_few_values_decide_nothing() -> None:
    assert holds(range(9), lambda k: True if k % 2 else None, 4) is True
    assert holds(range(9), lambda k: True if k % 2 else None, 5) is None
    assert holds(range(9), lambda k: k < 2, 2) is True
    assert holds(range(9), lambda k: k < 2, 3) is False


def test_a_wrong_formula_is_refused_and_one_without_values_is_not() -> None:
    statement = shared_scene("pendulum").statement

    def values(share: float, point: SamplePoint) -> tuple[list[float], list[complex]]:
        return [1.0, point.q[0]], [1.0, point.q[0] * share]

    compared("the formula", statement, lambda point: values(1 + 1e-12, point))
    compared("the formula", statement, lambda point: values(float("nan"), point))
    with pytest.raises(lg.RunError, match="the formula of pendulum is wrong"):
        compared("the formula", statement, lambda point: values(1 + 1e-6, point))


# --- Characteristic sizes, and samples and quick checks of systems in any units ---


theta = lg.coordinate("theta")
m, k, l, g = lg.parameters("m k l g")

UNITS = (1e-12, 1e-6, 1e6, 1e12)


def saturated(size: float) -> Any:
    """Return a kinetic energy whose inertia saturates when x exceeds a size."""
    u = x / size
    return x.dot**2 / 2 * (1 + u**2 / (1 + u**2))


@pytest.mark.parametrize("unit", UNITS)
def test_sizes_follow_constants_parameters_and_the_start(unit: float) -> None:
    assert Scales(declare(kinetic=saturated(unit))).sizes({}) == pytest.approx((unit, 1.0))
    spring = declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * (sympy.sqrt(x**2 + y**2) - l) ** 2 / 2)
    assert Scales(spring).sizes({m: 1.0, k: 1.0, l: unit}) == pytest.approx((unit,) * 4)
    chain = declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * (x - y) ** 2 / 2)
    assert Scales(chain).sizes({m: 1.0, k: 1.0}, (unit, 0, 0, 0)) == pytest.approx((unit,) * 4)
    pendulum = declare(kinetic=m * l**2 * theta.dot**2 / 2, potential=-m * g * l * sympy.cos(theta))
    assert Scales(pendulum).sizes({m: unit, l: unit, g: 1.0})[0] == 1.0
    switched = declare(kinetic=x.dot**2 / 2, potential=sympy.Piecewise((x**2, x > unit), (0, True)))
    assert Scales(switched).sizes({})[0] == pytest.approx(unit)


@pytest.mark.parametrize("unit", UNITS)
def test_samples_are_of_that_size(unit: float) -> None:
    sampler = Sampler(declare(kinetic=saturated(unit)), seed=0)
    for kind in SAMPLE_KINDS:
        for _ in range(20):
            assert 0.05 < abs(sampler.point(kind).q[0]) / unit < 2


def test_a_size_spreads_along_a_chain() -> None:
    """The size of the first link is passed to the last one, for both orders of the statement."""
    links = lg.coordinates(" ".join(f"s{i}" for i in range(60)))
    energy = sympy.Add(*((a - b) ** 2 for a, b in itertools.pairwise(links)))
    kinetic = sympy.Add(*(q.dot**2 for q in links))
    for order, first in ((links, 0), (links[::-1], 59)):
        start = [1e-9 * (i == first) for i in range(120)]
        sizes = Scales(declare(kinetic=kinetic, potential=energy, coordinates=order)).sizes({}, start)
        assert all(math.isclose(size, 1e-9, rel_tol=1e-9) for size in sizes)


def test_the_work_of_sizes_is_linear_in_a_chain() -> None:
    """Computing the sizes for 50 bodies took 3 s, since each row searched all coordinates."""
    counts = {}
    for n in (20, 40):
        links = lg.coordinates(" ".join(f"s{i}" for i in range(n)))
        springs = sympy.Add(*((a - b) ** 2 for a, b in itertools.pairwise(links)))
        scales = Scales(declare(kinetic=sympy.Add(*(q.dot**2 for q in links)), potential=k * springs / 2))
        calls = 0

        def count(_frame: Any, _event: str, _argument: Any) -> None:
            nonlocal calls
            calls += 1

        sys.setprofile(count)
        try:
            scales.sizes({k: 2.0}, [0.1] * n)
        finally:
            sys.setprofile(None)
        counts[n] = calls
    assert counts[40] < 2.5 * counts[20]


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_in_any_units(unit: float, fault: str) -> None:
    """In small units, samples of order one gave accelerations that were only rounding."""
    model = StandIn(declare(kinetic=saturated(unit), potential=sympy.cos(x / unit)), {"bias": FAULTS[fault]})
    with pytest.raises(RunError, match="fault of lagrange, please report"):
        quick_check(cast("Model", model))


HELD: dict[str, Any] = {
    "a rod": [x**2 + y**2 - l**2],
    "a wheel on a ramp": [x.dot - l * theta.dot, y - x / 3],
    "a knife edge": [x.dot * sympy.sin(theta) - y.dot * sympy.cos(theta)],
    "a rolling rod": [x**2 + y**2 - l**2, x.dot - l * theta.dot],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("held", HELD)
def test_the_reference_of_held_systems_does_not_depend_on_units(held: str, seed: int) -> None:
    """In one of six random units the pivots of constraints counted as zero, and the mass matrix as singular."""
    energy = m * (x.dot**2 + y.dot**2) / 2 + m * l**2 * theta.dot**2 / 3
    statement = declare(kinetic=energy, potential=m * g * y, coordinates=[x, y, theta], constraints=HELD[held])
    reference, draw = Reference(statement), random.Random(seed)
    length, mass, time = (10.0 ** draw.uniform(-12, 12) for _ in range(3))

    def accelerations(length: float, mass: float, time: float) -> list[float]:
        parameters = {m: 1.3 * mass, l: 1.1 * length, g: 0.7 * length / time**2}
        q, v = (0.4 * length, 1.0 * length, 0.9), (0.5 * length / time, -0.2 * length / time, 0.6 / time)
        parameters = {symbol: parameters[symbol] for symbol in statement.parameters}
        entries = reference.at(SamplePoint(q, v, 0.1, parameters, "stated"), [0])
        return [float(a) for a in entries["accelerations"].value]

    scaled = accelerations(length, mass, time)
    units = (length / time**2, length / time**2, 1 / time**2)
    assert [a / unit for a, unit in zip(scaled, units, strict=True)] == pytest.approx(accelerations(1.0, 1.0, 1.0))
