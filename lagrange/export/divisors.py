"""Singular matrices of one unknown: a division finds what stands alone, and says nothing where its divisor vanishes."""

from __future__ import annotations

from dataclasses import replace

from lagrange.machine.model import Model
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Array, Kind, Procedure
from lagrange.program.program import Program

SOLVED = ("rhs", "accelerations", "jacobian")
"""The quantities that divide by entries of the matrix."""


def divisors(model: Model) -> Program | None:
    """Return a program of the entries by which a system divides for unknowns that stand alone, None without any."""
    equations = model.equations
    alone = tuple(block[0] for block in equations.plan.blocks if len(block) == 1)
    return model.function("divisors", tuple(equations.matrix[k][k] for k in alone)).program if alone else None


def results_of(quantity: Procedure) -> int:
    """Return how many results a quantity has."""
    (size,) = (one.type.size for one in quantity.parameters if one.name == "out" and isinstance(one.type, Array))
    assert size is not None
    return size


def guarded(quantity: Procedure, entries: Procedure) -> Procedure:
    """Return a quantity that is singular as well where a result is not finite and one of the divisors is zero.

    Formulas are simplified, so that the divisors themselves need not be among what they compute.
    """
    p = Builder(quantity.name, quantity.about)
    t, y, held, out = (
        p.given(one.name, one.type) for one in quantity.parameters if isinstance(one.type, (Kind, Array))
    )
    formulas = replace(quantity, name=f"{quantity.name}_formulas")
    singular = p.variable(p.call(formulas, t, y, held, out), "singular")
    nothing = p.variable(p.constant(0.0, REAL), "nothing")
    with p.loop(0, results_of(quantity)) as k:
        nothing.value = nothing.value + 0.0 * out[k]
    with p.when(~nothing.value.equals(0.0), likely=False):
        count = results_of(entries)
        found = p.reserve(count, name="divisors")
        p.call(entries, t, y, held, found)
        with p.loop(0, count) as k:
            singular.value = singular.value | found[k].equals(0.0)
    p.leave(singular.value)
    return p.finish(FLAG)
