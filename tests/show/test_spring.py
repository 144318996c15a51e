"""The shape of a spring: between its ends, as wide as was asked, and the same turns whatever its length."""

from __future__ import annotations

import numpy as np
import pytest

from lagrange.show.figures.space import SPRING_TURNS, spring


@pytest.mark.parametrize("length", [0.3, 1.0, 40.0])
def test_a_spring_goes_from_end_to_end_and_is_as_wide_as_asked(length: float) -> None:
    start, direction = np.array([0.5, -1.0]), np.array([0.6, 0.8])
    line = spring(start, start + length * direction, 0.1)
    assert np.allclose(line[:, 0], start) and np.allclose(line[:, -1], start + length * direction)
    aside = np.array([-0.8, 0.6]) @ (line - start[:, None])
    assert np.isclose(np.ptp(aside), 0.1)
    assert np.count_nonzero(np.diff(np.sign(aside[np.abs(aside) > 1e-9]))) == 2 * SPRING_TURNS - 2


def test_a_spring_of_no_length_is_a_point() -> None:
    point = np.array([1.0, 2.0])
    assert np.array_equal(spring(point, point, 0.1), np.repeat(point[:, None], 2 * SPRING_TURNS + 3, axis=1))
