"""Sums of a Taylor series on a step: the state at its end, the derivative, and the states at output times."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.taylor.memory import (
    BLOCK,
    HELD,
    OUTPUTS,
    SIZES,
    RecordedLayout,
    SeriesMemory,
    TaylorLayout,
    work_array,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole


@shared
def advance(layout: TaylorLayout) -> Procedure:
    """Return the procedure that adds the series to the state, compensated.

    The state is unchanged if the sum is not finite. The procedure stores the state before, and the derivative at the
    end in units of the next scale.
    """
    p = Builder("advance", "Add the series to the state, and return whether it stays finite.")
    s, longer = p.given("s", REAL), p.given("longer", REAL)
    run = SeriesMemory(p, layout, work_array(p))
    new, lost = (p.reserve(layout.padded, room=layout.block, name=name) for name in ("new", "lost"))
    state, low, slopes = (run.work.at(place) for place in (0, layout.lost, layout.slope))
    chains = _Chains(run, s) if layout.chains else None
    sums = _sums_by_rows(run, s) if layout.by_rows else None
    if chains is not None:
        chains.write_slopes(longer)
    with run.entries() as i:
        if chains is not None:
            move = chains.increment(i)
        else:
            move, slope = horner(run, s, i) if sums is None else (sums[0][i], sums[1][i])
            slopes[i] = slope * longer
        total, lost[i] = compensated(state[i], move + low[i])
        new[i] = total
        largest = p.largest_magnitude(total)
    good = (largest.value < math.inf).called("good")
    with p.when(good, likely=True):
        before, lost_before = (run.work.at(layout.held + place) for place in (0, layout.padded))
        with run.entries() as i:
            before[i], lost_before[i] = state[i], low[i]
            state[i], low[i] = new[i], lost[i]
    p.leave(good)
    return p.finish(FLAG)


FIRST = (1, 2, 3, 4)
"""First orders of the partial sums of a series."""


class _Chains:
    """Sums of a series in four chains in s**4, which take a quarter of the time of a single chain."""

    def __init__(self, run: SeriesMemory, s: Real) -> None:
        self.run, self.p, self.s = run, run.p, s
        self.square = s * s
        self.fourth = self.square * self.square

    def increment(self, i: Whole) -> Real:
        """Return the sum of x[k] s**k over k > 0."""
        p, chains = self.p, self._chains(i)
        odd, even = (p.fma(self.square, chains[k + 2], chains[k]) for k in (0, 1))
        found: Real = p.fma(self.s, odd, self.square * even)
        return found

    def _chains(self, i: Whole) -> list[Any]:
        """Return the sums of x[k] s**(k - first) over k = first, first + 4, ... for each first order.

        Chains with one coefficient more than the others begin one step earlier.
        """
        p, run, count = self.p, self.run, len(FIRST)
        steps = run.order // count
        longer = run.order - steps * count
        chains = []
        for first in FIRST:
            top, below = (run.row(first + count * (steps - less))[i] for less in (0, 1))
            chains.append(p.variable(p.choose(longer >= first, p.fma(top, self.fourth, below), below)))
        with p.loop(2, steps + 1) as j:
            for first, chain in zip(FIRST, chains, strict=True):
                chain.value = p.fma(chain.value, self.fourth, run.row(first + count * (steps - j))[i])
        return [chain.value for chain in chains]

    def write_slopes(self, longer: Real) -> None:
        """Write the sums of k x[k] s**(k - 1), by Horner's rule for a polynomial and its derivative.

        Only blocks with velocities are summed: the equations of the coordinates hold by construction.
        """
        run, p, begin = self.run, self.p, self.run.layout.moving
        slopes = run.work.at(run.layout.slope + begin)
        with run.entries(begin) as i:
            total, slope = p.variable(run.row(run.order).at(begin)[i]), p.variable(0.0)
            with p.loop(1, run.order) as j:
                slope.value = p.fma(slope.value, self.s, total.value)
                total.value = p.fma(total.value, self.s, run.row(run.order - j).at(begin)[i])
            slopes[i] = p.fma(slope.value, self.s, total.value) * longer


def increment(run: SeriesMemory, s: Real) -> Callable[[Whole], Real]:
    """Return a function from an entry to its sum of x[k] s**k over k > 0."""
    if run.layout.chains:
        return _Chains(run, s).increment
    return lambda i: horner(run, s, i)[0]


@shared
def state_on_step() -> Procedure:
    """Return the procedure that writes the state at a time on a step, for every layout."""
    p = Builder("state_on_step", "Write the state at a time on a step.", apart=True)
    s, to = p.given("s", REAL), p.array("to", room=BLOCK)
    sizes: Any = p.record("sizes", SIZES)
    layout = RecordedLayout(sizes)
    run = SeriesMemory(p, layout, work_array(p))
    layout.read()
    work, lost = run.work, run.work.at(layout.lost)
    with p.when(~layout.chains.equals(0), likely=True) as ways:
        sums = _Chains(run, s).increment
        with p.each(layout.dimension, width=BLOCK) as i:
            to[i] = work[i] + (sums(i) + lost[i])
    with ways.otherwise(), p.each(layout.dimension, width=BLOCK) as i:
        to[i] = work[i] + (horner(run, s, i)[0] + lost[i])
    return p.finish()


def horner(run: SeriesMemory, s: Real, i: Whole) -> tuple[Real, Real]:
    """Return an entry's sum of x[k] s**k over k > 0 and that of k x[k] s**(k - 1), for any order."""
    p = run.p
    total, slope = p.variable(0.0), p.variable(0.0)
    with p.loop(0, run.order) as j:
        partial = total.value + run.row(run.order - j)[i]
        slope.value = p.fma(slope.value, s, partial)
        total.value = partial * s
    return total.value, slope.value


