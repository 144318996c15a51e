from __future__ import annotations

import pytest

import lagrange as lg
from lagrange.evidence.sample import SAMPLE_KINDS, SampleKind, SamplePoint, Sampler, compared, holds
from lagrange.statement.coordinate import coordinate, parameters
from lagrange.statement.declare import declare
from tests.evidence import statements

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
    """Equal ones would hide an exchanged index."""
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
    statement = lg.scene("pendulum").statement

    def values(share: float, point: SamplePoint) -> tuple[list[float], list[complex]]:
        return [1.0, point.q[0]], [1.0, point.q[0] * share]

    compared("the formula", statement, lambda point: values(1 + 1e-12, point))
    compared("the formula", statement, lambda point: values(float("nan"), point))
    with pytest.raises(lg.RunError, match="the formula of pendulum is wrong"):
        compared("the formula", statement, lambda point: values(1 + 1e-6, point))
