"""The loop over Taylor steps in machine code.

    i32 drive(ptr p, ptr c, ptr reals, ptr counts, ptr work, i64 budget, ptr times, ptr states)

`reals` and `counts` are those of `DriverState`, `p` and `c` as for `jet`; `work` holds what `TaylorLayout` says. The
result is an `Outcome`. It does what `lagrange.machine.series.interpreted_driver` does, which is the place to read it.
"""

from __future__ import annotations

from lagrange.machine.llvm.counts_and_exits import bump, leave_if, leave_unscaled
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.series.constants import (
    BEYOND,
    FARTHEST,
    LONGER,
    NEAREST,
    OVERFLOWED,
    SHORTER,
    SHORTEST,
    TRIES,
)
from lagrange.machine.series.llvm_layout import TaylorLayout
from lagrange.machine.series.llvm_log2 import EXP2, logarithm, polynomial, power_of_two, rounded
from lagrange.machine.series.llvm_proof import Proof
from lagrange.machine.series.llvm_step_size import StepSize
from lagrange.machine.series.llvm_sum import derivatives, increments, looped
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.constants import EARLIEST, NEAR_END, SPACING


def drive_function(layout: TaylorLayout) -> str:
    """Return the IR of the loop."""
    return _Loop(layout).function()


class _Loop:
    def __init__(self, layout: TaylorLayout) -> None:
        self.layout = layout
        self.e = Emitter()
        self.size = StepSize(self.e, layout)
        self.proof = Proof(self.e, layout, self.size)
        self.kind, self.rows, self.order = self.size.kind, self.size.rows, self.size.order
        self.low = self.e.address("%work", layout.padded)

    def function(self) -> str:
        e, r = self.e, DriverState
        e.put("0", "%counts", r.ROWS, "i64")
        end = e.get("%reals", r.END)
        begun = e.get("%counts", r.STEPS, "i64")
        with e.when(e.value(f"icmp eq i64 {begun}, 0")):
            self.begin(end)
        # The last turn does no more than prove the last step.
        with e.loop(0, e.value("add nsw i64 %budget, 1")) as turn:
            self.turn(end, e.value(f"icmp eq i64 {turn}, %budget"))
        e.do(f"ret i32 {int(Outcome.PAUSED)}")
        return e.function(
            "define internal i32 @drive(ptr noalias readonly %p, ptr noalias readonly %c, ptr noalias %reals, "
            "ptr noalias %counts, ptr noalias %work, i64 %budget, ptr noalias %times, ptr noalias %states, "
            "i64 %order) #0"
        )

    def turn(self, end: str, last: str) -> None:
        """Look from where the run stands, prove the step that led there, and take the next one."""
        e, r, name = self.e, DriverState, self.e.fresh("turn")
        t, low, scale = (e.get("%reals", which) for which in (r.T, r.LOW, r.SCALE))
        there = e.real("fcmp oeq", t, end)
        waiting = self.proof.open()
        self.leave(waiting, there, last)
        status = e.value(f"call i32 @jet({self.arguments(t, scale)})")
        bump(e, r.EVALUATIONS, 1)
        singular = e.value(f"icmp ne i32 {status}, 0")
        weights = self.size.weights()
        e.do(f"br i1 {waiting}, label %{name}.prove, label %{name}.on")
        e.label(f"{name}.prove")
        proven = self.proof.holds(singular, weights)
        e.do(f"br i1 {proven}, label %{name}.proven, label %{name}.back")
        e.label(f"{name}.back")
        self.proof.take_back()
        failed = e.get("%counts", r.REJECTED, "i64")
        before = e.value(f"sub i64 {failed}, 1")
        doubled = e.value(f"icmp eq i64 {e.value(f'and i64 {failed}, {before}')}, 0")
        leave_unscaled(e, e.value(f"and i1 {doubled}, {e.value(f'icmp sgt i64 {failed}, 1')}"))
        e.jump(f"{name}.end")
        e.label(f"{name}.proven")
        self.proof.record(t)
        leave_if(e, there, Outcome.DONE)
        leave_if(e, last, Outcome.PAUSED)
        e.jump(f"{name}.on")
        e.label(f"{name}.on")
        leave_if(e, singular, Outcome.SINGULAR)
        weights = self.begin_floors(weights)
        exponent = self.size.exponent(weights)
        reach = self.reach(t, low, end, scale)
        e.do(f"br i1 {self.fits(exponent, reach)}, label %{name}.yes, label %{name}.no")
        e.label(f"{name}.no")
        self.rescale(exponent, reach, scale)
        e.jump(f"{name}.end")
        e.label(f"{name}.yes")
        self.step(t, low, end, scale, exponent, weights, f"{name}.end")
        e.jump(f"{name}.end")
        e.label(f"{name}.end")

    def begin_floors(self, weights: list[str]) -> list[str]:
        """Return the weights for a step; where a run begins, or tries a scale of time, floors begin, until surveyed."""
        e, r, kind = self.e, DriverState, self.kind
        cells = [e.reserve(kind) for _ in weights]
        for weight, cell in zip(weights, cells, strict=True):
            e.store(weight, cell, kind)
        steps, tries = (e.get("%counts", which, "i64") for which in (r.STEPS, r.TRIES))
        first, again = e.value(f"icmp eq i64 {steps}, 0"), e.value(f"icmp ne i64 {tries}, 0")
        begins = e.value(f"or i1 {first}, {again}")
        follows = e.real("fcmp ogt", e.get("%reals", r.SHARE), literal(0.0))
        fresh = e.value(f"icmp eq i64 {e.get('%counts', r.SURVEYED, 'i64')}, 0")
        with e.when(e.value(f"and i1 {begins}, {e.value(f'and i1 {follows}, {fresh}')}")):
            leave_unscaled(e, self.size.first_floors())
            for weight, cell in zip(self.size.weights(), cells, strict=True):
                e.store(weight, cell, kind)
        return [e.load(cell, kind) for cell in cells]

    def leave(self, waiting: str, there: str, last: str) -> None:
        """Come back where no step waits for its proof and none is to be taken."""
        e = self.e
        idle = e.value(f"xor i1 {waiting}, true")
        leave_if(e, e.value(f"and i1 {idle}, {there}"), Outcome.DONE)
        leave_if(e, e.value(f"and i1 {idle}, {last}"), Outcome.PAUSED)

    def arguments(self, t: str, scale: str) -> str:
        """Return the arguments of the jet at the state."""
        return f"double {t}, double {scale}, ptr %work, ptr %p, ptr %c, ptr {self.rows}, i64 {self.order}"

    def begin(self, end: str) -> None:
        """Nothing is lost yet, and the scale of time has the sign of the run's direction."""
        e, r = self.e, DriverState
        for place in range(0, self.layout.padded, self.layout.lanes):
            e.store("zeroinitializer", e.address(self.low, place), self.kind)
        e.put(literal(0.0), "%reals", r.LOW)
        backwards = e.real("fcmp olt", end, e.get("%reals", r.T))
        size = e.fabs(e.get("%reals", r.SCALE))
        e.put(e.choose(backwards, e.value(f"fneg double {size}"), size), "%reals", r.SCALE)

    def reach(self, t: str, low: str, end: str, scale: str) -> str:
        """Return the binary logarithm of what is left of the run, or of the longest step, in units of the scale."""
        e, r = self.e, DriverState
        left = e.fabs(e.real("fsub", e.real("fsub", end, t), low))
        longest = e.smaller(left, e.get("%reals", r.LONGEST))
        return logarithm(e, e.real("fdiv", longest, e.fabs(scale)))

    def fits(self, exponent: str, reach: str) -> str:
        """Whether the step is near the scale of time, so that no coefficient has left the range of doubles.

        A series without last coefficients fits when the scale is as long as any step may be; after some tries the
        scale is as good as it gets.
        """
        e = self.e
        steps, tries = (e.get("%counts", which, "i64") for which in (DriverState.STEPS, DriverState.TRIES))
        first = e.value(f"icmp eq i64 {e.value(f'or i64 {steps}, {tries}')}, 0")
        near = e.real("fcmp olt", e.fabs(exponent), e.choose(first, literal(NEAREST), literal(FARTHEST)))
        whole = e.value(f"and i1 {self.size.ends(exponent)}, {e.real('fcmp olt', reach, literal(1.0))}")
        tried = e.value(f"icmp sge i64 {tries}, {TRIES}")
        good = e.value(f"and i1 {tried}, {e.real('fcmp ord', exponent, exponent)}")
        return e.value(f"or i1 {e.value(f'or i1 {near}, {whole}')}, {good}")

    def rescale(self, exponent: str, reach: str, scale: str) -> None:
        """Try again with another scale of time: the step's own.

        It is a shorter one if a coefficient overflowed, and a longer one, as far as a step may reach, if the last
        coefficients are zero.
        """
        e, r = self.e, DriverState
        tries = e.get("%counts", r.TRIES, "i64")
        often = e.value(f"icmp sge i64 {tries}, {TRIES}")
        short = e.real("fcmp olt", e.fabs(scale), literal(SHORTEST))
        leave_if(e, e.value(f"or i1 {often}, {short}"), Outcome.NON_FINITE)
        bump(e, r.TRIES, 1)
        infinite = e.real("fcmp olt", exponent, literal(OVERFLOWED))
        overflow = e.value(f"or i1 {e.real('fcmp uno', exponent, exponent)}, {infinite}")
        longer = e.choose(self.size.ends(exponent), e.smaller(reach, literal(LONGER)), exponent)
        whole = rounded(e, e.choose(overflow, literal(SHORTER), longer))
        e.put(e.real("fmul", scale, power_of_two(e, whole)), "%reals", r.SCALE)

    def step(self, t: str, low: str, end: str, scale: str, exponent: str, weights: list[str], elsewhere: str) -> None:
        """Choose the step, look out for what is watched, and take it; go elsewhere if it is none.

        All is in units of the scale, and what does not depend on the coefficients comes first: the processor has it
        done when the last coefficient arrives.
        """
        e, r = self.e, DriverState
        inverse = e.real("fdiv", literal(1.0), e.fabs(scale))
        left = e.real("fsub", e.real("fsub", end, t), low)
        whole_way = e.real("fmul", e.fabs(left), inverse)
        own = e.smaller(e.get("%reals", r.LONGEST), e.get("%reals", r.LIMIT))
        limit = e.smaller(own, e.get("%reals", r.ONCE))
        bound = e.smaller(e.real("fmul", limit, inverse), whole_way)
        spacing = e.real("fmul", e.larger(e.fabs(t), literal(EARLIEST)), literal(SPACING))
        whole = rounded(e, exponent)
        fraction = polynomial(e, e.real("fsub", exponent, whole), EXP2)
        # A series that terminates may ask for a step beyond all doubles.
        whole = e.smaller(whole, literal(BEYOND))
        natural = e.real("fmul", fraction, power_of_two(e, whole))
        bounded = e.real("fcmp oge", e.real("fmul", natural, literal(NEAR_END)), bound)
        s = e.choose(bounded, bound, natural)
        final = e.value(f"and i1 {bounded}, {e.real('fcmp oeq', bound, whole_way)}")
        wanted = e.smaller(natural, e.real("fmul", own, inverse))
        short = e.real("fcmp olt", wanted, e.real("fmul", spacing, inverse))
        leave_if(e, e.value(f"and i1 {short}, {e.value(f'xor i1 {final}, true')}"), Outcome.STEP_TOO_SMALL)
        h = e.choose(final, left, e.real("fmul", s, scale))
        e.put(h, "%reals", r.H)
        self.proof.probe(t, scale, s, h, weights, self.size.ends(exponent), elsewhere)
        if self.layout.watched:
            self.look_out(s)
        self.size.raise_floors()
        # A series that terminates says nothing about the next one.
        ends = e.real("fcmp ogt", whole, literal(FARTHEST))
        longer = power_of_two(e, e.choose(ends, literal(0.0), whole))
        good = self.advance(s, longer)
        leave_if(e, e.value(f"xor i1 {good}, true"), Outcome.NON_FINITE)
        self.proof.hold(t, low, scale, h)
        self.accept(t, low, h, end, final)
        e.put("0", "%counts", r.TRIES, "i64")
        e.put(literal(float("inf")), "%reals", r.ONCE)
        e.put(e.real("fmul", scale, longer), "%reals", r.SCALE)

    def look_out(self, s: str) -> None:
        """Come back before a step on which something that is watched may vanish, unless told to take it once."""
        e, layout = self.e, self.layout
        asked = e.real("fcmp oeq", e.get("%reals", DriverState.ONCE), literal(float("inf")))
        unsafe = e.value(f"icmp ne i64 {e.get('%counts', DriverState.LOOK, 'i64')}, 0")
        for i in range(layout.watched):
            first = e.address(self.rows, layout.watched_at + i)
            with e.carry(0, self.order, [("double", literal(0.0))]) as loop:
                k = e.value(f"sub nsw i64 {self.order}, {loop.index}")
                size = e.fabs(e.get(first, e.value(f"mul nsw i64 {k}, {layout.width}")))
                loop.following = [e.real("fmul", e.real("fadd", loop.values[0], size), s)]
            near = e.real("fcmp ule", e.fabs(e.load(first)), loop.values[0])
            unsafe = e.value(f"or i1 {unsafe}, {near}")
        leave_if(e, e.value(f"and i1 {asked}, {unsafe}"), Outcome.WATCHED)

    def advance(self, s: str, longer: str) -> str:
        """Add the series to the state, compensated; return whether it stayed finite, else the state stays.

        The state before is held, and the derivative at the end, in units of the next scale.
        """
        e, kind, layout = self.e, self.kind, self.layout
        fresh: list[tuple[int, str, str, str, str]] = []
        if layout.order:
            moves = increments(e, self.size, s)
            slopes = derivatives(e, self.size, s)
        else:
            moves, slopes = looped(e, self.size, s)
        factor = e.splat(longer, kind)
        for place, slope in slopes:
            e.store(e.value(f"fmul {kind} {slope}, {factor}"), self.proof.slope(place), kind)
        for place, increment in moves:
            low = e.load(e.address(self.low, place), kind)
            y = e.load(e.address("%work", place), kind)
            added = e.value(f"fadd {kind} {increment}, {low}")
            total = e.value(f"fadd {kind} {y}, {added}")
            back = e.value(f"fsub {kind} {total}, {y}")
            first = e.value(f"fsub {kind} {y}, {e.value(f'fsub {kind} {total}, {back}')}")
            second = e.value(f"fsub {kind} {added}, {back}")
            fresh.append((place, y, low, total, e.value(f"fadd {kind} {first}, {second}")))
        largest = self.size.largest_entry([e.fabs(total, kind) for _, _, _, total, _ in fresh])
        good = e.real("fcmp olt", largest, literal(float("inf")))
        with e.when(good):
            for place, y, low, total, lost in fresh:
                e.store(y, self.proof.before(place), kind)
                e.store(low, self.proof.lost_before(place), kind)
                e.store(total, e.address("%work", place), kind)
                e.store(lost, e.address(self.low, place), kind)
        return good

    def accept(self, t: str, low: str, h: str, end: str, final: str) -> None:
        """Move on in time, compensated."""
        e, r = self.e, DriverState
        added = e.real("fadd", h, low)
        total = e.real("fadd", t, added)
        back = e.real("fsub", total, t)
        lost = e.real("fadd", e.real("fsub", t, e.real("fsub", total, back)), e.real("fsub", added, back))
        e.put(e.choose(final, end, total), "%reals", r.T)
        e.put(e.choose(final, literal(0.0), lost), "%reals", r.LOW)
