"""The path of a Taylor step: the series itself, computed again from where the step begins."""

from __future__ import annotations

from lagrange.algorithm.dense.block import OwnStep
from lagrange.algorithm.taylor.memory import JET
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Real

HALF = 2**0.5
"""The scale of time is the power of two that is nearest to the step: the larger one from this mantissa on."""


@shared
def series_polynomial() -> Procedure:
    """Return the procedure that writes the series of steps in the fraction of the step, NaN if a matrix is singular.

    A state takes `padded` doubles, and rows are `width` doubles apart. The work memory has the state, its rounding
    error (zero), and then the rows.
    """
    p = Builder("series_polynomial", "Write the polynomials of a block of steps by their Taylor series.")
    jet, prepared, constants = p.function("jet", JET), p.array("prepared", read=True), p.array("constants", read=True)
    order, width, padded = (p.given(name, WHOLE) for name in ("order", "width", "padded"))
    dimension, columns = p.given("dimension", WHOLE), p.given("columns", WHOLE)
    own, _ = p.array("own", read=True), p.array("beside", read=True)
    work, out = p.array("work"), p.array("out")
    step, rows = OwnStep(own, dimension, columns), work.at(padded * 2)
    total = dimension * columns
    with p.loop(0, padded * 2) as i:
        work[i] = 0.0
    with p.loop(0, columns) as b:
        h = step.h[b]
        scale = p.call(nearest_scale(), h).called("scale")
        with p.loop(0, dimension) as j:
            work[j] = step.y[j * columns + b]
        singular = jet(step.t[b], scale, work, prepared, constants, rows, order)
        ratio = (h / scale).called("ratio")
        power = p.variable(p.choose(singular, float("nan"), p.real(1.0)), "power")
        with p.loop(0, order + 1) as k:
            with p.loop(0, dimension) as j:
                out[k * total + j * columns + b] = rows[k * width + j] * power.value
            power.value = power.value * ratio
    return p.finish()


@shared
def nearest_scale() -> Procedure:
    """Return the procedure that returns the power of two nearest to the length of a step, 1 for length zero."""
    p = Builder("nearest_scale", "Return the power of two nearest to the size of a number.")
    h: Real = p.given("h", REAL)
    exponent = p.operation("exponent", h)
    larger = p.operation("two_to", p.choose(p.operation("mantissa", h) > HALF, exponent + 1, exponent))
    p.leave(p.choose(h.equals(0.0), 1.0, larger))
    return p.finish(REAL)