def _sums_by_rows(run: SeriesMemory, s: Real) -> tuple[Memory, Memory]:
    """Return the sums of `horner` for all entries at once, in arrays."""
    p, size = run.p, run.layout.padded
    totals, slopes = (p.reserve(size, room=run.layout.block, name=name) for name in ("totals", "slopes"))
    with run.entries() as i:
        totals[i] = 0.0
        slopes[i] = 0.0
    with p.loop(0, run.order) as j:
        row = run.row(run.order - j)
        with run.entries() as i:
            partial = totals[i] + row[i]
            slopes[i] = p.fma(slopes[i], s, partial)
            totals[i] = partial * s
    return totals, slopes


def outstanding(wanted: Memory, place: Whole, end: Real, scale: Real) -> Flag:
    """Return whether an output time at an index exists and lies before the end of a step."""
    found: Flag = (wanted[place] - end) * scale < 0.0
    return found


@shared
def write_outputs(layout: TaylorLayout) -> Procedure:
    """Return the procedure that writes the states at the output times before the end of the last step, `end`.

    A time at the end itself belongs to the next step, which begins with the state at that time.
    """
    p = Builder("write_outputs", "Write the states at the output times on the last step.", apart=True)
    end: Real = p.given("end", REAL)
    held: Any = p.record("held", HELD)
    outputs: Any = p.record("outputs", OUTPUTS)
    wanted, states = p.array("wanted", read=True), p.array("states", room=layout.block)
    run = SeriesMemory(p, layout, work_array(p))
    t, low, scale = held.t, held.low, held.scale
    inverse = 1.0 / scale
    before, lost = (run.work.at(layout.held + place) for place in (0, layout.padded))
    k = p.variable(outputs.done, "k")
    with p.repeat(lambda: outstanding(wanted, k.value, end, scale)):
        since: Real = wanted[k.value] - t
        s: Real = p.choose(since.equals(0.0), 0.0, since - low) * inverse
        sums = increment(run, s)
        target = states.at(k.value * layout.dimension)
        with p.each(layout.dimension, width=layout.block, unrolled=layout.chains) as i:
            target[i] = before[i] + (sums(i) + lost[i])
        k.value = k.value + 1
    outputs.ahead = k.value
    return p.finish()
