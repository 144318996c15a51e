"""How large the entries of a state are where neither they nor their slopes say so.

An entry that is zero and stays so for many derivatives, as the far end of a chain that is plucked at the other, has no
size of its own yet, and one that is round-off of what cancels has none worth its name. What they are made of tells:
f at a state that is moved by a small part of all sizes changes by what each slope owes to the others, and over the
natural period of the motion that is a size. Entries, and time, may have any units: every comparison is of an entry with
itself, and the period is where what a change of the state does to the velocities is as large as these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lagrange.equations.state_layout import StateLayout
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.machine.state import LEAST_FLOOR, DriverState
from lagrange.machine.steps.control_constants import FLAT, NOISE, tilts
from lagrange.trajectory.trajectory import FloatArray

MOVE, JUMP = 2.0**-26, 2.0**8
"""The state is moved by the first part of its size, half of the digits, and by the second number times as much: what
answers both alike is a jump of the slopes, as where a contact ends, and its size is all that it says."""

NEAR_REST = 2.0**-40
"""Where all is zero there is no size to move by: this part of what forces reach in the time left is tried as well."""

TURNS = 3
"""So often the answer of the slopes to the answer to a move is the next move. The largest factor between the two is
then the square of the fastest rate, whatever the units are."""

SETTLED = 8.0
"""An entry without a size gets what its neighbours change of it in a period. Where these sizes then change themselves
by so many times as much, that part of the system is faster: the period is shorter."""

ROUNDS = 256
"""Sizes are handed on so often at most, from one entry of a chain to the next in two rounds."""

AHEAD = (0.0, 1.0, 4.0, 16.0, 64.0)
"""Forces that depend on time are looked at so many steps ahead: of a system at rest they may be all there is."""

HALVINGS = 52
"""Forces that have not acted yet are looked for at the time left, its half, its quarter and so on."""

LOOKS = 64
"""So often along a run a solver's forces are looked at before it."""

Slopes = Callable[[float, FloatArray], FloatArray]


def survey(model: Model, parameters: FloatArray, state: DriverState) -> None:
    """Raise the floors of a run that came back as UNSCALED; see `Outcome`."""
    reals = state.reals
    state.counts[DriverState.SURVEYED] += 1
    t, left = state.t, float(reals[DriverState.END]) - state.t
    h = float(reals[DriverState.H])
    looks = [t + _within(part * (h or FLAT * left), left) for part in AHEAD]
    if not state.y.any():
        looks += [t + left * 2.0**-k for k in range(HALVINGS)]
    slopes, layout = slopes_of(model, parameters), model.layout
    sizes, owed, _ = entry_sizes(slopes, layout, t, state.y, left, looks)
    share = reals[DriverState.SHARE]
    blank = state.floors <= np.maximum(LEAST_FLOOR, share * NOISE * owed)
    found = np.where(blank, share * sizes, 0.0)
    state.floors[:] = np.maximum(state.floors, np.maximum(found, NOISE * owed))


def first_floors(
    slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, left: float, share: float
) -> tuple[FloatArray, float]:
    """Return floors (2n,) for a solver that cannot ask for them, a share of the sizes at its start, and the period."""
    looks = [t + left * k / LOOKS for k in range(LOOKS + 1)]
    sizes, owed, period = entry_sizes(slopes, layout, t, y, left, looks)
    return np.maximum(np.maximum(share * sizes, NOISE * owed), LEAST_FLOOR), period


def _within(step: float, left: float) -> float:
    """Return a step, or all that is left if that is shorter."""
    return step if abs(step) < abs(left) else left


def slopes_of(model: Model, parameters: FloatArray) -> Slopes:
    """Return the right-hand side, NaN where the mass matrix is singular."""
    kernel = model.kernel("rhs")

    def slopes(t: float, y: FloatArray) -> FloatArray:
        try:
            return kernel(t, y, parameters)
        except SingularMassMatrix:
            return np.full_like(y, np.nan)

    return slopes


def entry_sizes(
    slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, left: float, looks: Sequence[float]
) -> tuple[FloatArray, FloatArray, float]:
    """Return the sizes (2n,) of entries, what they owe to one another over the natural period, and that period.

    `left` is the time that the run has to go, signed, `looks` are times at which forces may act.
    """
    with np.errstate(all="ignore"):
        slope = slopes(t, y)
        answer = _Answer(lambda state: slopes(t, state), slope, y)
        own = partial(_own, layout, y)
        force = np.fmax.reduce([np.abs(slopes(when, y)[layout.v]) for when in looks])
        period = abs(left)
        noise = NOISE * answer(own(np.zeros_like(force), period))[layout.v]
        force = np.where(np.isfinite(force) & (force > noise), force, 0.0)
        rate = max(answer.rate(part * own(force, period)) for part in ((1.0,) if y.any() else (1.0, NEAR_REST)))
        period = min(period, 1 / rate) if rate > 0 else period
        size, handed = own(force, period), np.zeros(len(y), dtype=bool)
        for _ in range(ROUNDS):
            owed = period * answer(size)
            fresh = (size <= NOISE * owed) & (owed > 0)
            change = float(np.max(owed[handed] / size[handed], initial=0.0))
            if change > SETTLED:
                period = period / float(np.sqrt(change))
                size, handed = own(force, period), np.zeros(len(y), dtype=bool)
            elif fresh.any():
                size, handed = np.where(fresh, owed, size), handed | fresh
            else:
                break
    q, v = layout.split(owed)
    return size, np.concatenate([np.maximum(q, period * v), v]), period


def _own(layout: StateLayout, y: FloatArray, force: FloatArray, period: float) -> FloatArray:
    """Return the sizes (2n,) that entries have by themselves: what they are, and what they become in a period."""
    q, v = layout.split(np.abs(y))
    v = np.maximum(v, period * force)
    return np.concatenate([np.maximum(q, period * v), v])


class _Answer:
    """What slopes change by where the state moves, as if they were linear in it."""

    def __init__(self, slopes: Callable[[FloatArray], FloatArray], slope: FloatArray, y: FloatArray) -> None:
        self._slopes, self._slope, self._y = slopes, slope, y

    def __call__(self, move: FloatArray) -> FloatArray:
        """Return the sizes of the changes (2n,) for a move (2n,), whatever its length."""
        y, far = self._y, move > 0
        if not far.any():
            return np.zeros_like(y)
        known = far & (y != 0)
        part = MOVE * min(1.0, float(np.max(np.abs(y[known]) / move[known]))) if known.any() else MOVE
        ways = (part, JUMP * part)
        near, wide = (np.abs(self._slopes(y + way * tilts(len(y)) * move) - self._slope) for way in ways)
        jumps = 16 * near > wide
        found = np.where(jumps, wide, np.fmin(near / part, wide / (JUMP * part)))
        return np.where(np.isfinite(found), found, 0.0)

    def rate(self, move: FloatArray) -> float:
        """Return the fastest rate of the motion near the state, 0 where nothing answers to a move (2n,).

        Entries that do not move by themselves tell nothing: what they get is from others, in round-off at first.
        """
        known, found = move > 0, np.inf
        for _ in range(TURNS):
            then = self(self(move))
            both = known & (move > 0) & np.isfinite(then)
            found = min(found, float(np.max(then[both] / move[both], initial=0.0)))
            move = then
        return float(np.sqrt(found))
