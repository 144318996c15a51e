"""What a solve keeps of former steps in machine code, and the guess that it makes of that for the next.

Of equal steps these are backward differences of the unknowns, the last value first. The polynomial through k of them
goes on with their sum, and the k-th difference at the next step is what that guess was off by: it says which k is best.
"""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.steps.llvm_layout import KIND, Layout, Newton, Scalars, blocks, combine, in_work, total
from lagrange.machine.steps.newton_constants import HISTORY, ORDERS


def predict(e: Emitter, layout: Layout, newton: Newton) -> None:
    """Extrapolate the unknowns: as the method states, or by a polynomial through those of equal steps."""
    first = layout.place(newton.solve.first)
    if not newton.adaptive:
        _extrapolate(e, newton, first)
        return
    for offset in blocks(e, newton.all):
        e.store(e.load(in_work(e, newton.history, offset), KIND), in_work(e, first, offset), KIND)
    if newton.solve.predicted:
        scalars = Scalars(e, layout.step, newton.solve.predicted)
        for i, combination in enumerate(newton.solve.predicted):
            combine(e, layout, scalars, combination, newton.residual + i * newton.width)
        for offset in blocks(e, newton.all):
            e.store(e.load(in_work(e, newton.residual, offset), KIND), in_work(e, first, offset), KIND)


def _extrapolate(e: Emitter, newton: Newton, first: int) -> None:
    """Store the sum of as many differences as have served best."""
    order = e.get("%work", newton.flags + Newton.ORDER, "i64")
    name = e.fresh("extrapolate")
    cases = " ".join(f"i64 {k}, label %{name}.{k}" for k in ORDERS[1:])
    e.do(f"switch i64 {order}, label %{name}.{ORDERS[0]} [{cases}]")
    for k in ORDERS:
        e.label(f"{name}.{k}")
        for offset in blocks(e, newton.all):
            value = e.load(in_work(e, newton.history + (k - 1) * newton.all, offset), KIND)
            for i in reversed(range(k - 1)):
                larger = e.load(in_work(e, newton.history + i * newton.all, offset), KIND)
                value = e.value(f"fadd {KIND} {larger}, {value}")
            e.store(value, in_work(e, first, offset), KIND)
        e.jump(f"{name}.end")
    e.label(f"{name}.end")


def keep(e: Emitter, newton: Newton) -> None:
    """Keep the unknowns of an accepted step, to extrapolate from."""
    flags = e.address("%work", newton.flags)
    with e.when(e.real("fcmp une", e.get(flags, Newton.SOLVED), literal(0.0))):
        e.put(literal(0.0), flags, Newton.SOLVED)
        if newton.adaptive:
            for offset in blocks(e, newton.all):
                value = e.load(in_work(e, newton.solve.first * newton.width, offset), KIND)
                e.store(value, in_work(e, newton.history, offset), KIND)
            e.put("1", flags, Newton.KNOWN, "i64")
        else:
            errors = _difference(e, newton)
            _choose_order(e, newton, errors)
        e.put(e.get(flags, Newton.TRIED_STEP), flags, Newton.OLD_STEP)


def _difference(e: Emitter, newton: Newton) -> dict[int, str]:
    """Store the differences with the new unknowns; return the weighted squares of those that are errors of a guess."""
    cells = {k: e.reserve(KIND) for k in ORDERS}
    for cell in cells.values():
        e.store("zeroinitializer", cell, KIND)
    for offset in blocks(e, newton.all):
        weights = e.load(in_work(e, newton.weights, offset), KIND)
        value = e.load(in_work(e, newton.solve.first * newton.width, offset), KIND)
        for i in range(HISTORY):
            place = in_work(e, newton.history + i * newton.all, offset)
            old = e.load(place, KIND)
            e.store(value, place, KIND)
            value = e.value(f"fsub {KIND} {value}, {old}")
            if i + 1 in cells:
                weighted = e.value(f"fmul {KIND} {value}, {weights}")
                cell = cells[i + 1]
                e.store(e.fma(weighted, weighted, e.load(cell, KIND), KIND), cell, KIND)
    return {k: total(e, e.load(cell, KIND)) for k, cell in cells.items()}


def _choose_order(e: Emitter, newton: Newton, errors: dict[int, str]) -> None:
    """Set the order of the next guess: that of the least error, or one more that is possible only now."""
    flags = e.address("%work", newton.flags)
    known = e.get(flags, Newton.KNOWN, "i64")
    following = e.value(f"add nsw i64 {known}, 1")
    best, least = str(ORDERS[0]), errors[ORDERS[0]]
    for k in ORDERS[1:]:
        possible = e.value(f"icmp sge i64 {following}, {k}")
        new = e.value(f"icmp slt i64 {known}, {k}")
        better = e.value(f"or i1 {new}, {e.real('fcmp olt', errors[k], least)}")
        taken = e.value(f"and i1 {possible}, {better}")
        best = e.value(f"select i1 {taken}, i64 {k}, i64 {best}")
        least = e.choose(taken, errors[k], least)
    full = e.value(f"icmp sgt i64 {following}, {HISTORY}")
    e.put(e.value(f"select i1 {full}, i64 {HISTORY}, i64 {following}"), flags, Newton.KNOWN, "i64")
    e.put(best, flags, Newton.ORDER, "i64")
