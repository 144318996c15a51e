"""Interpolate states between the outputs of a run without dense output, such as a run from a file, for pictures."""

from __future__ import annotations

import numpy as np

from lagrange.errors import StatementError
from lagrange.trajectory.dense_output import OutputPath
from lagrange.trajectory.measures.times_and_points import divided
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Trajectory

PER_STEP, MOST_STORED = 4, 20_000
"""Number of states that a file stores per step in addition to the outputs, and the largest total: files stay small."""

LARGEST_ERROR = 2e-3
"""Largest error of a coordinate between two outputs, relative to its largest change between neighbouring outputs. A
step changes a coordinate by at most about half of its amplitude. Then the error is a thousandth of the amplitude: less
than a pixel."""

STATE_NOISE = 1e-9  # Rounding noise, relative to the largest entry of all states


def stored_between(run: Trajectory) -> dict[str, FloatArray]:
    """Return the arrays that a file stores for times between the outputs of a run: `t_between` and `y_between`.

    `t_between` (K,) are the times, `y_between` (2n, K) the states. They are empty if the run has no dense output or
    would make a large file.
    """
    parts = -(-PER_STEP * run.steps // max(len(run.t) - 1, 1))
    if known_alone(run) is not None or len(run.t) < 2 or parts * len(run.t) > MOST_STORED:
        return {}
    t = np.setdiff1d(divided(run.t, parts), run.t)
    return {"t_between": t, "y_between": run.dense(t)}


def known_alone(run: Trajectory) -> OutputPath | None:
    """Return the stored states and times of a run without dense output; None for a run with dense output."""
    return run.dense if isinstance(run.dense, OutputPath) and run.dense.path is None else None


def states_for_pictures(solution: Solution, t: FloatArray) -> FloatArray:
    """Return the states (2n, K) of a run at times t (K,): from its dense output, or interpolated if it has none.

    Interpolated coordinates are polynomials of degree 5 through the coordinates, velocities and accelerations at two
    outputs. Raises StatementError if the outputs are too far apart for such polynomials.
    """
    known_states = known_alone(solution.trajectory)
    if known_states is None or np.isin(t, known_states.times).all():
        return solution.at(t)
    between = _Between(solution, known_states)
    between.test()
    states, _ = between(t)
    return states


class _Between:
    """Interpolation polynomials between the known states of a run without dense output, ordered by increasing time."""

    def __init__(self, solution: Solution, known: OutputPath) -> None:
        order = slice(None, None, 1 if known.times[-1] >= known.times[0] else -1)
        self.solution, self.t, self.y = solution, known.times[order], np.ascontiguousarray(known.states[:, order])
        self.n = solution.model.layout.v.start
        self.rates = self._rates(self.t, self.y)

    def _rates(self, t: FloatArray, y: FloatArray) -> FloatArray:
        return self.solution.model.rhs(t, np.ascontiguousarray(y), self.solution.parameters_at(t))

    def __call__(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the interpolated states (2n, K) and accelerations (n, K) at times t (K,)."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = self.t[k + 1] - self.t[k]
        s = (t - self.t[k]) / h
        q0, q1 = self.y[: self.n, k], self.y[: self.n, k + 1]
        v0, v1 = self.y[self.n :, k] * h, self.y[self.n :, k + 1] * h
        a0, a1 = self.rates[self.n :, k] * h * h / 2, self.rates[self.n :, k + 1] * h * h / 2
        q, v, a = q1 - q0 - v0 - a0, v1 - v0 - 2 * a0, a1 - a0
        c3, c4, c5 = 10 * q - 4 * v + a, -15 * q + 7 * v - 2 * a, 6 * q - 3 * v + a
        position = q0 + s * (v0 + s * (a0 + s * (c3 + s * (c4 + s * c5))))
        speed = (v0 + s * (2 * a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h
        return np.vstack([position, speed]), (2 * a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / h**2

    def test(self) -> None:
        """Raise StatementError if a polynomial has too large an error in the middle of its interval.

        The error is estimated there from the difference between the acceleration of the polynomial and the one of the
        equations of motion. On an interval of length h the error is c h^6/64 with some constant c, and the difference
        is 3 c h^4/8.
        """
        h = np.diff(self.t)
        apart = np.flatnonzero(h > 0)
        middles = self.t[apart] + h[apart] / 2
        states, accelerations = self(middles)
        error = np.abs(self._rates(middles, states)[self.n :] - accelerations) * h[apart] ** 2 / 24
        change = np.abs(np.diff(self.y[: self.n])).max(axis=1, keepdims=True)
        wrong = ~(error <= LARGEST_ERROR * change + STATE_NOISE * np.abs(self.y).max())
        if wrong.any():
            index = apart[int(wrong.any(axis=0).argmax())]
            raise StatementError(
                f"the states at t = {self.t[index]:.6g} and {self.t[index + 1]:.6g} are too far apart for a moving "
                "picture, and the file has none between. Run the system again, or write a run with more outputs."
            )
