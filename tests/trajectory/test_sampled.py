"""The polynomial that is read off a solver's interpolant."""

from __future__ import annotations

import itertools
import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest

from lagrange.trajectory.paths.sampled import SampledPath, StepInterpolant, StepInterpolants
from lagrange.trajectory.trajectory import FloatArray


def curve(times: FloatArray) -> FloatArray:
    return np.array([times**4 - times, 3 * times**3])


def interpolant(first: float, last: float, degree: int = 5, off: float = 0.0) -> StepInterpolant:
    ends = curve(np.array([first, last])).T
    return StepInterpolant.read(
        (first, last), (ends[0], ends[1]), (first - off, last - off), lambda s: curve(s + off), degree
    )


@pytest.mark.parametrize("degree", [4, 5, 12])
@pytest.mark.parametrize("off", [0.0, 0.25])
def test_a_polynomial_is_read_whole(degree: int, off: float) -> None:
    for first, last in ((0.5, 1.25), (1.25, 0.5)):
        times = np.linspace(first, last, 41)
        np.testing.assert_allclose(interpolant(first, last, degree, off)(times), curve(times), rtol=0, atol=2e-15)


def test_it_passes_through_the_accepted_states_whatever_the_interpolant_does() -> None:
    ends = np.array([1.0, -1.0]), np.array([2.0, -2.0])
    found = StepInterpolant.read((0.0, 1.0), ends, (0.0, 1.0), lambda s: np.array([s + 1.5, -s]), 5)
    assert np.array_equal(found(np.array([0.0, 1.0])).T, ends)


def test_a_step_whose_path_is_no_number_is_a_line() -> None:
    """The states at its ends are sound, and the solver went on."""
    ends = np.array([1.0, -1.0]), np.array([2.0, -3.0])
    found = StepInterpolant.read((0.0, 1.0), ends, (0.0, 1.0), lambda s: np.array([s, np.where(s > 0.5, s, np.nan)]), 5)
    np.testing.assert_allclose(found(np.array([0.0, 0.25, 1.0])), [[1.0, 1.25, 2.0], [-1.0, -1.5, -3.0]], atol=1e-15)


@pytest.mark.parametrize("spacings", [1, 3, 40, 250])
def test_a_step_of_a_few_spacings_is_a_line(spacings: int) -> None:
    """Between rounded times the states of an interpolant go up in stairs; longer ones rise all the same."""
    theta = np.linspace(0, 1, 101)
    np.testing.assert_allclose(rounded(spacings)(theta)[0], theta, atol=1e-15)
    assert (np.diff(rounded(256 + spacings)(theta)[0]) > 0).all()


def rounded(spacings: int) -> StepInterpolant:
    """A rise from 0 to 1 within so many spacings of a time."""
    first = 1000.0
    last = first + spacings * np.spacing(first)
    ends = np.array([0.0]), np.array([1.0])
    return StepInterpolant.read((0.0, 1.0), ends, (first, last), lambda s: ((s - first) / (last - first))[None], 12)


def test_the_paths_of_a_burst_are_read_together() -> None:
    times = np.array([0.0, 0.5, 0.75, 2.0])
    path = SampledPath(times, curve(times).T, [interpolant(a, b) for a, b in itertools.pairwise(times)])
    theta, steps = np.array([0.0, 0.3, 0.5, 1.0]), np.array([0, 2])
    at = times[steps][:, None] + theta * np.diff(times)[steps][:, None]
    np.testing.assert_allclose(path.inside(steps, theta), curve(at.ravel()).reshape(2, 2, 4), atol=1e-14)


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
