"""Values of polynomials at many times, and the steps that are used on the way, each taken once."""

from __future__ import annotations

from lagrange.algorithm.dense.block import LANES, POLYNOMIAL, OwnStep
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Whole

CHUNK = 256
"""Most times on one step that are evaluated at once."""


@shared
def horner() -> Procedure:
    """Return the procedure that evaluates a polynomial by Horner's rule at fractions theta, two entries at once.

    The coefficient of power k and entry j has the index k * row + j * column.
    """
    p = Builder("horner", "Write the values of a polynomial, entries `stride` apart, at fractions of a step.")
    degree, dimension, row, column = (p.given(name, WHOLE) for name in ("degree", "dimension", "row", "column"))
    c, theta = p.array("c", read=True), p.array("theta", read=True, room=LANES)
    count, out, stride = p.given("count", WHOLE), p.array("out", room=LANES), p.given("stride", WHOLE)
    with p.loop(0, dimension, 2) as j:
        sources = [c.at(j * column), c.at((j + 1) * column)]
        targets = [out.at(j * stride), out.at((j + 1) * stride)]
        with p.each(count, width=LANES) as i:
            totals = [p.variable(source[degree * row]) for source in sources]
            with p.loop(0, degree) as k:
                place = (degree - 1 - k) * row
                for total, source in zip(totals, sources, strict=True):
                    total.value = p.fma(total.value, theta[i], source[place])
            for total, target in zip(totals, targets, strict=True):
                target[i] = total.value
    return p.finish()


@shared
def gather() -> Procedure:
    """Return the procedure that gathers steps of a run into a block, with the neighbour of each if `both` is not 0.

    The neighbour is the step before; of the first step it is the step after.
    """
    p = Builder("gather", "Write some steps of a run by columns, and the step beside each.")
    dimension, columns = p.given("dimension", WHOLE), p.given("columns", WHOLE)
    starts, steps = p.array("starts", WHOLE, read=True), p.given("steps", WHOLE)
    times, states = p.array("times", read=True), p.array("states", read=True)
    both, own, beside = p.given("both", WHOLE), p.array("own"), p.array("beside")
    with p.loop(0, columns) as b:
        s = starts[b]
        p.call(gather_one(), dimension, columns, b, s, times, states, own)
        with p.when(both.equals(1)):
            first = s.equals(0)
            there = p.choose(first, p.smaller(s + 1, steps - 1), s - 1)
            p.call(gather_one(), dimension, columns, b, there, times, states, beside)
            side = p.choose(steps.equals(1), 0.0, p.choose(first, 1.0, p.real(-1.0)))
            OwnStep(beside, dimension, columns).side[b] = side
    return p.finish()


@shared
def gather_one() -> Procedure:
    """Return the procedure that writes one step into a column of a block."""
    p = Builder("gather_one", "Write a step of a run into a column.")
    dimension, columns, b, s = (p.given(name, WHOLE) for name in ("dimension", "columns", "b", "s"))
    times, states, block = p.array("times", read=True), p.array("states", read=True), p.array("block")
    step = OwnStep(block, dimension, columns)
    step.t[b] = times[s]
    step.h[b] = times[s + 1] - times[s]
    step.side[b] = 0.0
    y, new = states.at(s * dimension), states.at((s + 1) * dimension)
    with p.loop(0, dimension) as j:
        place = j * columns + b
        step.y[place], step.new[place] = y[j], new[j]
    return p.finish()


@shared
def polynomials() -> Procedure:
    """Return the procedure that writes the coefficients of consecutive blocks of steps."""
    p = Builder("polynomials", "Write the polynomials of some steps of a run, block by block.")
    polynomial, given = p.function("polynomial", POLYNOMIAL), p.array("given", read=True)
    dimension, degree, columns = (p.given(name, WHOLE) for name in ("dimension", "degree", "columns"))
    both, steps = p.given("both", WHOLE), p.given("steps", WHOLE)
    times, states = p.array("times", read=True), p.array("states", read=True)
    starts, blocks = p.array("starts", WHOLE, read=True), p.given("blocks", WHOLE)
    own, beside, work, out = (p.array(name) for name in ("own", "beside", "work", "out"))
    with p.loop(0, blocks) as k:
        here = starts.at(k * columns)
        p.call(gather(), dimension, columns, here, steps, times, states, both, own, beside)
        polynomial(given, columns, own, beside, work, out.at((degree + 1) * dimension * columns * k))
    return p.finish()


