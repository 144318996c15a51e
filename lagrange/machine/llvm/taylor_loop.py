"""The loop over Taylor steps in machine code.

    i32 drive(ptr p, ptr c, ptr reals, ptr counts, ptr work, i64 budget, ptr times, ptr states)

`reals` and `counts` are those of `DriverState`, `p` and `c` as for `jet`; `work` holds what `TaylorLayout` says. The
result is an `Outcome`. It does what `lagrange.machine.numpy_taylor` does, which is the place to read it.
"""

from __future__ import annotations

from lagrange.machine.driver import DriverState, Outcome
from lagrange.machine.llvm.calls import bump, leave_if
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.powers import EXP2, logarithm, polynomial, power_of_two, rounded
from lagrange.machine.llvm.spelling import element, number
from lagrange.machine.llvm.taylor_layout import TaylorLayout
from lagrange.machine.taylor import (
    BEYOND,
    EARLIEST,
    FARTHEST,
    GUARD,
    LONGER,
    NEAR_END,
    NEAREST,
    OVERFLOWED,
    ROWS_SEEN,
    SHORTER,
    SHORTEST,
    SPACING,
    TRIES,
    VANISHED,
)

TILE = 16
"""How many vectors of the state are summed in one loop."""


def drive_function(layout: TaylorLayout) -> str:
    """Return the IR of the loop."""
    return _Loop(layout).function()


