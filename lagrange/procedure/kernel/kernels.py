"""Programs as procedures that share one array of prepared numbers.

    prepare(parameters, p)     p = the parameters, and behind them what depends on them alone
    name(t, y, p, out)         the results of a program at a time and a state

Each says whether a matrix is singular to round-off: `out` is then not to be used.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import or_

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.kernel.body import Body, Inputs
from lagrange.procedure.kernel.prepared import Prepared
from lagrange.program.program import Program


def prepare(
    prepared: Prepared, about: str, *, parameter_names: Sequence[str] = (), divisors: Sequence[int] = ()
) -> Procedure:
    """Return what writes the parameters and all hoisted results.

    `divisors` are places of results that are matrices of one unknown: one that is zero is singular.
    """
    p = Builder("prepare", about)
    program = prepared.program
    parameters, out = p.array("parameters", size=program.parameters, read=True), p.array("p", size=prepared.size)
    body = Body(p, program, Inputs(parameters, {}, parameter_names=parameter_names))
    known = {one.place: ref for ref, one in enumerate(program.instructions) if one.op == "parameter"}
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
    prepared: Prepared,
    name: str,
    about: str,
    *,
    state_names: Sequence[str] = (),
    parameter_names: Sequence[str] = (),
) -> Procedure:
    """Return what evaluates a program. `state_names` are those of its inputs, for people who read the code."""
    p = Builder(name, about)
    t, y = p.given("t", REAL), p.array("y", size=program.states, read=True)
    held, out = p.array("p", size=prepared.size, read=True), p.array("out", size=len(program.outputs))
    slots = prepared.of_program(program)
    body = Body(p, program, Inputs(held, slots, t, y, state_names, parameter_names))
    body.run(range(program.hoisted, len(program.instructions)))
    for place, ref in enumerate(program.outputs):
        out[place] = p.real(body.value(ref))
    p.leave(p.false if body.singular is None else body.singular.value)
    return p.finish(FLAG)