@shared
def locate() -> Procedure:
    """Return the procedure that finds the step of a time from an earlier step on: the last one begun at or before it.

    Times rise with `sign` 1.0 and fall with -1.0. The search doubles its reach, and halves it again.
    """
    p = Builder("locate", "Return the last step, from one on, that begins at or before a time.")
    times, steps, step = p.array("times", read=True), p.given("steps", WHOLE), p.given("step", WHOLE)
    wanted, sign = p.given("wanted", REAL), p.given("sign", REAL)
    low, reach = p.variable(step, "low"), p.variable(1, "reach")

    def begun(place: Whole) -> Flag:
        past: Flag = (times[p.smaller(place, steps - 1)] - wanted) * sign <= 0.0
        inside: Flag = place < steps
        return past & inside

    with p.repeat(lambda: begun(low.value + reach.value)):
        low.value = low.value + reach.value
        reach.value = reach.value * 2
    with p.repeat(lambda: reach.value > 1):
        reach.value = reach.value // 2
        low.value = p.choose(begun(low.value + reach.value), low.value + reach.value, low.value)
    p.leave(low.value)
    return p.finish(WHOLE)


@shared
def outputs() -> Procedure:
    """Return the procedure that evaluates a run at many sorted times; the polynomial of a step is made once.

    The accepted states are exact; of two at one time that of the later step counts. `sign` is that of the run.
    """
    p = Builder("outputs", "Write the states at many times along a run, entries `stride` apart.")
    polynomial, given = p.function("polynomial", POLYNOMIAL), p.array("given", read=True)
    dimension, degree, columns = (p.given(name, WHOLE) for name in ("dimension", "degree", "columns"))
    both, steps = p.given("both", WHOLE), p.given("steps", WHOLE)
    times, states = p.array("times", read=True), p.array("states", read=True)
    wanted, count, sign = p.array("wanted", read=True), p.given("count", WHOLE), p.given("sign", REAL)
    out, stride = p.array("out", room=LANES), p.given("stride", WHOLE)
    own, beside, work, c = (p.array(name) for name in ("own", "beside", "work", "c"))
    starts, begins = p.reserve(LANES, WHOLE, name="starts"), p.reserve(LANES + 1, WHOLE, name="begins")
    place, step = p.variable(0, "place"), p.variable(0, "step")
    with p.repeat(lambda: place.value < count):
        used = p.variable(0, "used")
        with p.repeat(lambda: (used.value < columns) & (place.value < count)):
            step.value = p.call(locate(), times, steps, step.value, wanted[place.value], sign)
            starts[used.value], begins[used.value] = step.value, place.value
            used.value = used.value + 1
            end = times[step.value + 1]

            def within() -> Flag:
                here: Whole = place.value
                before: Flag = (wanted[p.smaller(here, count - 1)] - end) * sign < 0.0
                more: Flag = here < count
                return more & before

            place.value = place.value + 1
            with p.repeat(within):
                place.value = place.value + 1
        begins[used.value] = place.value
        last = used.value
        with p.loop(last, columns) as b:
            starts[b] = starts[last - 1]
        p.call(gather(), dimension, columns, starts, steps, times, states, both, own, beside)
        polynomial(given, columns, own, beside, work, c)
        with p.loop(0, last) as b:
            first, s = begins[b], starts[b]
            more = begins[b + 1] - first
            step_of = times.at(s), states.at(s * dimension)
            target = wanted.at(first), more, out.at(first), stride
            p.call(on_step(), degree, dimension, columns, c.at(b), *step_of, *target)
    return p.finish()


@shared
def on_step() -> Procedure:
    """Return the procedure that evaluates one step at times in it; accepted states are copied exactly."""
    p = Builder("on_step", "Write the states at times of one step.")
    degree, dimension, columns = (p.given(name, WHOLE) for name in ("degree", "dimension", "columns"))
    c, times, states = (p.array(name, read=True, room=LANES) for name in ("c", "times", "states"))
    wanted, count = p.array("wanted", read=True), p.given("count", WHOLE)
    out, stride = p.array("out", room=LANES), p.given("stride", WHOLE)
    theta = p.reserve(CHUNK, room=LANES, name="theta")
    t, end = times[0], times[1]
    h = end - t
    with p.loop(0, count, CHUNK) as begin:
        part = p.smaller(count - begin, CHUNK)
        here = wanted.at(begin)
        p.note(
            "Whole vectors are computed: what stands behind the last must not be slow to multiply, as denormals are."
        )
        behind = theta.at(part)
        with p.each(LANES, width=LANES, spill=True) as i:
            behind[i] = 0.0
        with p.loop(0, part) as i:
            theta[i] = (here[i] - t) / h
        strides = dimension * columns, columns
        p.call(horner(), degree, dimension, *strides, c, theta, part, out.at(begin), stride)
    lowest, highest = p.variable(0, "lowest"), p.variable(count, "highest")
    with p.repeat(lambda: (lowest.value < highest.value) & wanted[p.larger(highest.value - 1, 0)].equals(end)):
        highest.value = highest.value - 1
        _copy(p, states.at(dimension), dimension, out.at(highest.value), stride)
    with p.repeat(lambda: (lowest.value < highest.value) & wanted[p.smaller(lowest.value, count - 1)].equals(t)):
        _copy(p, states, dimension, out.at(lowest.value), stride)
        lowest.value = lowest.value + 1
    return p.finish()


def _copy(p: Builder, state: Memory, dimension: Whole, out: Memory, stride: Whole) -> None:
    with p.loop(0, dimension) as j:
        out[j * stride] = state[j]
