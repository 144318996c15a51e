"""Singular blocks of one unknown: the unknown is a quotient, so a zero divisor has to be tested separately."""

from __future__ import annotations

from dataclasses import replace

from lagrange.graph import node
from lagrange.machine.model import Model
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Array, Kind, Procedure
from lagrange.procedure.kernel.prepared import Prepared
from lagrange.program.program import Program

SOLVED = ("rhs", "accelerations", "jacobian")
"""The quantities that divide by entries of the matrix."""


def divisors(model: Model) -> Program | None:
    """Return a program of the matrix entries of blocks with one unknown, or None without any to test.

    An entry that is a nonzero constant is left out.
    """
    equations = model.equations
    alone = [equations.matrix[block[0]][block[0]] for block in equations.plan.blocks if len(block) == 1]
    entries = tuple(dict.fromkeys(one for one in alone if one.kind is not node.Kind.CONSTANT or not one.data))
    return model.function("divisors", entries).program if entries else None


def fixed(entries: Program, prepared: Prepared) -> list[int]:
    """Return the indices among the prepared numbers of the entries that depend on parameters alone."""
    slots, code = prepared.of_program(entries), entries.instructions
    return [
        code[ref].place if code[ref].op == "parameter" else slots[ref]
        for ref in entries.outputs
        if code[ref].op == "parameter" or ref in slots
    ]


def results_of(quantity: Procedure) -> int:
    """Return the number of results of a quantity."""
    (size,) = (one.type.size for one in quantity.parameters if one.name == "out" and isinstance(one.type, Array))
    assert size is not None
    return size


def guarded(quantity: Procedure, entries: Procedure) -> Procedure:
    """Return a quantity that also reports a singular matrix if a result is not finite and a divisor is zero.

    Formulas are simplified, so they need not compute the divisors; `entries` computes them.
    """
    p = Builder(quantity.name, quantity.about)
    t, y, held, out = (
        p.given(one.name, one.type) for one in quantity.parameters if isinstance(one.type, (Kind, Array))
    )
    formulas = replace(quantity, name=f"{quantity.name}_formulas")
    singular = p.variable(p.call(formulas, t, y, held, out), "singular")
    zero_or_nan = p.variable(p.constant(0.0, REAL), "zero_or_nan")
    with p.loop(0, results_of(quantity)) as k:
        zero_or_nan.value = zero_or_nan.value + 0.0 * out[k]
    with p.when(~zero_or_nan.value.equals(0.0), likely=False):
        count = results_of(entries)
        found = p.reserve(count, name="divisors")
        p.call(entries, t, y, held, found)
        with p.loop(0, count) as k:
            singular.value = singular.value | found[k].equals(0.0)
    p.leave(singular.value)
    return p.finish(FLAG)
