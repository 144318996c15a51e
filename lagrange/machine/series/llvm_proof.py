"""What a Taylor step is held to, in machine code: at its end the equations must say what its series says.

A step is recorded when the series of the next one has proven it. Otherwise the run goes back to where it began, and
tries a shorter one.
"""

from __future__ import annotations

from lagrange.machine.llvm.counts_and_exits import bump
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.series.constants import DEFECT, FAILURES, GROWN, NOISE, PROBES, RETREAT
from lagrange.machine.series.llvm_layout import TaylorLayout
from lagrange.machine.series.llvm_step_size import StepSize
from lagrange.machine.series.llvm_sum import looped
from lagrange.machine.state import DriverState


class Proof:
    """Emits the proof of steps; what is held of a step stands on the stack and behind the state in `work`."""

    def __init__(self, e: Emitter, layout: TaylorLayout, size: StepSize) -> None:
        self.e, self.layout, self.size = e, layout, size
        self.kind = size.kind
        self.waiting = e.reserve("i1")
        e.store("false", self.waiting, "i1")
        self.t, self.low, self.scale, self.h = (e.reserve("double") for _ in range(4))
        e.store(literal(0.0), self.h)
        self.held = e.address("%work", layout.held)
        self.tolerances = self.share()

    def share(self) -> str:
        """Return the tolerances that a derivative may be off, times the length of the step."""
        if self.layout.order:
            return literal(DEFECT * self.layout.order)
        order = self.e.value("sitofp i64 %order to double")
        return self.e.real("fmul", literal(DEFECT), order)

    def open(self) -> str:
        """Whether a step waits for its proof."""
        return self.e.load(self.waiting, "i1")

    def before(self, place: int) -> str:
        """Return the address of the state before the step."""
        return self.e.address(self.held, place)

    def lost_before(self, place: int) -> str:
        """Return the address of what rounding had lost of it."""
        return self.e.address(self.held, self.layout.padded + place)

    def slope(self, place: int) -> str:
        """Return the address of the derivative at the end of the step."""
        return self.e.address(self.held, 2 * self.layout.padded + place)

    def hold(self, t: str, low: str, scale: str, h: str) -> None:
        """Keep where a step began; it waits for its proof."""
        for value, memory in ((t, self.t), (low, self.low), (scale, self.scale), (h, self.h)):
            self.e.store(value, memory)
        self.e.store("true", self.waiting, "i1")

    def holds(self, singular: str, weights: list[str]) -> str:
        """Whether the step is proven, or cannot be by a shorter one."""
        e = self.e
        length = e.real("fdiv", e.fabs(e.load(self.h)), e.fabs(e.get("%reals", DriverState.SCALE)))
        good = self.agrees(self.size.rows, weights, length)
        sound = e.value(f"and i1 {good}, {e.value(f'xor i1 {singular}, true')}")
        return e.value(f"or i1 {sound}, {self.hopeless()}")

    def hopeless(self) -> str:
        """Whether so many steps have failed that a shorter one is lost in round-off."""
        return self.e.value(f"icmp sge i64 {self.e.get('%counts', DriverState.FAILS, 'i64')}, {FAILURES}")

    def agrees(self, rows: str, weights: list[str], length: str) -> str:
        """Whether the first coefficients of some rows are the derivative that is held, for a step of that length."""
        e, kind, lanes = self.e, self.kind, self.layout.lanes
        first = e.address(rows, self.layout.width)
        off, most = [], []
        for place in self.size.with_velocities():
            weight = weights[place // lanes]
            there = self.size.entries(first, place)
            apart = e.fabs(e.value(f"fsub {kind} {there}, {e.load(self.slope(place), kind)}"), kind)
            off.append(e.value(f"fmul {kind} {apart}, {weight}"))
            most.append(e.value(f"fmul {kind} {e.fabs(there, kind)}, {weight}"))
        allowed = e.real("fdiv", self.tolerances, length)
        allowed = e.fma(literal(NOISE), self.size.largest_entry(most), allowed)
        return e.real("fcmp ole", self.size.largest_entry(off), allowed)

    def take_back(self) -> None:
        """Go back to where the step began."""
        e, r = self.e, DriverState
        for place in range(0, self.layout.padded, self.layout.lanes):
            e.store(e.load(self.before(place), self.kind), e.address("%work", place), self.kind)
            low = e.load(self.lost_before(place), self.kind)
            e.store(low, e.address("%work", self.layout.padded + place), self.kind)
        for memory, which in ((self.t, r.T), (self.low, r.LOW), (self.scale, r.SCALE)):
            e.put(e.load(memory), "%reals", which)
        e.store("false", self.waiting, "i1")
        self.fail(e.load(self.h))

    def fail(self, h: str) -> None:
        """Try again with a shorter step, and let who watches look again."""
        e, r = self.e, DriverState
        e.put(e.real("fmul", literal(RETREAT), e.fabs(h)), "%reals", r.LIMIT)
        e.put(literal(float("inf")), "%reals", r.ONCE)
        bump(e, r.FAILS, 1)
        bump(e, r.REJECTED, 1)
        e.put("1", "%counts", r.LOOK, "i64")
        e.put("0", "%counts", r.TRIES, "i64")

    def record(self, t: str) -> None:
        """Count the step that is proven and record it; one behind failures may be twice as long as that before."""
        e, r = self.e, DriverState
        some = e.value(f"icmp ne i64 {e.get('%counts', r.FAILS, 'i64')}, 0")
        failed = e.value(f"and i1 {some}, {e.value(f'xor i1 {self.hopeless()}, true')}")
        limit = e.choose(failed, e.fabs(e.load(self.h)), e.get("%reals", r.LIMIT))
        e.put(e.real("fadd", limit, limit), "%reals", r.LIMIT)
        e.put("0", "%counts", r.FAILS, "i64")
        e.store("false", self.waiting, "i1")
        bump(e, r.STEPS, 1)
        with e.when(e.value(f"icmp ne i64 {e.get('%counts', r.RECORD, 'i64')}, 0")):
            row = e.get("%counts", r.ROWS, "i64")
            e.put(t, "%times", row)
            target = e.address("%states", e.value(f"mul nsw i64 {row}, {self.layout.dimension}"))
            size = 8 * self.layout.dimension
            e.do(f"call void @llvm.memcpy.p0.p0.i64(ptr {target}, ptr %work, i64 {size}, i1 false)")
            bump(e, r.ROWS, 1)

    def probe(self, t: str, scale: str, s: str, h: str, weights: list[str], wanted: str, elsewhere: str) -> None:
        """Compare a series with the equations all along a step where that is wanted; go elsewhere if they differ."""
        e = self.e
        bad = e.reserve("i1")
        e.store("false", bad, "i1")
        longer = e.real("fcmp ogt", e.fabs(h), e.real("fmul", literal(GROWN), e.fabs(e.load(self.h))))
        wanted = e.value(
            f"and i1 {e.value(f'and i1 {wanted}, {longer}')}, {e.value(f'xor i1 {self.hopeless()}, true')}"
        )
        with e.when(wanted), e.loop(1, PROBES) as j:
            part = e.real("fmul", e.value(f"sitofp i64 {j} to double"), literal(1.0 / PROBES))
            differs = e.value(f"xor i1 {self.probed(t, scale, e.real('fmul', s, part), s, weights)}, true")
            e.store(e.value(f"or i1 {e.load(bad, 'i1')}, {differs}"), bad, "i1")
        name = e.fresh("probed")
        e.do(f"br i1 {e.load(bad, 'i1')}, label %{name}.bad, label %{name}.good")
        e.label(f"{name}.bad")
        self.fail(h)
        e.jump(elsewhere)
        e.label(f"{name}.good")

    def probed(self, t: str, scale: str, s: str, whole: str, weights: list[str]) -> str:
        """Whether the equations say what the series says at one place on a step."""
        e, kind = self.e, self.kind
        order = self.size.order
        behind = e.value(f"mul nsw i64 {e.value(f'add nsw i64 {order}, 1')}, {self.layout.width}")
        place_of = e.address(e.address(self.size.rows, behind), self.layout.scratch)
        rows = e.address(place_of, self.layout.rows)
        sums, slopes = looped(e, self.size, s)
        for place, total in sums:
            y = e.load(e.address("%work", place), kind)
            e.store(e.value(f"fadd {kind} {y}, {total}"), e.address(place_of, place), kind)
        for place, slope in slopes:
            e.store(slope, self.slope(place), kind)
        there = e.fma(s, scale, t)
        status = e.value(
            f"call i32 @jet(double {there}, double {scale}, ptr {place_of}, ptr %p, ptr %c, ptr {rows}, i64 {order})"
        )
        good = self.agrees(rows, weights, whole)
        return e.value(f"and i1 {good}, {e.value(f'icmp eq i32 {status}, 0')}")
