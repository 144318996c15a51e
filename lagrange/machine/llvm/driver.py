"""Drivers in machine code: the step program unrolled around calls of the right-hand side, and the loop over steps.

    i32 drive(ptr rhs, ptr parameters, ptr reals, ptr counts, ptr work, i64 budget, ptr times, ptr rows)

`reals` and `counts` are those of `DriverState`; `work` holds the vectors of a step, each padded to whole blocks of
four doubles: states, slopes, new states, errors, then the buffers for a call. The result is an `Outcome`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray
from lagrange.machine.driver import DriverState, Outcome
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.loaded import LlvmKernel
from lagrange.machine.llvm.spelling import spell
from lagrange.program.lower import lower
from lagrange.program.step import Combination, StepProgram

BLOCK = 4
KIND = f"<{BLOCK} x double>"
UNROLLED_BLOCKS = 8
"""Up to this many blocks per vector are written out; longer vectors are looped over."""

STATE = DriverState
_DECLARED = f"""
declare double @llvm.fabs.f64(double)
declare double @llvm.sqrt.f64(double)
declare double @llvm.maximum.f64(double, double)
declare double @llvm.minimum.f64(double, double)
declare double @llvm.fma.f64(double, double, double)
declare {KIND} @llvm.fma.v{BLOCK}f64({KIND}, {KIND}, {KIND})
declare {KIND} @llvm.fabs.v{BLOCK}f64({KIND})
declare {KIND} @llvm.maximum.v{BLOCK}f64({KIND}, {KIND})
declare double @pow(double, double)
"""


class LlvmDriver:
    """A compiled driver bound to one right-hand side and one set of prepared parameters."""

    def __init__(self, step: StepProgram, kernel: LlvmKernel, parameters: FloatArray) -> None:
        self._kernel = kernel
        self._layout = _Layout(step, kernel.program.states)
        self._module = _compiled(step, kernel.program.states)
        self._drive = _DRIVE(self._module.address("drive"))
        self._prepared = kernel.prepare(parameters)
        self._work = np.zeros(self._layout.size)

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`. `rows` needs one block of slack behind its last row."""
        d = len(state.y)
        n = d // 2
        work, layout = self._work, self._layout
        if layout.step.partitioned:
            work[:n], work[layout.width : layout.width + n] = state.y[:n], state.y[n:]
        else:
            work[:d] = state.y
        outcome = self._drive(
            self._kernel.address,
            self._prepared.ctypes.data,
            state.reals.ctypes.data,
            state.counts.ctypes.data,
            work.ctypes.data,
            budget,
            times.ctypes.data,
            rows.ctypes.data,
        )
        if layout.step.partitioned:
            state.y[:n], state.y[n:] = work[:n], work[layout.width : layout.width + n]
        else:
            state.y[:] = work[:d]
        return Outcome(outcome)


_DRIVE = ctypes.CFUNCTYPE(
    ctypes.c_int32, *([ctypes.c_void_p] * 5), ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p
)


