"""Series of functions with powers above the order: verify how far they agree with the functions."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.constants import EVENT_SLACK
from lagrange.procedure.taylor.event_series import event_noise
from lagrange.procedure.taylor.memory import BLOCK, SIZES, RecordedLayout, SeriesMemory, work_array
from lagrange.procedure.taylor.sums import state_on_step
from lagrange.procedure.taylor.watching import FUNCTION
from lagrange.procedure.values import Flag, Memory, Real

MOST_HALVINGS = 60
"""Largest number of halvings of a step until the series agree."""


@shared
def verified_step() -> Procedure:
    """Return the procedure that shortens a step until the series of all watched functions agree with them at its end.

    At x = 0 the series of x**40 is zero up to order 39, and does not show that the function rises.
    """
    return _Verification().build()


class _Verification:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("verified_step", "Return a step at whose end all series agree.", apart=True)
        self.function = p.function("function", FUNCTION)
        self.numbers, self.tilts = p.array("numbers", read=True), p.array("tilts", read=True)
        self.t, self.scale, self.rtol, self.s = (p.given(name, REAL) for name in ("t", "scale", "rtol", "s"))
        self.noise, self.there = p.array("noise", read=True), p.array("there", room=BLOCK)
        self.blur, self.state, self.moved = (p.array(name, room=BLOCK) for name in ("blur", "state", "moved"))
        self.sizes: Any = p.record("sizes", SIZES)
        self.layout: Any = RecordedLayout(self.sizes)
        self.memory = SeriesMemory(p, self.layout, work_array(p))
        self.layout.read()

    def build(self) -> Procedure:
        p, layout, again = self.p, self.layout, self.p.variable(self.p.true, "again")
        s, halvings = p.variable(self.s, "length"), p.variable(0, "halvings")
        with p.repeat(lambda: again.value & (halvings.value < MOST_HALVINGS)):
            end = self.t + s.value * self.scale
            p.call(state_on_step(), s.value, self.state, self.sizes, *self.memory.handed)
            p.leave_if(self.function(end, self.state, self.numbers, self.there), s.value)
            again.value = self.disagrees(s.value, None)
            with p.when(again.value):
                # Rounding of the state at the end may explain the difference.
                sizes = layout.dimension, layout.watched
                function = self.function, self.numbers, self.tilts
                p.call(event_noise(), *function, end, *sizes, self.state, self.there, self.blur, self.moved)
                again.value = self.disagrees(s.value, self.blur)
            s.value = p.choose(again.value, s.value * 0.5, s.value)
            halvings.value = halvings.value + 1
        p.leave(s.value)
        return p.finish(REAL)

    def disagrees(self, s: Real, blur: Memory | None) -> Flag:
        """Return whether the sum of some series differs from its function at the end of a step."""
        p, width, wrong = self.p, self.layout.width, self.p.variable(self.p.false, "wrong")
        tolerance = p.larger(self.rtol, 2.0**-52)
        first = self.memory.row(0).at(self.layout.watched_at)
        with p.loop(0, self.layout.watched) as i:
            series, total, most = first.at(i), p.variable(0.0, "total"), p.variable(0.0, "most")
            power = p.variable(1.0, "power")
            with p.loop(0, self.memory.order + 1) as k:
                term = series[k * width] * power.value
                total.value, most.value = total.value + term, p.magnitude(most.value, term)
                power.value = power.value * s
            noise = self.noise[i] if blur is None else self.noise[i] + blur[i]
            allowed = EVENT_SLACK * p.fma(tolerance, most.value, noise)
            wrong.value = wrong.value | ~(abs(total.value - self.there[i]) <= allowed)
        found: Flag = wrong.value
        return found
