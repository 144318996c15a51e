"""The initial state in new coordinates: x(q) = x_0 solved by number, then (dx/dq) dq/dt = v_0 - dx/dt."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.errors import StatementError, listing
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.precise import Precise
from lagrange.machine.backend import FloatArray
from lagrange.statement.statement import Statement

STARTS = 60
"""Starts of the iteration: zero, then random ones of sizes from a tenth of the given values to ten times."""

STEPS = 60
"""Steps of Newton's method from one start; it converges in ten where it does."""

CLOSE = 1e-12
"""Largest residual of a solution, relative to the values and to 1: a thousand roundings."""

DIGITS = 20
"""Digits in which the expressions are evaluated, so that residuals of 1e-12 have no rounding."""


@dataclass(frozen=True, eq=False)
class Preimage:
    """Old coordinates as functions of new ones: `values` x, `slopes` dx/dq (by all new ones) and `drifts` dx/dt.

    `statement` has the new coordinates; `unknowns` says where those stand that are solved for, `angles` which of them
    come round after a full turn, `positive` which have to be positive. `names` are those of the old coordinates.
    """

    statement: Statement
    names: tuple[str, ...]
    unknowns: tuple[int, ...]
    angles: tuple[bool, ...]
    positive: tuple[bool, ...]
    values: tuple[Any, ...]
    slopes: tuple[tuple[Any, ...], ...]
    drifts: tuple[Any, ...]

    def solved(self, places: Sequence[float], rates: Sequence[float]) -> tuple[float, ...]:
        """Return the new initial state (q, v) at which the old one has these values.

        Raises StatementError where there is none, or parameters have no values.
        """
        n = len(self.statement.coordinates)
        missing = [p.name for p in self._parameters if p not in self.statement.defaults]
        if missing:
            if any(places) or any(rates):
                raise StatementError(
                    f"the initial state is not solved for without a value of {listing(missing)}: give one, or "
                    f"initial={{{self._new[0]}: ...}} in the new coordinates."
                )
            return self.statement.initial
        q, v = np.array(self.statement.initial[:n]), np.array(self.statement.initial[n:])
        q[list(self.unknowns)] = self._places(q, np.array(places))
        slopes, drifts = self._evaluated(self._rates, q)
        rest = np.array(rates) - drifts - slopes @ v
        columns = slopes[:, list(self.unknowns)]
        found = np.linalg.lstsq(columns, rest, rcond=None)[0]
        scale = max(1.0, float(np.abs(rest).max()))
        if float(np.abs(columns @ found - rest).max()) > 1e3 * CLOSE * scale:
            there = ", ".join(f"{name} = {q[i]:.6g}" for name, i in zip(self._new, self.unknowns, strict=True))
            raise StatementError(
                f"the initial velocities have no values in the new coordinates: at {there} they are singular. Give "
                f"another initial state, or initial={{{self._new[0]}: ...}} in the new coordinates."
            )
        v[list(self.unknowns)] = found
        return (*map(float, q), *map(float, v))

    @property
    def _new(self) -> tuple[str, ...]:
        return tuple(self.statement.names[i] for i in self.unknowns)

    @cached_property
    def _parameters(self) -> list[Any]:
        used = [x.free_symbols for x in (*self.values, *itertools.chain(*self.slopes), *self.drifts)]
        return [p for p in self.statement.parameters if any(p in symbols for symbols in used)]

    @cached_property
    def _residual(self) -> Precise:
        columns = [row[i] for row in self.slopes for i in self.unknowns]
        return Precise([*self.values, *columns], self.statement, DIGITS)

    @cached_property
    def _rates(self) -> Precise:
        return Precise([*self.drifts, *itertools.chain(*self.slopes)], self.statement, DIGITS)

    def _evaluated(self, tape: Precise, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the matrix and the vector of a tape at the initial time."""
        given = {p: self.statement.defaults.get(p, 1.0) for p in self.statement.parameters}
        numbers = np.array([float(x) for x in tape(list(q), [0.0] * len(q), 0.0, given)])
        m = len(self.values)
        return numbers[m:].reshape(m, -1), numbers[:m]

    def _places(self, q: FloatArray, wanted: FloatArray) -> FloatArray:
        """Return the new coordinates at which the old ones have values: small ones, positive where both are."""
        found = [u for start in self._starts(wanted) for u in self._newton(q.copy(), start, wanted)]
        if not found:
            given = ", ".join(f"{name} = {x:.6g}" for name, x in zip(self.names, wanted, strict=True))
            raise StatementError(
                f"no values of {listing(self._new)} were found at which {given}, from {STARTS} starts: give "
                f"initial={{{self._new[0]}: ...}} in the new coordinates."
            )
        return min(found, key=self._preference)

    def _preference(self, u: FloatArray) -> tuple[int, float]:
        """Return a sort key of solutions: those with positive lengths first, then those with small values."""
        negative = sum(x < -CLOSE for x, angle in zip(u, self.angles, strict=True) if not angle)
        return negative, round(float(np.abs(u).sum()), 9) - 1e-10 * float(u.sum() > 0)

    def _starts(self, wanted: FloatArray) -> Iterator[FloatArray]:
        draw = random.Random(0)
        k, size = len(self.unknowns), max(1.0, float(np.abs(wanted).max()))
        yield np.zeros(k)
        for _ in range(STARTS - 1):
            scale = size * 10.0 ** draw.uniform(-1.0, 1.0)
            yield np.array([draw.uniform(-3.0, 3.0) if angle else scale * draw.uniform(-1, 1) for angle in self.angles])

    def _newton(self, q: FloatArray, u: FloatArray, wanted: FloatArray) -> Iterator[FloatArray]:
        """Yield the solution that Newton's method finds from a start, if it finds one."""
        scale = max(1.0, float(np.abs(wanted).max()))
        for _ in range(STEPS):
            q[list(self.unknowns)] = u
            try:
                slopes, values = self._evaluated(self._residual, q)
            except OutsideDomain:
                return
            residual = values - wanted
            off = float(np.abs(residual).max())
            if not math.isfinite(off) or not np.isfinite(slopes).all():
                return
            if off <= CLOSE * scale:
                u = self._wrapped(u - np.linalg.lstsq(slopes, residual, rcond=None)[0] if off else u)
                if all(x > 0 for x, above in zip(u, self.positive, strict=True) if above) or not any(wanted):
                    yield u
                return
            step = np.linalg.lstsq(slopes, residual, rcond=None)[0]
            u = u - step * min(1.0, 10.0 * scale / max(float(np.abs(step).max()), 1e-300))

    def _wrapped(self, u: FloatArray) -> FloatArray:
        """Return angles between -pi and pi."""
        turns = np.where(self.angles, np.ceil(u / (2 * math.pi) - 0.5), 0.0)
        wrapped: FloatArray = u - 2 * math.pi * turns
        return wrapped
