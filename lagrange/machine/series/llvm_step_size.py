"""The size of a Taylor step from its last rows, in machine code."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import element, number
from lagrange.machine.series.constants import APART, GUARD, REACH, ROWS_SEEN, START_ROWS, VANISHED
from lagrange.machine.series.llvm_layout import TaylorLayout
from lagrange.machine.series.llvm_log2 import logarithm
from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import LEAST_FLOOR


class StepSize:
    """Emits what the rows say of the step, and the measures of vectors that it takes."""

    def __init__(self, e: Emitter, layout: TaylorLayout) -> None:
        self.e, self.layout = e, layout
        self.kind = element(layout.lanes)
        self.rows = e.address("%work", layout.rows)
        self.order = str(layout.order) if layout.order else "%order"
        self.reciprocals = [self.minus_one_over(less) for less in (1, 0)]
        self.spans = [self.one_over_span(less) for less in (1, 0)]
        # Minus the binary logarithm of the relative tolerance.
        self.digits = e.value(f"fneg double {logarithm(e, e.get('%reals', DriverState.RTOL))}")

    def exponent(self, weights: list[str]) -> str:
        """Return the binary logarithm of the step in units of the scale: both last coefficients stay in bounds."""
        e = self.e
        # The earlier rows come first: they are known long before the last.
        sizes = {less: logarithm(e, self.ratio(self.row_at(less), weights)) for less in range(APART + 1, -1, -1)}
        least = ""
        for less in range(2, ROWS_SEEN):
            guard = self.guarded(less, sizes[less])
            least = e.choose(e.real("fcmp olt", guard, least), guard, least) if least else guard
        spans = zip((1, 0), self.spans, strict=True)
        shown = [self.radius(sizes[less + APART], sizes[less], span) for less, span in spans]
        radius = e.choose(e.real("fcmp ogt", shown[0], shown[1]), shown[0], shown[1])
        radius = e.real("fadd", radius, literal(REACH))
        least = e.choose(e.real("fcmp olt", radius, least), radius, least)
        bounds = [e.real("fmul", sizes[less], share) for less, share in zip((1, 0), self.reciprocals, strict=True)]
        bound = e.smaller(*bounds)
        found = e.reserve("double")
        e.store(e.choose(e.real("fcmp olt", least, bound), least, bound), found)
        with e.when(self.ends(e.load(found))):
            self.look_back(found, weights)
        return e.load(found)

    def guarded(self, less: int, size: str) -> str:
        """Return what an earlier row says of the step: the radius that it shows, at the last order; see `GUARD`."""
        e = self.e
        reciprocal = self.minus_one_over(less)
        apart = e.real("fsub", self.reciprocals[1], reciprocal)
        return e.real("fadd", e.fma(self.digits, apart, e.real("fmul", size, reciprocal)), literal(GUARD))

    def radius(self, early: str, late: str, span: str) -> str:
        """Return the binary logarithm of the radius of convergence that two rows show; infinity if one is zero."""
        e = self.e
        none = e.real("fcmp olt", e.choose(e.real("fcmp olt", early, late), early, late), literal(VANISHED))
        shown = e.real("fmul", e.real("fsub", early, late), span)
        return e.choose(none, literal(float("inf")), shown)

    def one_over_span(self, less: int) -> str:
        """Return one over the orders between a row and the one `APART` before it, or the first."""
        order = self.layout.order
        if order:
            return literal(1.0 / max(max(order - less, 1) - max(order - less - APART, 1), 1))
        e = self.e
        span = e.value(f"sub nsw i64 {self.before(less)}, {self.before(less + APART)}")
        return e.real("fdiv", literal(1.0), e.value(f"sitofp i64 {span} to double"))

    def ends(self, exponent: str) -> str:
        """Whether a series has no last coefficients: it terminates, or they are too small for doubles."""
        return self.e.real("fcmp ogt", exponent, self.e.real("fmul", self.reciprocals[1], literal(VANISHED)))

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
        rtol = e.splat(e.get("%reals", DriverState.RTOL), kind)
        found = []
        for place in range(0, self.layout.padded, lanes):
            y = e.fabs(e.load(e.address("%work", place), kind), kind)
            moved = e.fabs(self.entries(self.e.address(self.rows, self.layout.width), place), kind)
            size = e.value(f"bitcast <{lanes} x i64> {self.largest([y, moved])} to {kind}")
            tolerance = e.fma(rtol, size, e.load(self.floor(place), kind), kind)
            found.append(e.value(f"fdiv {kind} {number(1.0, lanes)}, {tolerance}"))
        return found

    def floor(self, place: int) -> str:
        """Return the address of some floors; see `DriverState`."""
        return self.e.address("%reals", DriverState.FLOORS + place)

    def raise_floors(self) -> None:
        """Raise the floors to their share of the state."""
        e, kind = self.e, self.kind
        share = e.splat(e.get("%reals", DriverState.SHARE), kind)
        for place in range(0, self.layout.padded, self.layout.lanes):
            size = e.value(f"fmul {kind} {share}, {e.fabs(e.load(e.address('%work', place), kind), kind)}")
            floor = e.load(self.floor(place), kind)
            e.store(self.where("ogt", size, floor, size, floor), self.floor(place), kind)

    def where(self, how: str, a: str, b: str, one: str, other: str) -> str:
        """Return some entries of one vector, where those of two others compare so, or else of another."""
        e, lanes = self.e, self.layout.lanes
        holds = e.value(f"fcmp {how} {self.kind} {a}, {b}")
        return e.value(f"select <{lanes} x i1> {holds}, {self.kind} {one}, {self.kind} {other}")

    def first_floors(self) -> str:
        """Give floors a start where entries are zero; return whether some series begin too late for that.

        See the interpreted driver.
        """
        e, kind, lanes = self.e, self.kind, self.layout.lanes
        share, least = e.splat(e.get("%reals", DriverState.SHARE), kind), number(LEAST_FLOOR, lanes)
        zero, infinite = (e.splat(literal(x), kind) for x in (0.0, float("inf")))
        blind = []
        for place in range(0, self.layout.padded, lanes):
            sizes = [e.fabs(self.entries(self.row(k), place), kind) for k in range(1, START_ROWS + 1)]
            size = e.value(f"bitcast <{lanes} x i64> {self.largest(sizes)} to {kind}")
            reach = e.value(f"fmul {kind} {share}, {size}")
            floor = e.load(self.floor(place), kind)
            reach = self.where("olt", reach, infinite, self.where("ogt", reach, zero, reach, floor), floor)
            reach = self.where("olt", reach, least, least, reach)
            y = e.load(e.address("%work", place), kind)
            floor = self.where("oeq", y, zero, reach, floor)
            e.store(floor, self.floor(place), kind)
            late = [e.fabs(self.entries(self.row_at(less), place), kind) for less in (1, 0)]
            last = e.value(f"bitcast <{lanes} x i64> {self.largest(late)} to {kind}")
            blind.append(self.where("oeq", y, zero, self.where("ole", floor, least, last, zero), zero))
        return e.value(f"xor i1 {e.real('fcmp oeq', self.largest_entry(blind), literal(0.0))}, true")

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

    def entries(self, row: str, place: int) -> str:
        """Return some coefficients of the state; behind its end there are zeros."""
        return self.e.load(self.e.address(row, place), self.kind)

    def row(self, k: int) -> str:
        """Return the address of a row."""
        return self.e.address(self.rows, k * self.layout.width)

    def with_velocities(self) -> range:
        """Return the places of the vectors of the state in which there are velocities."""
        lanes = self.layout.lanes
        return range(self.layout.dimension // 2 // lanes * lanes, self.layout.padded, lanes)
