"""Export to CasADi: functions that return a `casadi.Function` of SX or MX symbols."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.export.programs import filled
from lagrange.export.target import register
from lagrange.export.traced import ELIMINATION, OPERATORS, Library, TracedTarget, language
from lagrange.procedure.spelling import Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{op: call(f"ca.{op}({{0}})") for op in (*ELEMENTARY, "sqrt", "sign")},
    "abs": call("ca.fabs({0})"),
    "power": call("ca.power({0}, {1})"),
    "atan2": call("ca.atan2({0}, {1})"),
    "min": call("_min({0}, {1})"),
    "max": call("_max({0}, {1})"),
    "and": call("ca.logic_and({0}, {1})"),
    "or": call("ca.logic_or({0}, {1})"),
    "not": call("ca.logic_not({0})"),
    "select": call("ca.if_else({0}, {1}, {2})"),
}
"""CasADi function by operation."""

LIBRARY = Library(
    language("CasADi", OPERATIONS),
    systems=filled("casadi", "systems", elimination=ELIMINATION),
    results=("ca.vertcat(*results)",) * 2 + ("ca.reshape(ca.vertcat(*results), {0[1]}, {0[0]}).T",),
)


@register
class CasADi(TracedTarget):
    """Target `casadi`: a Python module of CasADi functions, and its test."""

    name = "casadi"
    about = "CasADi: a Python module that makes a casadi.Function of each quantity, quantities only"
    library = LIBRARY