class _Layout:
    """Where each vector of a step stands in the work array."""

    def __init__(self, step: StepProgram, dimension: int) -> None:
        self.step = step
        self.dimension = dimension
        self.length = dimension // 2 if step.partitioned else dimension
        self.width = -(-self.length // BLOCK) * BLOCK
        self.vectors = step.states + len(step.calls)
        self.new = self.vectors
        self.errors = self.new + step.states
        first_buffer = (self.errors + len(step.errors)) * self.width
        self.argument = first_buffer
        self.result = first_buffer + 2 * (dimension + BLOCK)
        self.size = self.result + 2 * (dimension + BLOCK)

    def place(self, vector: int) -> int:
        """Return the offset of a vector."""
        return vector * self.width


@lru_cache(maxsize=64)
def _compiled(step: StepProgram, dimension: int) -> Module:
    return Module(driver_ir(step, dimension), optimize=True)


def driver_ir(step: StepProgram, dimension: int) -> str:
    """Return the IR of the driver of a step for states of that dimension."""
    layout = _Layout(step, dimension)
    loop = _adaptive_loop if step.control else _fixed_loop
    parts = [_DECLARED, _step_function(step, layout), _record_function(layout)]
    if step.control:
        parts.append(_norm_function(step, layout))
        parts.append(_first_step_function(step, layout))
    return "\n".join([*parts, loop(step, layout)])


class _Scalars:
    """The numbers of a step, made of t and h, emitted once each."""

    def __init__(self, e: Emitter, step: StepProgram, nodes: Sequence[Node]) -> None:
        wanted = list(dict.fromkeys(nodes))
        program = lower("scalars", wanted, (len(wanted),), [step.h], step.time, [])
        values: list[str] = []
        for op, args, data in program.instructions:
            if op == "time":
                values.append("%t")
            elif op == "state":
                values.append("%h")
            elif op == "constant":
                values.append(literal(data))
            else:
                values.append(spell(e, op, [values[arg] for arg in args], 1))
        self.names = {node: values[ref] for node, ref in zip(wanted, program.outputs, strict=True)}
        self.splats: dict[Node, str] = {}

    def splat(self, e: Emitter, node: Node) -> str:
        if node not in self.splats:
            one = e.value(f"insertelement {KIND} poison, double {self.names[node]}, i64 0")
            zeros = f"<{BLOCK} x i32> zeroinitializer"
            self.splats[node] = e.value(f"shufflevector {KIND} {one}, {KIND} poison, {zeros}")
        return self.splats[node]


def _blocks(e: Emitter, layout: _Layout) -> Iterator[str | int]:
    """Repeat the body of a for statement for the offset of each block, unrolled or in a loop of the machine."""
    if layout.width <= UNROLLED_BLOCKS * BLOCK:
        yield from range(0, layout.width, BLOCK)
    else:
        with e.loop(0, layout.width, BLOCK) as i:
            yield i


def _in_work(e: Emitter, place: int, offset: str | int) -> str:
    return e.address(e.address("%work", place), offset)


def _combine(e: Emitter, layout: _Layout, scalars: _Scalars, combination: Combination, target: int) -> None:
    """Store a linear combination of vectors at an offset of the work array."""
    one = combination[0][1].graph.one if combination else None
    splats = {i: scalars.splat(e, c) for i, c in combination if c is not one}
    for offset in _blocks(e, layout):
        total = ""
        for vector, coefficient in sorted(combination, key=lambda term: term[1] is not one):
            value = e.load(_in_work(e, layout.place(vector), offset), KIND)
            if coefficient is one:
                total = value if not total else e.value(f"fadd {KIND} {total}, {value}")
            elif not total:
                total = e.value(f"fmul {KIND} {splats[vector]}, {value}")
            else:
                total = e.fma(splats[vector], value, total, KIND)
        e.store(total or "zeroinitializer", _in_work(e, target, offset), KIND)


def _step_function(step: StepProgram, layout: _Layout) -> str:
    """Emit step(rhs, parameters, t, h, work, slope_known) -> 1 if the mass matrix was singular."""
    e = Emitter()
    nodes = [c for call in step.calls for _, c in call.argument] + [call.time for call in step.calls]
    nodes += [c for combination in (*step.results, *step.errors) for _, c in combination]
    scalars = _Scalars(e, step, nodes)
    for combination in (*(call.argument for call in step.calls), *step.results, *step.errors):
        for _, coefficient in combination:
            if coefficient is not step.graph.one:
                scalars.splat(e, coefficient)
    status = e.reserve("i32")
    e.store("0", status, "i32")
    for i, call in enumerate(step.calls):
        if i == 0 and step.starts_with_slope:
            with e.when(e.value("icmp eq i64 %slope_known, 0")):
                _call(e, layout, scalars, call.argument, scalars.names[call.time], step.states, status)
        else:
            _call(e, layout, scalars, call.argument, scalars.names[call.time], step.states + i, status)
    for i, result in enumerate(step.results):
        _combine(e, layout, scalars, result, layout.place(layout.new + i))
    for i, error in enumerate(step.errors):
        _combine(e, layout, scalars, error, layout.place(layout.errors + i))
    e.do(f"ret i32 {e.load(status, 'i32')}")
    signature = "define internal i32 @step(ptr %rhs, ptr %p, double %t, double %h, ptr noalias %work, i64 %slope_known)"
    return e.function(signature)


def _call(
    e: Emitter, layout: _Layout, scalars: _Scalars, argument: Combination, time: str, target: int, status: str
) -> None:
    """Evaluate the right-hand side at a combination and keep the slope (or the accelerations) as a vector."""
    _combine(e, layout, scalars, argument, layout.argument)
    where, out = e.address("%work", layout.argument), e.address("%work", layout.result)
    failed = e.value(f"call i32 %rhs(double {time}, ptr {where}, ptr %p, ptr {out})")
    e.store(e.value(f"or i32 {e.load(status, 'i32')}, {failed}"), status, "i32")
    source = layout.result + (layout.length if layout.step.partitioned else 0)
    for offset in _blocks(e, layout):
        value = e.load(_in_work(e, source, offset), KIND)
        e.store(value, _in_work(e, layout.place(target), offset), KIND)


def _record_function(layout: _Layout) -> str:
    """Emit accept(counts, work, t, times, rows): the new state becomes the state, and a row if rows are kept."""
    e = Emitter()
    step = layout.step
    for i in range(step.states):
        for offset in _blocks(e, layout):
            value = e.load(_in_work(e, layout.place(layout.new + i), offset), KIND)
            e.store(value, _in_work(e, layout.place(i), offset), KIND)
    if step.ends_with_slope:
        last = step.states + len(step.calls) - 1
        for offset in _blocks(e, layout):
            value = e.load(_in_work(e, layout.place(last), offset), KIND)
            e.store(value, _in_work(e, layout.place(step.states), offset), KIND)
    e.put("1" if step.ends_with_slope else "0", "%counts", STATE.SLOPE_KNOWN, "i64")
    _bump(e, STATE.STEPS, 1)
    keep = e.value(f"icmp ne i64 {e.get('%counts', STATE.RECORD, 'i64')}, 0")
    with e.when(keep):
        row = e.get("%counts", STATE.ROWS, "i64")
        e.put("%t", "%times", row)
        start = e.address("%rows", e.value(f"mul nsw i64 {row}, {layout.dimension}"))
        for i in range(step.states):
            base = e.address(start, i * layout.length)
            for offset in _blocks(e, layout):
                value = e.load(_in_work(e, layout.place(i), offset), KIND)
                e.store(value, e.address(base, offset), KIND)
        _bump(e, STATE.ROWS, 1)
    e.do("ret void")
    return e.function(
        "define internal void @accept(ptr noalias %counts, ptr noalias %work, double %t, ptr noalias %times, "
        "ptr noalias %rows)"
    )


def _bump(e: Emitter, which: int, by: int | str) -> None:
    value = e.get("%counts", which, "i64")
    e.put(e.value(f"add nsw i64 {value}, {by}"), "%counts", which, "i64")


def _total(e: Emitter, vector: str) -> str:
    """Return the sum of a block's entries, in a fixed order."""
    parts = [e.value(f"extractelement {KIND} {vector}, i64 {k}") for k in range(BLOCK)]
    left = e.value(f"fadd double {parts[0]}, {parts[1]}")
    right = e.value(f"fadd double {parts[2]}, {parts[3]}")
    return e.value(f"fadd double {left}, {right}")


def _finite(e: Emitter, layout: _Layout, vectors: Sequence[int]) -> str:
    """Return whether all entries are finite: 0 * x is 0 for these alone, and NaN for the others."""
    memory = e.reserve(KIND)
    e.store("zeroinitializer", memory, KIND)
    for vector in vectors:
        for offset in _blocks(e, layout):
            value = e.load(_in_work(e, layout.place(vector), offset), KIND)
            e.store(e.fma(value, "zeroinitializer", e.load(memory, KIND), KIND), memory, KIND)
    return e.value(f"fcmp oeq double {_total(e, e.load(memory, KIND))}, {literal(0.0)}")


def _signature(name: str) -> str:
    return (
        f"define i32 @{name}(ptr %rhs, ptr %p, ptr noalias %reals, ptr noalias %counts, ptr noalias %work, "
        "i64 %budget, ptr noalias %times, ptr noalias %rows)"
    )


def _attempt(e: Emitter, step: StepProgram, t: str, h: str) -> str:
    """Take a trial step and return whether the mass matrix was singular on the way."""
    known = e.get("%counts", STATE.SLOPE_KNOWN, "i64")
    arguments = f"ptr %rhs, ptr %p, double {t}, double {h}, ptr %work, i64 {known}"
    status = e.value(f"call i32 @step({arguments})")
    reused = known if step.starts_with_slope else "0"
    _bump(e, STATE.EVALUATIONS, e.value(f"sub nsw i64 {len(step.calls)}, {reused}"))
    if step.starts_with_slope:
        e.put("1", "%counts", STATE.SLOPE_KNOWN, "i64")
    return e.value(f"icmp ne i32 {status}, 0")


def _accept(e: Emitter, t: str) -> None:
    e.put(t, "%reals", STATE.T)
    e.do(f"call void @accept(ptr %counts, ptr %work, double {t}, ptr %times, ptr %rows)")


def _leave_if(e: Emitter, condition: str, outcome: Outcome) -> None:
    name = e.fresh("leave")
    e.do(f"br i1 {condition}, label %{name}.out, label %{name}.on")
    e.label(f"{name}.out")
    e.do(f"ret i32 {int(outcome)}")
    e.label(f"{name}.on")


def _fixed_loop(step: StepProgram, layout: _Layout) -> str:
    """Equal steps from the start; the times are multiples of the step, and the last step ends at the end."""
    e = Emitter()
    start, end, h = (e.get("%reals", which) for which in (STATE.START, STATE.END, STATE.STEP))
    with e.loop(0, "%budget"):
        t = e.get("%reals", STATE.T)
        _leave_if(e, e.value(f"fcmp oeq double {t}, {end}"), Outcome.DONE)
        count = e.get("%counts", STATE.STEPS, "i64")
        following = e.value(f"sitofp i64 {e.value(f'add nsw i64 {count}, 1')} to double")
        grid = e.fma(following, h, start)
        # A last step of a millionth of the step is round-off of the grid and joins the step before it.
        left = e.value(f"fsub double {end}, {e.fma(literal(1e-6), h, grid)}")
        beyond = e.value(f"fcmp ole double {e.value(f'fmul double {left}, {h}')}, {literal(0.0)}")
        after = e.value(f"select i1 {beyond}, double {end}, double {grid}")
        last = e.value(f"fsub double {end}, {t}")
        length = e.value(f"select i1 {beyond}, double {last}, double {h}")
        singular = _attempt(e, step, t, length)
        _leave_if(e, singular, Outcome.SINGULAR)
        good = _finite(e, layout, [layout.new + i for i in range(step.states)])
        _leave_if(e, e.value(f"xor i1 {good}, true"), Outcome.NON_FINITE)
        _accept(e, after)
    reached = e.value(f"fcmp oeq double {e.get('%reals', STATE.T)}, {end}")
    e.do(f"ret i32 {e.value(f'select i1 {reached}, i32 {int(Outcome.DONE)}, i32 {int(Outcome.PAUSED)}')}")
    return e.function(_signature("drive"))


def _norm_function(step: StepProgram, layout: _Layout) -> str:
    """Emit norm(work, rtol, atol): the scaled error of the trial step."""
    e = Emitter()
    sums = [e.reserve(KIND) for _ in step.errors]
    for memory in sums:
        e.store("zeroinitializer", memory, KIND)
    rtol, atol = _splat(e, "%rtol"), _splat(e, "%atol")
    for offset in _blocks(e, layout):
        old = e.load(_in_work(e, 0, offset), KIND)
        new = e.load(_in_work(e, layout.place(layout.new), offset), KIND)
        sizes = f"{KIND} {e.fabs(old, KIND)}, {KIND} {e.fabs(new, KIND)}"
        size = e.value(f"call {KIND} @llvm.maximum.v{BLOCK}f64({sizes})")
        scale = e.fma(rtol, size, atol, KIND)
        for i, memory in enumerate(sums):
            error = e.load(_in_work(e, layout.place(layout.errors + i), offset), KIND)
            ratio = e.value(f"fdiv {KIND} {error}, {scale}")
            e.store(e.fma(ratio, ratio, e.load(memory, KIND), KIND), memory, KIND)
    totals = [_total(e, e.load(memory, KIND)) for memory in sums]
    dimension = literal(float(layout.dimension))
    if step.control and step.control.damped:
        mixed = e.fma(literal(0.01), totals[1], totals[0])
        positive = e.value(f"fcmp ogt double {mixed}, {literal(0.0)}")
        product = e.value(f"fmul double {mixed}, {dimension}")
        safe = e.value(f"select i1 {positive}, double {product}, double {literal(1.0)}")
        root = e.value(f"call double @llvm.sqrt.f64(double {safe})")
        e.do(f"ret double {e.value(f'fdiv double {totals[0]}, {root}')}")
    else:
        mean = e.value(f"fdiv double {totals[0]}, {dimension}")
        e.do(f"ret double {e.value(f'call double @llvm.sqrt.f64(double {mean})')}")
    return e.function("define internal double @norm(ptr noalias %work, double %rtol, double %atol)")


def _splat(e: Emitter, scalar: str) -> str:
    one = e.value(f"insertelement {KIND} poison, double {scalar}, i64 0")
    return e.value(f"shufflevector {KIND} {one}, {KIND} poison, <{BLOCK} x i32> zeroinitializer")


def _first_step_function(step: StepProgram, layout: _Layout) -> str:
    """Emit first_step: the size of a first step from two slopes.

    Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, II.4.
    """
    e = Emitter()
    rtol, atol = _splat(e, "%rtol"), _splat(e, "%atol")
    source, result = e.address("%work", layout.argument), e.address("%work", layout.result)

    def mean(vectors: tuple[int, int | None]) -> str:
        """Return the scaled RMS norm of a vector, or of the difference of two."""
        memory = e.reserve(KIND)
        e.store("zeroinitializer", memory, KIND)
        for offset in _blocks(e, layout):
            size = e.fabs(e.load(_in_work(e, 0, offset), KIND), KIND)
            value = e.load(_in_work(e, vectors[0], offset), KIND)
            if vectors[1] is not None:
                value = e.value(f"fsub {KIND} {value}, {e.load(_in_work(e, vectors[1], offset), KIND)}")
            ratio = e.value(f"fdiv {KIND} {value}, {e.fma(rtol, size, atol, KIND)}")
            e.store(e.fma(ratio, ratio, e.load(memory, KIND), KIND), memory, KIND)
        share = e.value(f"fdiv double {_total(e, e.load(memory, KIND))}, {literal(float(layout.dimension))}")
        return e.value(f"call double @llvm.sqrt.f64(double {share})")

    slope = layout.place(1)
    e.value(f"call i32 %rhs(double %t, ptr %work, ptr %p, ptr {result})")
    for offset in _blocks(e, layout):
        e.store(e.load(_in_work(e, layout.result, offset), KIND), _in_work(e, slope, offset), KIND)
    d0, d1 = mean((0, None)), mean((slope, None))
    low = literal(1e-5)
    small = e.value(
        f"or i1 {e.value(f'fcmp olt double {d0}, {low}')}, {e.value(f'fcmp olt double {d1}, {low}')}"
    )
    ratio = e.value(f"fdiv double {e.value(f'fmul double {literal(0.01)}, {d0}')}, {d1}")
    guess = e.value(f"select i1 {small}, double {literal(1e-6)}, double {ratio}")
    h0 = e.value(f"call double @llvm.minimum.f64(double {guess}, double %span)")
    signed = e.value(f"fmul double {h0}, %direction")
    factor = _splat(e, signed)
    for offset in _blocks(e, layout):
        moved = e.fma(factor, e.load(_in_work(e, slope, offset), KIND), e.load(_in_work(e, 0, offset), KIND), KIND)
        e.store(moved, _in_work(e, layout.argument, offset), KIND)
    later = e.value(f"fadd double %t, {signed}")
    e.value(f"call i32 %rhs(double {later}, ptr {source}, ptr %p, ptr {result})")
    d2 = e.value(f"fdiv double {mean((layout.result, slope))}, {h0}")
    largest = e.value(f"call double @llvm.maximum.f64(double {d1}, double {d2})")
    flat = e.value(f"fcmp ole double {largest}, {literal(1e-15)}")
    slow = e.value(f"fmul double {h0}, {literal(1e-3)}")
    slow = e.value(f"call double @llvm.maximum.f64(double {literal(1e-6)}, double {slow})")
    exponent = 1.0 / (step.control.exponent if step.control else 1)
    target = e.value(f"fdiv double {literal(0.01)}, {largest}")
    curved = e.value(f"call double @pow(double {target}, double {literal(exponent)})")
    h1 = e.value(f"select i1 {flat}, double {slow}, double {curved}")
    hundred = e.value(f"fmul double {literal(100.0)}, {h0}")
    chosen = e.value(f"call double @llvm.minimum.f64(double {hundred}, double {h1})")
    chosen = e.value(f"call double @llvm.minimum.f64(double {chosen}, double %span)")
    # Where the second slope is not finite the guess from the first one stands; the loop shortens it if it must.
    usable = e.value(f"fcmp ogt double {chosen}, {literal(0.0)}")
    e.do(f"ret double {e.value(f'select i1 {usable}, double {chosen}, double {h0}')}")
    return e.function(
        "define internal double @first_step(ptr %rhs, ptr %p, double %t, double %span, double %direction, "
        "double %rtol, double %atol, ptr noalias %work)"
    )


def _adaptive_loop(step: StepProgram, layout: _Layout) -> str:
    e = Emitter()
    end, rtol, atol = (e.get("%reals", which) for which in (STATE.END, STATE.RTOL, STATE.ATOL))
    begin = e.get("%reals", STATE.T)
    distance = e.value(f"fsub double {end}, {begin}")
    backward = e.value(f"fcmp olt double {distance}, {literal(0.0)}")
    direction = e.value(f"select i1 {backward}, double {literal(-1.0)}, double {literal(1.0)}")
    with e.when(e.value(f"fcmp oeq double {e.get('%reals', STATE.H)}, {literal(0.0)}")):
        arguments = f"ptr %rhs, ptr %p, double {begin}, double {e.fabs(distance)}, double {direction}"
        first = e.value(f"call double @first_step({arguments}, double {rtol}, double {atol}, ptr %work)")
        e.put(e.value(f"fmul double {first}, {direction}"), "%reals", STATE.H)
        _bump(e, STATE.EVALUATIONS, 2)
    with e.loop(0, "%budget"):
        t, h = e.get("%reals", STATE.T), e.get("%reals", STATE.H)
        _leave_if(e, e.value(f"fcmp oeq double {t}, {end}"), Outcome.DONE)
        size = e.value(f"call double @llvm.maximum.f64(double {e.fabs(t)}, double {literal(1e-290)})")
        least = e.value(f"fmul double {size}, {literal(16 * 2.0**-52)}")
        left = e.value(f"fsub double {end}, {t}")
        # A step within one percent of the end goes to the end, so that no sliver is left over.
        stretched = e.value(f"fmul double {e.fabs(h)}, {literal(1.01)}")
        final = e.value(f"fcmp oge double {stretched}, {e.fabs(left)}")
        small = e.value(f"fcmp ult double {e.fabs(h)}, {least}")
        stuck = e.value(f"and i1 {small}, {e.value(f'xor i1 {final}, true')}")
        rejected = e.value(f"icmp ne i64 {e.get('%counts', STATE.AFTER_REJECT, 'i64')}, 0")
        hopeless = e.value(f"or i1 {stuck}, {e.value(f'and i1 {small}, {rejected}')}")
        _leave_if(e, hopeless, Outcome.STEP_TOO_SMALL)
        length = e.value(f"select i1 {final}, double {left}, double {h}")
        moved = e.value(f"fadd double {t}, {h}")
        after = e.value(f"select i1 {final}, double {end}, double {moved}")
        singular = _attempt(e, step, t, length)
        good = _finite(e, layout, [layout.new, *(layout.errors + i for i in range(len(step.errors)))])
        usable = e.value(f"and i1 {good}, {e.value(f'xor i1 {singular}, true')}")
        name = e.fresh("trial")
        e.do(f"br i1 {usable}, label %{name}.measure, label %{name}.broken")
        e.label(f"{name}.broken")
        cause = e.value(
            f"select i1 {singular}, double {literal(float(Outcome.SINGULAR))}, double {literal(float(Outcome.NON_FINITE))}"
        )
        _reject(e, cause, e.value(f"fmul double {length}, {literal(0.25)}"))
        e.jump(f"{name}.end")
        e.label(f"{name}.measure")
        _judge(e, step, name, length, after, rtol, atol, rejected)
        e.label(f"{name}.end")
    reached = e.value(f"fcmp oeq double {e.get('%reals', STATE.T)}, {end}")
    e.do(f"ret i32 {e.value(f'select i1 {reached}, i32 {int(Outcome.DONE)}, i32 {int(Outcome.PAUSED)}')}")
    return e.function(_signature("drive"))


def _reject(e: Emitter, cause: str, h: str) -> None:
    e.put(cause, "%reals", STATE.CAUSE)
    e.put(h, "%reals", STATE.H)
    e.put("1", "%counts", STATE.AFTER_REJECT, "i64")
    _bump(e, STATE.REJECTED, 1)


def _judge(
    e: Emitter, step: StepProgram, name: str, length: str, after: str, rtol: str, atol: str, rejected: str
) -> None:
    """Accept or reject a finite trial step by its error norm, and set the next step."""
    control: Any = step.control
    norm = e.value(f"call double @norm(ptr %work, double {rtol}, double {atol})")
    floored = e.value(f"call double @llvm.maximum.f64(double {norm}, double {literal(1e-10)})")
    shrink = e.value(f"call double @pow(double {floored}, double {literal(-(1 / control.exponent - 0.75 * control.memory))})")
    factor = e.value(f"fmul double {shrink}, {literal(control.safety)}")
    accepted = e.value(f"fcmp ole double {norm}, {literal(1.0)}")
    e.do(f"br i1 {accepted}, label %{name}.accept, label %{name}.reject")
    e.label(f"{name}.reject")
    bounded = e.value(f"call double @llvm.maximum.f64(double {factor}, double {literal(control.least)})")
    bounded = e.value(f"call double @llvm.minimum.f64(double {bounded}, double {literal(0.95)})")
    _reject(e, literal(float(Outcome.STEP_TOO_SMALL)), e.value(f"fmul double {length}, {bounded}"))
    e.jump(f"{name}.end")
    e.label(f"{name}.accept")
    if control.memory:
        previous = e.get("%reals", STATE.PREVIOUS)
        grown = e.value(f"call double @pow(double {previous}, double {literal(control.memory)})")
        factor = e.value(f"fmul double {factor}, {grown}")
    e.put(e.value(f"call double @llvm.maximum.f64(double {norm}, double {literal(1e-4)})"), "%reals", STATE.PREVIOUS)
    most = e.value(f"select i1 {rejected}, double {literal(1.0)}, double {literal(control.most)}")
    factor = e.value(f"call double @llvm.minimum.f64(double {factor}, double {most})")
    factor = e.value(f"call double @llvm.maximum.f64(double {factor}, double {literal(control.least)})")
    e.put(e.value(f"fmul double {length}, {factor}"), "%reals", STATE.H)
    e.put("0", "%counts", STATE.AFTER_REJECT, "i64")
    _accept(e, after)
    e.jump(f"{name}.end")
