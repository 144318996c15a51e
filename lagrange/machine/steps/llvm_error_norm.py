"""What step control measures: the scaled error of a step, and a first step from two slopes."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.steps.control_constants import DAMPING, FLAT, GUESS, LEAP, SHARE, SLOWLY, SMALL
from lagrange.machine.steps.llvm_calls import evaluate_in_place
from lagrange.machine.steps.llvm_layout import BLOCK, KIND, blocks, in_work, splat, total
from lagrange.procedure.step.memory import Layout
from lagrange.program.step import StepProgram


def norm_function(step: StepProgram, layout: Layout) -> str:
    """Emit norm(work, rtol, atol): the scaled error of the trial step."""
    e = Emitter()
    sums = [e.reserve(KIND) for _ in step.errors]
    for memory in sums:
        e.store("zeroinitializer", memory, KIND)
    rtol, atol = splat(e, "%rtol"), splat(e, "%atol")
    for offset in blocks(e, layout.width):
        old = e.load(in_work(e, 0, offset), KIND)
        new = e.load(in_work(e, layout.place(layout.new), offset), KIND)
        sizes = f"{KIND} {e.fabs(old, KIND)}, {KIND} {e.fabs(new, KIND)}"
        size = e.value(f"call {KIND} @llvm.maximum.v{BLOCK}f64({sizes})")
        scale = e.fma(rtol, size, atol, KIND)
        for i, memory in enumerate(sums):
            error = e.load(in_work(e, layout.place(layout.errors + i), offset), KIND)
            ratio = e.value(f"fdiv {KIND} {error}, {scale}")
            e.store(e.fma(ratio, ratio, e.load(memory, KIND), KIND), memory, KIND)
    totals = [total(e, e.load(memory, KIND)) for memory in sums]
    dimension = literal(float(layout.dimension))
    if step.control and step.control.damped:
        mixed = e.fma(literal(DAMPING), totals[1], totals[0])
        positive = e.value(f"fcmp ogt double {mixed}, {literal(0.0)}")
        product = e.value(f"fmul double {mixed}, {dimension}")
        safe = e.value(f"select i1 {positive}, double {product}, double {literal(1.0)}")
        root = e.value(f"call double @llvm.sqrt.f64(double {safe})")
        e.do(f"ret double {e.value(f'fdiv double {totals[0]}, {root}')}")
    else:
        mean = e.value(f"fdiv double {totals[0]}, {dimension}")
        e.do(f"ret double {e.value(f'call double @llvm.sqrt.f64(double {mean})')}")
    return e.function("define internal double @norm(ptr noalias %work, double %rtol, double %atol)")


def first_step_function(step: StepProgram, layout: Layout) -> str:
    """Emit first_step: the size of a first step from two slopes.

    Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, II.4.
    """
    e = Emitter()
    slope = layout.place(layout.vectors - 1)
    evaluate_in_place(e, layout, "%t", 0, layout.result)
    for offset in blocks(e, layout.width):
        e.store(e.load(in_work(e, layout.result, offset), KIND), in_work(e, slope, offset), KIND)
    d0, d1 = _mean(e, layout, 0), _mean(e, layout, slope)
    small = e.value(f"or i1 {e.real('fcmp olt', d0, literal(SMALL))}, {e.real('fcmp olt', d1, literal(SMALL))}")
    ratio = e.real("fdiv", e.real("fmul", literal(SHARE), d0), d1)
    # A slope infinitely large against its tolerance, as where y = 0 and atol is next to 0, says nothing about a step.
    known = e.real("fcmp ogt", ratio, literal(0.0))
    h0 = e.smaller(e.choose(small, literal(GUESS), e.choose(known, ratio, literal(GUESS))), "%span")
    _second_slope(e, layout, slope, e.real("fmul", h0, "%direction"))
    d2 = e.real("fdiv", _mean(e, layout, layout.result, slope), h0)
    largest = e.larger(d1, d2)
    flat = e.real("fcmp ole", largest, literal(FLAT))
    slow = e.larger(literal(GUESS), e.real("fmul", h0, literal(SLOWLY)))
    exponent = 1.0 / (step.control.exponent if step.control else 1)
    h1 = e.choose(flat, slow, e.power(e.real("fdiv", literal(SHARE), largest), exponent))
    chosen = e.smaller(e.smaller(e.real("fmul", literal(LEAP), h0), h1), "%span")
    # Where the second slope is not finite the guess from the first one stands; the loop shortens it if it must.
    e.do(f"ret double {e.choose(e.real('fcmp ogt', chosen, literal(0.0)), chosen, h0)}")
    return e.function(
        "define internal double @first_step(ptr %rhs, ptr %p, double %t, double %span, double %direction, "
        "double %rtol, double %atol, ptr noalias %work)"
    )


def _second_slope(e: Emitter, layout: Layout, slope: int, h: str) -> None:
    """Evaluate the right-hand side after an Euler step of h."""
    factor = splat(e, h)
    for offset in blocks(e, layout.width):
        moved = e.fma(factor, e.load(in_work(e, slope, offset), KIND), e.load(in_work(e, 0, offset), KIND), KIND)
        e.store(moved, in_work(e, layout.argument, offset), KIND)
    evaluate_in_place(e, layout, e.real("fadd", "%t", h), layout.argument, layout.result)


def _mean(e: Emitter, layout: Layout, place: int, less: int | None = None) -> str:
    """Return the scaled RMS norm of the vector at a place, or of its difference from another."""
    memory = e.reserve(KIND)
    e.store("zeroinitializer", memory, KIND)
    rtol, atol = splat(e, "%rtol"), splat(e, "%atol")
    for offset in blocks(e, layout.width):
        size = e.fabs(e.load(in_work(e, 0, offset), KIND), KIND)
        value = e.load(in_work(e, place, offset), KIND)
        if less is not None:
            value = e.value(f"fsub {KIND} {value}, {e.load(in_work(e, less, offset), KIND)}")
        ratio = e.value(f"fdiv {KIND} {value}, {e.fma(rtol, size, atol, KIND)}")
        e.store(e.fma(ratio, ratio, e.load(memory, KIND), KIND), memory, KIND)
    share = e.real("fdiv", total(e, e.load(memory, KIND)), literal(float(layout.dimension)))
    return e.value(f"call double @llvm.sqrt.f64(double {share})")
