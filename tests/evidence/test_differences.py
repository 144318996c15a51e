from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath
from hypothesis import given
from hypothesis import strategies as st

from lagrange.evidence.laws import Estimate, central, central_mixed, extrapolated

MP = mpmath.MPContext()
MP.dps = 90
H = MP.mpf("1e-18")


def derivative(function: Callable[[Any], Sequence[Any]], step: Any) -> Estimate:
    """Return df/dx at 0 with its error, from four evaluations with steps `step` and `step`/2."""
    return extrapolated(central(function, step), central(function, step / 2))


def test_a_derivative_is_good_to_50_digits_and_says_so() -> None:
    found = derivative(lambda h: [MP.sin(1 + h), MP.exp(3 * h), 1 / (2 + h)], H)
    for value, error, slope in zip(found.value, found.error, [MP.cos(1), 3, MP.mpf(-1) / 4], strict=True):
        assert abs(value - slope) < 1e-50
        assert abs(value - slope) <= error < 1e-30


def test_mixed_derivatives() -> None:
    def slope(step: Any) -> Sequence[Any]:
        return central_mixed(lambda a, b: [MP.sin(1 + a) * MP.exp(b + a * b), a, a * b], step, 2 * step)

    found = extrapolated(slope(H), slope(H / 2))
    expected = [MP.cos(1) + MP.sin(1), 0, 1]
    assert all(abs(value - e) < 1e-45 for value, e in zip(found.value, expected, strict=True))
    assert all(error < 1e-30 for error in found.error)


def test_a_kink_shows_in_the_error_estimate() -> None:
    kinked = derivative(lambda h: [abs(h + H / 3)], H)
    assert kinked.error[0] > 0.01


@given(st.lists(st.integers(-9, 9), min_size=1, max_size=5))
def test_extrapolation_is_exact_for_fourth_degree(coefficients: list[int]) -> None:
    def polynomial(h: Any) -> list[Any]:
        return [sum((a * h**i for i, a in enumerate(coefficients)), MP.mpf(0))]

    slope = coefficients[1] if len(coefficients) > 1 else 0
    assert abs(derivative(polynomial, MP.mpf("1e-3")).value[0] - slope) < 1e-60
