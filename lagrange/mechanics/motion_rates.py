"""Rates along the motion at many states, from the compiled laws: p, dL/dq + Q - dD/dv, and the power."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lagrange.errors import RunError, StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.trajectory.constraints.consistent import consistent_state

STEP = 1e-5
"""Step of the central difference in time, whose error is then some 1e-10."""


CORRECTIONS = 40
"""Newton steps onto the constraints, half of them for positions; each doubles the digits near them."""

ON_CONSTRAINTS = 1e-10
"""Violation of constraints whose numbers are of order one."""


@dataclass(frozen=True, eq=False)
class MotionRates:
    """Random states of a model, (n, K), at times (K,), all with the same random parameters (k,)."""

    model: Model
    t: FloatArray
    y: FloatArray
    parameters: FloatArray

    @property
    def q(self) -> FloatArray:
        """The coordinates, (n, K)."""
        return self.y[self.model.layout.q]

    @property
    def v(self) -> FloatArray:
        """The velocities, (n, K)."""
        return self.y[self.model.layout.v]

    @cached_property
    def momenta(self) -> FloatArray:
        """The momenta dL/dv, (n, K)."""
        return self._values("momenta")

    @cached_property
    def forces(self) -> FloatArray:
        """What changes the momenta beside constraints, dL/dq + Q - dD/dv, (n, K)."""
        return self._values("forces")

    @cached_property
    def power(self) -> FloatArray:
        """The rate of the energy beside constraints, -dL/dt + (Q - dD/dv) . v, (K,)."""
        decisions = self.model.equations.structure.decisions
        if decisions.powerless is True:
            return np.zeros(len(self.t))
        applied = self.model.function("applied_forces", tuple(decisions.laws.extra))
        with np.errstate(all="ignore"):
            work: FloatArray = np.sum(applied(self.t, self.y, self.parameters) * self.v, axis=0)
            if decisions.timeless is True:
                return work
            lagrangian = self.model.interpreted("lagrangian")
            ahead, behind = (lagrangian(self.t + way * STEP, self.y, self.parameters) for way in (1, -1))
        return work - (ahead - behind) / (2 * STEP)

    @cached_property
    def gradient(self) -> FloatArray:
        """The rows of constraints on velocities, (m, n, K)."""
        return self._values("constraint_gradient")

    def _values(self, name: str) -> FloatArray:
        with np.errstate(all="ignore"):
            return self.model.interpreted(name)(self.t, self.y, self.parameters)


def random_rates(model: Model, count: int, seed: int, *, moving: bool = True) -> MotionRates:
    """Return that many random states, on the constraints where there are some; fewer where none are found.

    Velocities that equations of first order determine are theirs, unless the states need not be `moving`.
    """
    draw = np.random.default_rng(seed)
    statement, n = model.statement, model.dimension
    usual = np.array([statement.defaults.get(p, 1.0) or 1.0 for p in statement.parameters])
    parameters = usual / np.abs(usual) * draw.uniform(0.5, 1.6, len(usual))
    signs = draw.choice((-1.0, 1.0), (2 * n, count))
    y = draw.uniform(0.3, 1.4, (2 * n, count)) * signs
    y[:, ::3] = np.array(statement.initial)[:, None] + 0.2 * y[:, ::3]
    y[:n, 1::3] = np.abs(y[:n, 1::3])
    y[n:, 1::3] *= 0.2
    t = draw.uniform(0.2, 1.7, count)
    if moving and model.equations.first_order:
        found = [_completed(model, float(t[k]), y[:, k], parameters) for k in range(count)]
        kept = [k for k, state in enumerate(found) if state is not None]
        y, t = np.array([state for state in found if state is not None]).reshape(-1, 2 * n).T, t[kept]
    elif statement.constraints:
        y, t = _held(model, t, y, parameters)
    return MotionRates(model, t, y, parameters)


def _completed(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray | None:
    """Return a state with the velocities that equations of first order give it; None where there is none."""
    try:
        return consistent_state(model, t, y, parameters)
    except (RunError, StatementError):
        return None


def _held(model: Model, t: FloatArray, y: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return states moved onto the constraints by Newton's method, and their times; fewer where that fails."""
    n, m, y = model.dimension, len(model.statement.constraints), y.copy()
    constraints, gradient = (model.interpreted(name) for name in ("constraints", "constraint_gradient"))
    with np.errstate(all="ignore"):
        for step in range(CORRECTIONS):
            violations = constraints(t, y, parameters)
            rows = np.nan_to_num(np.moveaxis(gradient(t, y, parameters), -1, 0))
            # Positions first: the velocities follow when these are there.
            part = slice(0, m) if step < CORRECTIONS // 2 else slice(m, 2 * m)
            change = np.linalg.pinv(rows) @ np.nan_to_num(violations[part].T[:, :, None])
            y[:n] -= change[:, :, 0].T if part.start == 0 else 0.0
            y[n:] -= change[:, :, 0].T if part.start else 0.0
        kept = np.abs(constraints(t, y, parameters)).max(axis=0) < ON_CONSTRAINTS
    return y[:, kept], t[kept]