class _Loop:
    def __init__(self, layout: TaylorLayout) -> None:
        self.layout = layout
        self.e = Emitter()
        self.kind = element(layout.lanes)
        self.low = self.e.address("%work", layout.padded)
        self.rows = self.e.address("%work", layout.rows)
        self.order = str(layout.order) if layout.order else "%order"
        self.reciprocals = [self.minus_one_over(less) for less in (1, 0)]
        # Minus the binary logarithm of the relative tolerance.
        self.digits = self.e.value(f"fneg double {logarithm(self.e, self.e.get('%reals', DriverState.RTOL))}")

    def function(self) -> str:
        e, r = self.e, DriverState
        e.put("0", "%counts", r.ROWS, "i64")
        end = e.get("%reals", r.END)
        begun = e.get("%counts", r.STEPS, "i64")
        with e.when(e.value(f"icmp eq i64 {begun}, 0")):
            self.begin(end)
        with e.loop(0, "%budget"):
            t, low = e.get("%reals", r.T), e.get("%reals", r.LOW)
            leave_if(e, e.real("fcmp oeq", t, end), Outcome.DONE)
            scale = e.get("%reals", r.SCALE)
            arguments = f"double {t}, double {scale}, ptr %work, ptr %p, ptr %c, ptr {self.rows}, i64 {self.order}"
            status = e.value(f"call i32 @jet({arguments})")
            bump(e, r.EVALUATIONS, 1)
            leave_if(e, e.value(f"icmp ne i32 {status}, 0"), Outcome.SINGULAR)
            exponent = self.exponent()
            name = e.fresh("usable")
            reach = self.reach(t, low, end, scale)
            e.do(f"br i1 {self.fits(exponent, reach)}, label %{name}.yes, label %{name}.no")
            e.label(f"{name}.no")
            self.rescale(exponent, reach, scale)
            e.jump(f"{name}.end")
            e.label(f"{name}.yes")
            self.step(t, low, end, scale, exponent)
            e.jump(f"{name}.end")
            e.label(f"{name}.end")
        reached = e.real("fcmp oeq", e.get("%reals", r.T), end)
        e.do(f"ret i32 {e.value(f'select i1 {reached}, i32 {int(Outcome.DONE)}, i32 {int(Outcome.PAUSED)}')}")
        return e.function(
            "define internal i32 @drive(ptr noalias readonly %p, ptr noalias readonly %c, ptr noalias %reals, "
            "ptr noalias %counts, ptr noalias %work, i64 %budget, ptr noalias %times, ptr noalias %states, "
            "i64 %order) #0"
        )

    def begin(self, end: str) -> None:
        """Nothing is lost yet, and the scale of time has the sign of the run's direction."""
        e, r = self.e, DriverState
        for place in range(0, self.layout.padded, self.layout.lanes):
            e.store("zeroinitializer", e.address(self.low, place), self.kind)
        e.put(literal(0.0), "%reals", r.LOW)
        backwards = e.real("fcmp olt", end, e.get("%reals", r.T))
        size = e.fabs(e.get("%reals", r.SCALE))
        e.put(e.choose(backwards, e.value(f"fneg double {size}"), size), "%reals", r.SCALE)

    def exponent(self) -> str:
        """Return the binary logarithm of the step in units of the scale: both last coefficients stay in bounds."""
        e, weights = self.e, self.weights()
        # The earlier rows come first: they are known long before the last.
        guards = [self.guarded(less, weights) for less in range(2, ROWS_SEEN)]
        least = guards[0]
        for guard in guards[1:]:
            least = e.choose(e.real("fcmp olt", guard, least), guard, least)
        logs = []
        for less, reciprocal in zip((1, 0), self.reciprocals, strict=True):
            logs.append(e.real("fmul", logarithm(e, self.ratio(self.row_at(less), weights)), reciprocal))
        bound = e.smaller(*logs)
        found = e.reserve("double")
        e.store(e.choose(e.real("fcmp olt", least, bound), least, bound), found)
        with e.when(self.ends(e.load(found))):
            self.look_back(found, weights)
        return e.load(found)

    def guarded(self, less: int, weights: list[str]) -> str:
        """Return what an earlier row says of the step: the radius that it shows, at the last order; see `GUARD`."""
        e = self.e
        reciprocal = self.minus_one_over(less)
        own = e.real("fmul", logarithm(e, self.ratio(self.row_at(less), weights)), reciprocal)
        apart = e.real("fsub", self.reciprocals[1], reciprocal)
        return e.real("fadd", e.fma(self.digits, apart, own), literal(GUARD))

    def look_back(self, found: str, weights: list[str]) -> None:
        """Where both last coefficients are zero, let the upper half of the others keep in bounds as well.

        They are zero too if the series terminates; a series in the fourth power of time has gaps of that size.
        """
        e = self.e
        half = e.value(f"add nsw i64 {e.value(f'lshr i64 {self.order}, 1')}, 1")
        with e.loop(half, e.value(f"sub nsw i64 {self.order}, 1")) as k:
            row = e.address(self.rows, e.value(f"mul nsw i64 {k}, {self.layout.width}"))
            share = e.real("fdiv", literal(-1.0), e.value(f"sitofp i64 {k} to double"))
            bound = e.real("fmul", logarithm(e, self.ratio(row, weights)), share)
            e.store(e.smaller(e.load(found), bound), found)

    def minus_one_over(self, less: int) -> str:
        """Return -1 over the order less some, at least 1."""
        if self.layout.order:
            return literal(-1.0 / max(self.layout.order - less, 1))
        number = self.e.value(f"sitofp i64 {self.before(less)} to double")
        return self.e.real("fdiv", literal(-1.0), number)

    def before(self, less: int) -> str:
        """Return the order less some, at least 1, where it is known at run time only."""
        k = self.e.value(f"sub nsw i64 %order, {less}")
        return self.e.value(f"call i64 @llvm.smax.i64(i64 {k}, i64 1)") if less > 1 else k

    def row_at(self, less: int) -> str:
        """Return the address of one of the last rows."""
        if self.layout.order:
            return self.e.address(self.rows, max(self.layout.order - less, 1) * self.layout.width)
        return self.e.address(self.rows, self.e.value(f"mul nsw i64 {self.before(less)}, {self.layout.width}"))

    def weights(self) -> list[str]:
        """Return one over the tolerance of each entry of the state."""
        e, kind, lanes = self.e, self.kind, self.layout.lanes
        rtol, atol = (e.splat(e.get("%reals", which), self.kind) for which in (DriverState.RTOL, DriverState.ATOL))
        found = []
        for place in range(0, self.layout.padded, lanes):
            y = e.fabs(e.load(e.address("%work", place), kind), kind)
            moved = e.fabs(self.entries(self.e.address(self.rows, self.layout.width), place), kind)
            size = e.value(f"bitcast <{lanes} x i64> {self.largest([y, moved])} to {kind}")
            tolerance = e.fma(rtol, size, atol, kind)
            found.append(e.value(f"fdiv {kind} {number(1.0, lanes)}, {tolerance}"))
        return found

    def ratio(self, row: str, weights: list[str]) -> str:
        """Return the largest coefficient of a row over its tolerance, NaN if one is not a number."""
        e, kind, lanes = self.e, self.kind, self.layout.lanes
        sizes = []
        for i, weight in enumerate(weights):
            size = e.fabs(self.entries(row, i * lanes), kind)
            sizes.append(e.value(f"fmul {kind} {size}, {weight}"))
        return self.largest_entry(sizes)

    def largest(self, values: list[str]) -> str:
        """Return the largest of some vectors of sizes, entry by entry, as integers.

        The bits of doubles that are not negative are in their order, NaN beyond all others, and integers compare
        faster than doubles that may be NaN.
        """
        e, lanes = self.e, self.layout.lanes
        integers = f"<{lanes} x i64>"
        bits = [e.value(f"bitcast {self.kind} {value} to {integers}") for value in values]
        total = bits[0]
        for other in bits[1:]:
            total = e.value(f"call {integers} @llvm.umax.v{lanes}i64({integers} {total}, {integers} {other})")
        return total

    def largest_entry(self, values: list[str]) -> str:
        """Return the largest of all entries of some vectors of sizes, NaN if one is."""
        lanes = self.layout.lanes
        total = self.e.value(f"call i64 @llvm.vector.reduce.umax.v{lanes}i64(<{lanes} x i64> {self.largest(values)})")
        return self.e.value(f"bitcast i64 {total} to double")

    def row(self, k: int, place: int) -> str:
        """Return the address of an entry of a row."""
        return self.e.address(self.rows, k * self.layout.width + place)

    def entries(self, row: str, place: int) -> str:
        """Return some coefficients of the state; behind its end there are zeros."""
        return self.e.load(self.e.address(row, place), self.kind)

    def reach(self, t: str, low: str, end: str, scale: str) -> str:
        """Return the binary logarithm of what is left of the run, or of the longest step, in units of the scale."""
        e, r = self.e, DriverState
        left = e.fabs(e.real("fsub", e.real("fsub", end, t), low))
        longest = e.smaller(left, e.get("%reals", r.LONGEST))
        return logarithm(e, e.real("fdiv", longest, e.fabs(scale)))

    def ends(self, exponent: str) -> str:
        """Whether a series has no last coefficients: it terminates, or they are too small for doubles."""
        return self.e.real("fcmp ogt", exponent, self.e.real("fmul", self.reciprocals[1], literal(VANISHED)))

    def fits(self, exponent: str, reach: str) -> str:
        """Whether the step is near the scale of time, so that no coefficient has left the range of doubles.

        A series without last coefficients fits when the scale is as long as any step may be; after some tries the
        scale is as good as it gets.
        """
        e = self.e
        steps, tries = (e.get("%counts", which, "i64") for which in (DriverState.STEPS, DriverState.TRIES))
        first = e.value(f"icmp eq i64 {e.value(f'or i64 {steps}, {tries}')}, 0")
        near = e.real("fcmp olt", e.fabs(exponent), e.choose(first, literal(NEAREST), literal(FARTHEST)))
        whole = e.value(f"and i1 {self.ends(exponent)}, {e.real('fcmp olt', reach, literal(1.0))}")
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
        longer = e.choose(self.ends(exponent), e.smaller(reach, literal(LONGER)), exponent)
        whole = rounded(e, e.choose(overflow, literal(SHORTER), longer))
        e.put(e.real("fmul", scale, power_of_two(e, whole)), "%reals", r.SCALE)

    def step(self, t: str, low: str, end: str, scale: str, exponent: str) -> None:
        """Choose the step, look out for what is watched, and take it.

        All is in units of the scale, and what does not depend on the coefficients comes first: the processor has it
        done when the last coefficient arrives.
        """
        e, r = self.e, DriverState
        inverse = e.real("fdiv", literal(1.0), e.fabs(scale))
        left = e.real("fsub", e.real("fsub", end, t), low)
        whole_way = e.real("fmul", e.fabs(left), inverse)
        limit = e.smaller(e.get("%reals", r.LONGEST), e.get("%reals", r.ONCE))
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
        short = e.real("fcmp olt", natural, e.real("fmul", spacing, inverse))
        leave_if(e, e.value(f"and i1 {short}, {e.value(f'xor i1 {final}, true')}"), Outcome.STEP_TOO_SMALL)
        h = e.choose(final, left, e.real("fmul", s, scale))
        e.put(h, "%reals", r.H)
        if self.layout.watched:
            self.look_out(s)
        good = self.advance(s)
        leave_if(e, e.value(f"xor i1 {good}, true"), Outcome.NON_FINITE)
        self.accept(t, low, h, end, final)
        e.put("0", "%counts", r.TRIES, "i64")
        e.put(literal(float("inf")), "%reals", r.ONCE)
        # A series that terminates says nothing about the next one.
        ends = e.real("fcmp ogt", whole, literal(FARTHEST))
        nearest = e.choose(ends, literal(0.0), whole)
        e.put(e.real("fmul", scale, power_of_two(e, nearest)), "%reals", r.SCALE)

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

    def advance(self, s: str) -> str:
        """Add the series to the state, compensated; return whether it stayed finite, else the state stays."""
        e, kind, layout = self.e, self.kind, self.layout
        square = e.real("fmul", s, s)
        powers = [e.splat(power, kind) for power in (s, square, e.real("fmul", square, square))]
        fresh: list[tuple[int, str, str]] = []
        increments = self.increments(*powers) if layout.order else self.looped_increments(powers[0])
        for place, increment in increments:
            low = e.load(e.address(self.low, place), kind)
            y = e.load(e.address("%work", place), kind)
            added = e.value(f"fadd {kind} {increment}, {low}")
            total = e.value(f"fadd {kind} {y}, {added}")
            back = e.value(f"fsub {kind} {total}, {y}")
            first = e.value(f"fsub {kind} {y}, {e.value(f'fsub {kind} {total}, {back}')}")
            second = e.value(f"fsub {kind} {added}, {back}")
            fresh.append((place, total, e.value(f"fadd {kind} {first}, {second}")))
        largest = self.largest_entry([e.fabs(total, kind) for _, total, _ in fresh])
        good = e.real("fcmp olt", largest, literal(float("inf")))
        with e.when(good):
            for place, total, lost in fresh:
                e.store(total, e.address("%work", place), kind)
                e.store(lost, e.address(self.low, place), kind)
        return good

    def increments(self, s1: str, s2: str, s4: str) -> list[tuple[int, str]]:
        """Return the sums of x[k] s**k over k > 0: four chains in s**4, which take a quarter of the time of one."""
        e, kind, found = self.e, self.kind, []
        for place in range(0, self.layout.padded, self.layout.lanes):
            chains = [self.horner(first, place, s4) for first in (1, 2, 3, 4)]
            odd = e.fma(s2, chains[2], chains[0], kind)
            even = e.fma(s2, chains[3], chains[1], kind)
            found.append((place, e.fma(s1, odd, e.value(f"fmul {kind} {s2}, {even}"), kind)))
        return found

    def horner(self, first: int, place: int, s4: str) -> str:
        """Return the sum of x[k] s**(k - first) over k = first, first + 4, ..."""
        e, kind = self.e, self.kind
        orders = range(first, self.layout.order + 1, 4)
        total = e.load(self.row(orders[-1], place), kind)
        for k in reversed(orders[:-1]):
            total = e.fma(total, s4, e.load(self.row(k, place), kind), kind)
        return total

    def looped_increments(self, s1: str) -> list[tuple[int, str]]:
        """Return the sums of x[k] s**k over k > 0 for any order: one chain for each vector, some vectors at a time."""
        e, kind = self.e, self.kind
        found: list[tuple[int, str]] = []
        places = list(range(0, self.layout.padded, self.layout.lanes))
        for begin in range(0, len(places), TILE):
            tile = places[begin : begin + TILE]
            with e.carry(0, "%order", [(kind, number(0.0, self.layout.lanes))] * len(tile)) as loop:
                k = e.value(f"sub nsw i64 %order, {loop.index}")
                row = e.address(self.rows, e.value(f"mul nsw i64 {k}, {self.layout.width}"))
                loop.following = [
                    e.value(f"fmul {kind} {e.value(f'fadd {kind} {total}, {self.entries(row, place)}')}, {s1}")
                    for total, place in zip(loop.values, tile, strict=True)
                ]
            found += zip(tile, loop.values, strict=True)
        return found

    def accept(self, t: str, low: str, h: str, end: str, final: str) -> None:
        """Move on in time, compensated, count the step and record it."""
        e, r = self.e, DriverState
        added = e.real("fadd", h, low)
        total = e.real("fadd", t, added)
        back = e.real("fsub", total, t)
        lost = e.real("fadd", e.real("fsub", t, e.real("fsub", total, back)), e.real("fsub", added, back))
        after = e.choose(final, end, total)
        e.put(after, "%reals", r.T)
        e.put(e.choose(final, literal(0.0), lost), "%reals", r.LOW)
        bump(e, r.STEPS, 1)
        keep = e.value(f"icmp ne i64 {e.get('%counts', r.RECORD, 'i64')}, 0")
        with e.when(keep):
            row = e.get("%counts", r.ROWS, "i64")
            e.put(after, "%times", row)
            target = e.address("%states", e.value(f"mul nsw i64 {row}, {self.layout.dimension}"))
            size = 8 * self.layout.dimension
            e.do(f"call void @llvm.memcpy.p0.p0.i64(ptr {target}, ptr %work, i64 {size}, i1 false)")
            bump(e, r.ROWS, 1)
