"""Zeros of an event function that is a polynomial on each step: each root once, in order, with its direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.machine.printed_run import called
from lagrange.procedure.events.constants import MOST_COEFFICIENTS, MOST_ROOTS, UNFIT
from lagrange.procedure.events.roots import roots as procedure
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True)
class Root:
    """A time at which the event function crosses zero, or touches it.

    `time` is counted from the start of the step, in the units of h and between 0 and h. `rising` is 1 where the
    function goes from negative to positive in the direction of the integration, -1 where it falls, and 0 where it
    touches zero and turns back. At a `jump` its sign changes without a zero.
    """

    time: float
    rising: int
    jump: bool = False


@dataclass(frozen=True)
class Side:
    """The side of zero of an event function between two steps, the only information that a step passes to the next.

    `sign` is the last sign, 1 or -1, beyond noise. It is 0 at the start of a run and of a new motion after an impact.
    `near` says that the function has come to zero within its noise since then, so that the next step has to decide
    whether it crosses or turns back.
    """

    sign: int = 0
    near: bool = False

    @property
    def settled(self) -> bool:
        """True if the side is known: a step on which the function cannot vanish does not change it."""
        return self.sign != 0 and not self.near


def may_vanish(coefficients: FloatArray, h: float, *, noise: float = 0.0) -> bool:
    """Return False if sum c[k] tau**k is certain to keep the sign of c[0] from tau = 0 to h; takes 1 or 2 microseconds.

    The arguments are those of `roots`, which need not be called for such a step if the side before it is settled: the
    step has no root then, and the side stays. Coefficients that are not finite may vanish.
    """
    first, *rest = coefficients.tolist()
    length = abs(h)
    others = 0.0
    for c in reversed(rest):
        others = (others + abs(c)) * length
    # The margins cover rounding and underflow of this sum, and the least noise of `roots`.
    return not math.inf > abs(first) > 1.001 * (others + noise) + 1e-300


Isolate = Callable[..., Any]
"""Compiled procedure of root isolation: `machine.called(procedure())`."""


def printed() -> Isolate:
    """Return the procedure of root isolation in Python."""
    return called(procedure())


def roots(
    coefficients: FloatArray,
    h: float,
    before: Side | None = None,
    *,
    noise: float = 0.0,
    last: bool = False,
    isolate: Isolate | None = None,
) -> tuple[list[Root], Side]:
    """Return the roots of g(tau) = sum c[k] tau**k on a step, as the integration meets them, and the side at its end.

    `coefficients` (m,) start with the constant, at most 65. `h` is the length of the step, negative for a run
    backwards. `before` is the side that the step before returned; without it g starts here, and a root at the start is
    not an event. `noise`, in the units of g, is the error of g in addition to the rounding of the coefficients, which
    is taken to be 8 * 2**-52 sum |c[k] h**k|. `last` says that no step follows.

    The procedure `isolate`, by default in Python, documents the algorithm. Raises ValueError for coefficients, noise
    or a length that are not finite, for no coefficients and for too many.
    """
    polynomial = np.array(coefficients, dtype=float)
    before = Side() if before is None else before
    times, rising = np.empty(MOST_ROOTS), np.empty(MOST_ROOTS, dtype=np.int64)
    side = before.sign, before.near, last
    run = printed() if isolate is None else isolate
    found, sign, near = UNFIT, 0, False
    if 0 < len(polynomial) <= MOST_COEFFICIENTS:
        found, sign, near = run(polynomial, len(polynomial), float(h), float(noise), *side, times, rising, MOST_ROOTS)
    if found < 0:
        raise ValueError(
            f"the event function has no coefficients or more than {MOST_COEFFICIENTS}, or they, its noise or the "
            "length of the step are not finite"
        )
    zeros = zip(times[:found].tolist(), rising[:found].tolist(), strict=True)
    return [Root(time, way) for time, way in zeros], Side(sign, near)
