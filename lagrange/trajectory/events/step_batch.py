"""Sample event functions on a batch of steps along the dense output, and test whether they keep their sign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.algorithm.dense.block import chebyshev_points
from lagrange.algorithm.events.constants import DENSE_ROUND_OFF, NOISE, SURELY, TAIL
from lagrange.algorithm.events.samples import COARSE, DEGREE, to_chebyshev
from lagrange.machine.backend import Kernel, Places
from lagrange.trajectory.trajectory import FloatArray

FULL_AT_ONCE = 12
"""Largest number of steps in a batch whose event functions are all sampled at 17 nodes. In a larger batch they are
sampled at 9 nodes first, and at 17 only on steps that may have an event."""


class StepsPath(Protocol):
    """The dense output of S accepted steps: on each step a polynomial in time, of degree at most 16.

    It passes through the states at both ends of the step.
    """

    @property
    def times(self) -> FloatArray:
        """The times of the ends of the steps, (S+1,)."""

    @property
    def states(self) -> FloatArray:
        """The states at the ends of the steps, (S+1, 2n)."""

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states (2n, k, K) at the fractions theta (K,) of each of the k steps with the indices `steps`."""


PathOf = Callable[[FloatArray, FloatArray], StepsPath]
"""Type of a function that returns the dense output of S steps from their accepted times (S+1,) and states (S+1, 2n)."""


