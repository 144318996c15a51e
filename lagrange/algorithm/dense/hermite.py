"""The path of any method: the cubic through both ends of a step with the slopes there, raised by Picard's way.

The integral of the right-hand side along a path of order p is one of order p + 1, and what it misses of the end, the
error of the step and more, is spread over the step by a cubic that is flat at both ends: so the path goes through both
ends with their slopes, and needs nothing but the right-hand side. Where the steps are so long that this does not
converge, as those of an implicit method may be, the path of a step stays the best so far, the cubic if need be.
Source: W. H. Enright, K. R. Jackson, S. P. Norsett, P. G. Thomsen, Interpolants for Runge-Kutta formulas, ACM Trans.
Math. Softw. 12, 1986, with the nodes of Chebyshev in place of theirs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import Block, StepPolynomial, Written, mend
from lagrange.procedure.builder import Builder
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Real, Whole

FloatArray = NDArray[np.float64]


@shared
def hermite_polynomial(order: int) -> StepPolynomial:
    """Return Hermite's cubic, of order 3, raised to any `order`; the degree is one more then.

    The table has the inner nodes, the matrix from changes of slopes there to changes of states, and by powers of theta
    what a change of each slope adds to the path.
    """
    if order == 3:
        return StepPolynomial(hermite, 3, 0, np.zeros(1), vectors=0)
    inner = slice(1, -1)
    parts = nodes(order)[inner], integrals(order)[inner, inner].ravel(), weights(order)[inner].T.ravel()
    return StepPolynomial(hermite, order + 1, order - 2, np.concatenate(parts), vectors=2 * (order - 2))


@shared
def hermite() -> Written:
    """Return the procedure."""
    return _Hermite().build()


class _Hermite:
    """Builds the procedure.

    `changes` are by how much the slopes at the inner nodes differ from those of the cubic, `trial` what the next
    iteration makes of them. Slopes are by theta, the fraction of the step.
    """

    def __init__(self) -> None:
        self.p = p = Builder("hermite_polynomial", "Write the polynomials of a block of steps by Picard's iteration.")
        self.block = block = Block(p)
        self.own, self.h = block.own, block.vector()
        self.first, self.last, self.state, self.found = (block.vector() for _ in range(4))
        self.time, self.moved, self.size, self.better = (block.row() for _ in range(4))
        self.changes = block.others()
        self.trial = block.nth(self.changes, block.stages)
        self.to_states = block.table.at(block.stages)
        self.shares = self.to_states.at(block.stages * block.stages)

    def build(self) -> Written:
        p, block, own = self.p, self.block, self.own
        block.spread(own.h, self.h)
        block.slopes(own.t, own.y, self.first)
        with block.each_column() as b:
            self.time[b] = own.t[b] + own.h[b]
        block.slopes(self.time, own.new, self.last)
        with block.entries() as x:
            self.first[x] = self.h[x] * self.first[x]
            self.last[x] = self.h[x] * self.last[x]
        with p.when(block.stages > 0):
            self.begin()
            with p.loop(1, block.stages):
                self.iteration()
        self.write()
        mend(block, self.first)
        return block.finish()

    def cubic(self, s: Real, x: Whole) -> Real:
        """Return an entry of the cubic at a fraction."""
        gap, first, last = self.ends(x)
        bend = gap * (1.0 - s * 2.0) + (first * (s - 1.0) + last * s)
        found: Real = self.own.y[x] + (gap * s + bend * (s * (s - 1.0)))
        return found

    def slope(self, s: Real, x: Whole) -> Real:
        """Return an entry of the derivative of the cubic by theta."""
        gap, first, last = self.ends(x)
        ends = first * ((1.0 - s) * (1.0 - s * 3.0)) + last * (s * (s * 3.0 - 2.0))
        found: Real = gap * (s * 6.0 * (1.0 - s)) + ends
        return found

    def ends(self, x: Whole) -> tuple[Real, Real, Real]:
        """Return an entry of what the state gains, and of the slopes at both ends."""
        return self.own.new[x] - self.own.y[x], self.first[x], self.last[x]

    def begin(self) -> None:
        """Begin with the cubic: a trial counts where it moves less than the largest slope."""
        p, block = self.p, self.block
        with block.entries() as x:
            self.found[x] = p.magnitude(self.first[x], self.last[x])
        with p.loop(0, block.stages) as i:
            s, change = block.table[i], block.nth(self.changes, i)
            with block.entries() as x:
                self.found[x] = p.magnitude(self.found[x], self.slope(s, x))
                change[x] = 0.0
        self.measure()
        with block.each_column() as b:
            self.moved[b] = self.size[b] * 2.0

    def measure(self) -> None:
        """Set the size of each column to its largest entry of `found`."""
        p, block = self.p, self.block
        with block.each_column() as b:
            self.size[b] = 0.0
        with p.loop(0, block.dimension) as j:
            line = self.found.at(j * block.columns)
            with block.each_column() as b:
                self.size[b] = p.magnitude(self.size[b], line[b])

    def iteration(self) -> None:
        """Integrate the right-hand side along the path, and keep that where it converges."""
        p, block, own = self.p, self.block, self.own
        with p.loop(0, block.stages) as i:
            s, row, trial = block.table[i], self.to_states.at(i * block.stages), block.nth(self.trial, i)
            with block.each_column() as b:
                self.time[b] = p.fma(own.h[b], s, own.t[b])
            with block.entries() as x:
                shift = p.variable(0.0)
                with p.loop(0, block.stages) as j:
                    shift.value = p.fma(block.nth(self.changes, j)[x], row[j], shift.value)
                self.state[x] = self.cubic(s, x) + shift.value
            block.slopes(self.time, self.state, trial)
            with block.entries() as x:
                trial[x] = self.h[x] * trial[x] - self.slope(s, x)
        self.judge()

    def judge(self) -> None:
        """Keep the trial in the columns in which it moved less than half as far as the one before."""
        p, block = self.p, self.block
        with block.entries() as x:
            self.found[x] = 0.0
        with p.loop(0, block.stages) as i:
            trial, change = block.nth(self.trial, i), block.nth(self.changes, i)
            with block.entries() as x:
                self.found[x] = p.magnitude(self.found[x], trial[x] - change[x])
        self.measure()
        with block.each_column() as b:
            good = self.size[b] < self.moved[b] * 0.5
            self.moved[b] = p.choose(good, self.size[b], 0.0)
            self.better[b] = p.choose(good, 1.0, p.real(0.0))
        block.spread(self.better, self.found)
        with p.loop(0, block.stages) as i:
            trial, change = block.nth(self.trial, i), block.nth(self.changes, i)
            with block.entries() as x:
                change[x] = p.choose(self.found[x] > 0.5, trial[x], change[x])

    def write(self) -> None:
        """Write the coefficients: those of the cubic, and what the changes of its slopes add to each."""
        p, block = self.p, self.block
        with p.loop(4, block.degree + 1) as power, block.entries() as x:
            block.coefficients(power)[x] = 0.0
        with block.entries() as x:
            gap, first, last = self.ends(x)
            cubic = self.own.y[x], first, gap * 3.0 - first * 2.0 - last, first + last - gap * 2.0
            for k, one in enumerate(cubic):
                block.coefficients(k)[x] = one
        with p.when(block.stages > 0), p.loop(0, block.degree + 1) as power:
            line, out = self.shares.at(power * block.stages), block.coefficients(power)
            with block.entries() as x:
                total = p.variable(out[x])
                with p.loop(0, block.stages) as j:
                    total.value = p.fma(block.nth(self.changes, j)[x], line[j], total.value)
                out[x] = total.value


@shared
def nodes(count: int) -> FloatArray:
    """Return the extrema of Chebyshev's polynomial on [0, 1], both ends among them."""
    return np.asarray(np.sin(np.pi * np.arange(count) / (2 * (count - 1))) ** 2)


@shared
def weights(count: int) -> FloatArray:
    """Return powers of theta (count, count + 2): the integral of a node's share of a change of slopes.

    The value of the integral at the end is subtracted along a cubic, so that each share is zero there.
    """
    found = nodes(count)
    shares = np.zeros((count, count + 2))
    for i, node in enumerate(found):
        others = np.delete(found, i)
        slope = np.poly1d(others, r=True) / np.prod(node - others)
        integral = slope.integ()
        share = integral - integral(1.0) * np.poly1d([-2.0, 3.0, 0.0, 0.0])
        shares[i, : len(share.coeffs)] = share.coeffs[::-1]
    return shares


@shared
def integrals(count: int) -> FloatArray:
    """Return the matrix from changes of slopes at the nodes to changes of states there."""
    powers = nodes(count)[:, None] ** np.arange(count + 2)
    return np.asarray(powers @ weights(count).T)
