"""Functions of generated code: one that prepares parameters, and one for each quantity, such as the energy.

    prepare(parameters, p)             p = the parameters, then the results that depend only on them
    prepare(p)                         the same for an array that begins with the parameters
    name(t, y, p, out)                 the results of a program at a time and a state
    name_by_value(t, y0, ..., p)       the same as values, for callers that keep a state in registers or in rows

Each function returns True if a matrix is singular within rounding; its results are then invalid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import or_
from typing import Any

from lagrange.algorithm.kernel.body import SOURCE, Body, Inputs, PreparedLayout, Style
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Array, Procedure
from lagrange.procedure.front.decorators import procedure
from lagrange.procedure.front.vocabulary import In, Out, generated, reals, unlikely
from lagrange.program.program import Instruction, Program

ZERO_CONSTANT = Instruction("constant")

MANY_ZEROS = 32
"""Least number of results that are always zero, at which generated code first clears all results in a loop. Many single
stores are slow to compile.
"""


def cleared_outputs(program: Program) -> frozenset[int]:
    """Return the indices of outputs that are always zero; an empty set for fewer than `MANY_ZEROS`.

    Code then clears all outputs in a loop first.
    """
    zeros = [index for index, ref in enumerate(program.outputs) if program.instructions[ref] == ZERO_CONSTANT]
    return frozenset(zeros if len(zeros) >= MANY_ZEROS else ())


def prepare(
    prepared: PreparedLayout,
    about: str,
    *,
    name: str = "prepare",
    in_place: bool = False,
    names: Mapping[int, str] | None = None,
    divisors: Sequence[int] = (),
    style: Style = SOURCE,
) -> Procedure:
    """Return the procedure `name`, which computes all numbers that depend only on parameters.

    It writes the parameters, then these numbers, in the layout `prepared`. `about` is its comment. With
    `in_place` the array contains the parameters already. `names` are the names of values in printed code, by
    index of the instruction. `divisors` are the indices in the array of matrices of size one: a zero there is a
    singular matrix.
    """
    p = Builder(name, about)
    program = prepared.program
    parameters = None if in_place else p.array("parameters", size=program.parameters, read=True)
    out = p.array("p", size=prepared.size)
    array = out if parameters is None else parameters
    body = Body(p, program, Inputs(array, {}, names=names or {}, largest=prepared.largest), style)
    if parameters is not None:
        known = {code.place: ref for ref, code in enumerate(program.instructions) if code.op == "parameter"}
        for k in range(program.parameters):
            out[k] = body.value(known[k]) if k in known else parameters[k]
    body.run(range(program.hoisted))
    for ref, slot in prepared.saved.items():
        body.save(ref, out, slot)
    tests = [*([] if body.singular is None else [body.singular.value]), *(out[k].equals(0.0) for k in divisors)]
    p.leave(reduce(or_, tests) if tests else p.false)
    return p.finish(FLAG)


def kernel(
    program: Program,
    prepared: PreparedLayout,
    name: str,
    about: str,
    *,
    names: Mapping[int, str] | None = None,
    style: Style = SOURCE,
) -> Procedure:
    """Return the procedure `name` that evaluates a program at a time and a state, with the comment `about`.

    `prepared` is the layout of its argument p, the parameters and the results that depend only on them.
    `names` are the names of values in printed code, by index of the instruction.
    """
    p = Builder(name, about)
    t, y = p.given("t", REAL), p.array("y", size=program.states, read=True)
    held, out = p.array("p", size=prepared.size, read=True), p.array("out", size=len(program.outputs))
    slots = prepared.of_program(program)
    inputs = Inputs(held, slots, t, y, names or {}, prepared.largest)
    body = Body(p, program, inputs, style)
    body.run(range(program.hoisted, len(program.instructions)))
    cleared = cleared_outputs(program)
    if cleared:
        with p.each(len(program.outputs), width=1) as k:
            out[k] = 0.0
    for index, ref in enumerate(program.outputs):
        if index not in cleared:
            out[index] = p.real(body.value(ref))
    p.leave(body.failed)
    return p.finish(FLAG)


def kernel_by_value(
    program: Program, prepared: PreparedLayout, outputs: Sequence[int], *, style: Style, suffix: str = "by_value"
) -> Procedure:
    """Return a procedure that evaluates a program, with states and results passed by value.

    Its arguments are the time, the entries of the state, and the prepared array. It returns the results of the
    instructions `outputs`, and the flag of a singular matrix.
    """
    p = Builder(f"{program.name}_{suffix}", f"Evaluate {program.name} by value.")
    t, state = p.given("t", REAL), [p.given(f"y{i}", REAL) for i in range(program.states)]
    held = p.array("p", size=prepared.size, read=True)
    body = Body(p, program, Inputs(held, prepared.of_program(program), t, largest=prepared.largest), style)
    for ref, instruction in enumerate(program.instructions):
        if instruction.op == "state":
            body.values[ref] = state[instruction.place]
    body.run(range(program.hoisted, len(program.instructions)))
    results = [p.real(body.value(ref)) for ref in outputs]
    p.leave(*results, body.failed)
    return p.finish(*[REAL] * len(results), FLAG)


def kernel_through_values(program: Program, prepared: PreparedLayout, by_value: Procedure) -> Procedure:
    """Return a procedure that evaluates a program from a state in memory, by calling `by_value`.

    It writes the returned results to memory. A result that is an entry of the state is copied.
    """
    p = Builder(program.name, f"Evaluate {program.name} in memory.")
    t, y = p.given("t", REAL), p.array("y", size=program.states, read=True)
    held, out = p.array("p", size=prepared.size, read=True), p.array("out", size=len(program.outputs))
    state = [y[i] for i in range(program.states)]
    *results, singular = p.call(by_value, t, *state, held)
    values = iter(results)
    outputs = [(block.name, ref) for block in program.results for ref in program.part(block.name)]
    for index, (name, ref) in enumerate(outputs):
        out[index] = next(values) if name in program.returned else state[program.instructions[ref].place]
    p.leave(singular)
    return p.finish(FLAG)


def results_of(quantity: Procedure) -> int:
    """Return the number of entries that the procedure `quantity` writes to its argument `out`."""
    (size,) = (p.type.size for p in quantity.parameters if p.name == "out" and isinstance(p.type, Array))
    assert size is not None
    return size


def guarded(quantity: Procedure, entries: Procedure) -> Procedure:
    """Return the procedure `quantity` with a test for zero divisors, reported as a singular matrix.

    The divisors are tested only if a result is not finite. They are computed by the procedure `entries`,
    because the simplified formulas of the quantity need not contain them.
    """
    formulas = replace(quantity, name=f"{quantity.name}_formulas")
    return replace(guarded_quantity.form(formulas=formulas, entries=entries), name=quantity.name, about=quantity.about)


def array_of(name: str) -> Callable[[Procedure], Any]:
    """Return a function that takes a procedure and returns the type of its parameter `name`, for `@procedure(...)`."""
    return lambda formulas: next(parameter.type for parameter in formulas.parameters if parameter.name == name)


@procedure(y=array_of("y"), p=array_of("p"), out=array_of("out"))
def guarded_quantity(t: float, y: In, p: In, out: Out, *, formulas: Procedure, entries: Procedure) -> bool:
    """Write a quantity to `out` by the procedure `formulas`. Return True if a matrix is singular.

    t and y are the time and the state. p has the parameters and the values that depend only on them. A matrix also
    counts as singular if a result is not finite and one of the divisors, which the procedure `entries` computes, is
    zero.
    """
    singular: bool = generated(formulas, t, y, p, out)
    zero_or_nan = 0.0
    for k in range(results_of(formulas)):
        zero_or_nan += 0.0 * out[k]
    if unlikely(zero_or_nan != 0.0):
        divisors = reals(results_of(entries))
        generated(entries, t, y, p, divisors)
        for k in range(results_of(entries)):
            divisor = divisors[k]
            singular = singular or divisor == 0.0
    return singular