@dataclass(frozen=True, eq=False)
class Window:
    """Part of the dense output `path`: the S steps from index `begin` to before `end`. It is itself a dense output."""

    path: StepsPath
    begin: int
    end: int

    @property
    def times(self) -> FloatArray:
        """The times of the ends of the S steps, (S+1,)."""
        return self.path.times[self.begin : self.end + 1]

    @property
    def states(self) -> FloatArray:
        """The states at the ends of the S steps, (S+1, 2n)."""
        return self.path.states[self.begin : self.end + 1]

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states (2n, k, K) at the fractions theta (K,) of each of k steps.

        `steps` (k,) are the indices of the steps, counted from `begin`.
        """
        return self.path.inside(steps + self.begin, theta)


@dataclass(frozen=True, eq=False)
class Sample:
    """A step from time `t` with length `h`, and its event functions `values` (E, 17) at 17 Chebyshev nodes.

    `states` (2n, 17) are not values but the Chebyshev coefficients of the state on the step. `batch` is the batch
    that has the step.
    """

    t: float
    h: float
    states: FloatArray
    values: FloatArray
    batch: StepBatch

    def state(self, s: float) -> FloatArray:
        """Return the state (2n,) at fraction s of the step."""
        return evaluate(self.states, np.array([s]))[:, 0]

    def rates(self, s: FloatArray) -> FloatArray:
        """Return the derivatives (E, K) of the event functions with respect to the fraction s (K,) of the step.

        They are the time derivatives at these fractions, multiplied by the length of the step.
        """
        rates = self.batch.rates()
        return self.h * rates(self.t + self.h * s, evaluate(self.states, s), self.batch.parameters)

    def events(self, s: FloatArray) -> FloatArray:
        """Return the values (E, K) of the event functions at the fractions s (K,) of the step."""
        return self.batch.kernel(self.t + self.h * s, evaluate(self.states, s), self.batch.parameters)


@dataclass(frozen=True, eq=False)
class StepBatch:
    """A batch of S accepted steps: the path over them, and E event functions along it.

    `kernel` evaluates the event functions, and `rates()` returns the kernel of their time derivatives. `ends` (E, S+1)
    are the values of the functions at the ends of the steps, and `edge` (E, S+1) their rounding errors. `noise` (E, S)
    is the error of a function on a step. `sensitive` (E, S) is the part of this error that grows with the change of the
    state on the step. `certain` (E, S) is True if the function certainly keeps its sign on the step. `samples` has the
    stored samples of steps, by the index of the step.
    """

    kernel: Kernel
    rates: Callable[[], Kernel]
    parameters: FloatArray
    path: StepsPath
    ends: FloatArray
    edge: FloatArray
    noise: FloatArray
    sensitive: FloatArray
    certain: NDArray[np.bool_]
    samples: dict[int, Sample] = field(default_factory=dict)

    @classmethod
    def of(cls, kernel: Kernel, rates: Callable[[], Kernel], parameters: FloatArray, path: StepsPath) -> StepBatch:
        """Return the batch of all steps of a path, with its event functions sampled.

        `kernel` evaluates the event functions, and `rates()` returns the kernel of their time derivatives. `parameters`
        (k,) are the parameters of the model.
        """
        times, states = path.times, path.states.T
        ends = kernel(times, states, parameters)
        tilt = perturbation_factors(len(states) + 1)
        edge = state_noise(kernel, parameters, times, states, ends)
        steps: Places = np.arange(len(times) - 1)
        degree = DEGREE if len(steps) <= FULL_AT_ONCE else COARSE
        samples = _sampled(path, steps, degree)
        values = _along(kernel, parameters, path, steps, samples)
        with np.errstate(all="ignore"):
            noise = np.maximum(edge[:, 1:], edge[:, :-1])
            # The error scales with the change of the state: x**2 + v**2 may be constant while x and v change. It is
            # sampled at the same nodes for any number of steps: every second node of the full degree.
            coarse = slice(None, None, degree // COARSE)
            moves = states[:, :-1] + RELATIVE_PERTURBATION * np.ptp(samples[..., coarse], axis=-1) * tilt[:-1, None]
            gain = np.abs(kernel(times[:-1], moves, parameters) - ends[:, :-1]) / RELATIVE_PERTURBATION
            spread = np.fmax(np.ptp(values[..., coarse], axis=-1), gain)
            sensitive = DENSE_ROUND_OFF * np.where(np.isfinite(spread), spread, 0.0)
            noise = noise + sensitive
            sure = certain(values[..., coarse] @ to_chebyshev(COARSE).T, noise)
        batch = cls(kernel, rates, parameters, path, ends, edge, noise, sensitive, sure)
        if degree == DEGREE:
            batch._keep(steps, samples, values)
        elif not sure.all():
            doubtful: Places = np.flatnonzero(~sure.all(axis=0))
            samples = _sampled(path, doubtful, DEGREE)
            batch._keep(doubtful, samples, _along(kernel, parameters, path, doubtful, samples))
        return batch

    def sample(self, step: int) -> Sample:
        """Return the sample of step number `step` at all 17 nodes."""
        if step not in self.samples:
            steps = np.array([step])
            samples = _sampled(self.path, steps, DEGREE)
            self._keep(steps, samples, _along(self.kernel, self.parameters, self.path, steps, samples))
        return self.samples[step]

    def _keep(self, steps: Places, states: FloatArray, values: FloatArray) -> None:
        """Store the samples of k steps, from states (2n, k, 17) and event functions `values` (E, k, 17) at nodes."""
        times = self.path.times
        # A matrix product would round a step differently for different numbers of steps.
        coefficients = np.zeros_like(states)
        for node, column in zip(np.moveaxis(states, -1, 0), to_chebyshev().T, strict=True):
            coefficients += node[..., None] * column
        for i, step in enumerate(steps.tolist()):
            t, end = float(times[step]), float(times[step + 1])
            self.samples[step] = Sample(t, end - t, coefficients[:, i], values[:, i], self)


def evaluate(chebyshev: FloatArray, s: FloatArray) -> FloatArray:
    """Return the values (..., K) at s (K,) in [0, 1] of functions with Chebyshev coefficients (..., degree + 1)."""
    ranks = np.arange(chebyshev.shape[-1])
    angles = 2 * np.arcsin(np.sqrt(s))
    return np.asarray(chebyshev @ ((-1.0) ** ranks[:, None] * np.cos(np.outer(ranks, angles))))


def certain(chebyshev: FloatArray, noise: FloatArray) -> NDArray[np.bool_]:
    """Return a mask (...): True where Chebyshev coefficients (..., degree + 1) prove that a function keeps its sign.

    `noise` (...) are the errors of the functions. The omitted terms of the Chebyshev series are estimated as eight
    times the larger of the last two coefficients.
    """
    sizes = np.abs(chebyshev)
    tail = sizes[..., 1:].sum(axis=-1) + TAIL * sizes[..., -2:].max(axis=-1) + 4 * noise
    return np.asarray(sizes[..., 0] > SURELY * tail)


def state_noise(
    kernel: Kernel, parameters: FloatArray, times: FloatArray, states: FloatArray, values: FloatArray
) -> FloatArray:
    """Return the errors (E, k) of event functions due to rounding of the times (k,) and states (2n, k).

    `values` (E, k) are the functions at these times and states.
    """
    tilt = RELATIVE_PERTURBATION * perturbation_factors(len(states) + 1)
    with np.errstate(all="ignore"):
        moved = kernel(times * (1 + tilt[-1]), states * (1 + tilt[:-1, None]), parameters)
        edge = np.abs(moved - values) * (NOISE / RELATIVE_PERTURBATION)
    return np.where(np.isfinite(edge), edge, 0.0)


def _sampled(path: StepsPath, steps: Places, degree: int) -> FloatArray:
    """Return the states (2n, k, degree + 1) at the Chebyshev nodes of k steps of a path.

    `steps` (k,) are the indices of the steps. The outermost nodes of a step have its accepted states.
    """
    size, inner = path.states.shape[1], chebyshev_points(degree)[1:-1]
    states = np.empty((size, len(steps), degree + 1))
    states[..., 0], states[..., -1] = path.states[steps].T, path.states[steps + 1].T
    states[..., 1:-1] = path.inside(steps, inner)
    return states


def _along(kernel: Kernel, parameters: FloatArray, path: StepsPath, steps: Places, states: FloatArray) -> FloatArray:
    """Return the event functions (E, k, degree + 1) at the Chebyshev nodes of k steps of a path.

    `kernel` evaluates the event functions. `steps` (k,) are the indices of the steps, and `states` (2n, k, degree + 1)
    the states at their nodes.
    """
    size, count, points = states.shape
    start, end = path.times[steps][:, None], path.times[steps + 1][:, None]
    times = start + (end - start) * chebyshev_points(points - 1)
    times[:, -1:] = end
    return kernel(times.ravel(), states.reshape(size, -1), parameters).reshape(-1, count, points)
