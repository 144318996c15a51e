"""An event along one step of a step program: its zeros, and on which side of zero it goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lagrange.procedure.events.chebyshev import DEGREE, nodes, to_chebyshev
from lagrange.procedure.events.constants import EPSILON, JUMP
from lagrange.trajectory.events.roots import Isolate, Root, Side, roots
from lagrange.trajectory.events.step_batch import Sample, StepBatch
from lagrange.trajectory.paths.chebyshev import LocalPolynomial, local_polynomials, powers

RATE_NOISE = 1024 * EPSILON
"""The part of a derivative that is noise: 500 roundings is what the weights of DOP853's path make of one."""

SAME_JUMP = 2.0**-44
"""Two jumps that are closer than this part of a step are one there and back: of the state, 256 spacings."""


@dataclass(frozen=True, eq=False)
class StepZeros:
    """The zeros of an event on a step, in units of the step, in order.

    `parts` are the parts of the step with the side before each. `after` is the side at the end, `until` where the event
    ceases to have a value, else infinity. Where it starts at zero, `leaving` is the sign with which it leaves, and the
    power of time with which it does; 0 if it stays.
    """

    parts: tuple[tuple[LocalPolynomial, Side], ...]
    found: tuple[Root, ...]
    after: Side
    until: float
    leaving: tuple[int, int]

    def behind_jump(self, least: float) -> StepZeros:
        """Return the same without jumps in the first part of the step, which are one that was met before."""
        return replace(self, found=tuple(root for root in self.found if not root.jump or root.time > least))


def trace(
    sample: Sample,
    place: int,
    noise: float,
    before: Side,
    *,
    level: float = 0.0,
    zero: bool = False,
    last: bool = False,
    isolate: Isolate | None = None,
) -> StepZeros:
    """Find where the event at a place among the events has the value `level`.

    `zero` says that it starts there, on a side that is to be found, `last` that no step follows. What isolates roots is
    `isolate`.
    """
    parts: list[tuple[LocalPolynomial, Side]] = []
    found: list[Root] = []
    leaving = (0, 0)
    for piece in local_polynomials(
        lambda s: sample.events(s)[place] - level, sample.values[place] - level, noise, smooth=zero
    ):
        if piece.coefficients is None:
            return StepZeros(tuple(parts), tuple(found), before, piece.start, leaving)
        if zero and piece.start == 0:
            piece = _divided(piece)
            leaving = _leaving(piece)
            if leaving[1] != 1:
                piece = _integrated(sample, place, piece)
                leaving = _leaving(piece)
            before = Side(leaving[0])
        if piece.coefficients is not None and len(piece.coefficients):
            parts.append((piece, before))
            final = last and piece.start + piece.width == 1.0
            zeros, before = roots(piece.coefficients, 1.0, before, noise=piece.noise, last=final, isolate=isolate)
            begins = zero and piece.start == 0
            for root in zeros:
                jump = piece.jump or (root.time == 0 and not begins and _starts_clear(piece))
                found.append(replace(root, time=piece.start + piece.width * root.time, jump=jump))
    return StepZeros(tuple(parts), _merged(found), before, math.inf, leaving)


def ended(found: StepZeros, s: float, isolate: Isolate | None = None, *, decided: bool) -> tuple[list[Root], Side]:
    """Return the zeros up to a place where the motion ends, and the side there.

    `decided` says that what has come to zero there is decided by its slope; else it is left open.
    """
    zeros: list[Root] = []
    side = found.parts[0][1] if found.parts else found.after
    for piece, before in found.parts:
        length = (s - piece.start) / piece.width
        if length > 0 and piece.coefficients is not None:
            cut, last = min(length, 1.0), decided and length <= 1
            here, side = roots(piece.coefficients, cut, before, noise=piece.noise, last=last, isolate=isolate)
            zeros += [replace(root, time=piece.start + piece.width * root.time) for root in here]
    return zeros, side


def _merged(found: list[Root]) -> tuple[Root, ...]:
    """Return roots with those of one jump as one: the path is rounded, and may pass a place some times to and fro."""
    kept: list[Root] = []
    for root in found:
        if kept and kept[-1].jump and root.jump and root.time - kept[-1].time <= SAME_JUMP:
            kept.pop()
        else:
            kept.append(root)
    return tuple(kept)


def _starts_clear(piece: LocalPolynomial) -> bool:
    """Whether an event that is on another side of zero before a part jumps there: it is far from zero on the part."""
    if piece.coefficients is None:
        return False
    sizes = np.abs(piece.coefficients)
    return bool(sizes[0] > JUMP * sizes.sum())


def _divided(piece: LocalPolynomial) -> LocalPolynomial:
    """Return what starts at zero divided by time: its zero there is known, and the next may be close.

    The slope of Chebyshev's polynomial of rank k at the end of [0, 1] is 2 k**2, which the noise is multiplied by.
    """
    if piece.coefficients is None:
        return piece
    rank = max(len(piece.coefficients) - 1, 1)
    return replace(piece, coefficients=piece.coefficients[1:], noise=2 * rank * rank * piece.noise)


def _integrated(sample: Sample, place: int, piece: LocalPolynomial) -> LocalPolynomial:
    """Return the same from the integral of the derivative, which a large constant in the event does not blur.

    The landing of a ball is seen in its velocity, whatever the height of the floor.
    """
    values = sample.rates(piece.width * nodes())[place] * piece.width
    if not np.isfinite(values).all():
        return piece
    chebyshev = to_chebyshev() @ values
    noise = RATE_NOISE * float(np.abs(values).max()) + DEGREE * float(np.abs(chebyshev[-2:]).max())
    slopes = powers(chebyshev, noise)
    return replace(piece, coefficients=slopes / np.arange(1, len(slopes) + 1), noise=noise)


def _leaving(piece: LocalPolynomial) -> tuple[int, int]:
    """Return the sign of what was divided by time right after the start, and the power of time that tells."""
    if piece.coefficients is None:
        return 0, 0
    beyond = np.flatnonzero(np.abs(piece.coefficients) > piece.noise)
    if not len(beyond):
        return 0, 0
    first = int(beyond[0])
    return int(np.sign(piece.coefficients[first])), 1 + first


def rests(batch: StepBatch, step: int, sample: Sample, place: int) -> bool:
    """Whether an event that started at zero stays there on a step, as a conserved quantity less its value does.

    Its derivative along the motion tells: the path itself strays from the motion by more than round-off, to and fro.
    """
    return bool((np.abs(sample.rates(nodes())[place]) <= batch.sensitive[place, step]).all())


def velocity(sample: Sample, place: int) -> float:
    """Return the derivative of an event where a step starts, 0 within its noise."""
    rates = sample.rates(nodes())[place]
    return 0.0 if abs(rates[0]) <= RATE_NOISE * np.abs(rates).max() else float(rates[0])
