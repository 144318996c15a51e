"""Print a program for CasADi: a function that returns a `casadi.Function` of SX or MX symbols."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.export.target import register
from lagrange.export.traced import (
    ELIMINATION,
    OPERATORS,
    Library,
    TracedTarget,
    language,
)
from lagrange.procedure.spelling import Operator, call
from lagrange.statement.vocabulary.elementary import ELEMENTARY

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

HELPERS = {
    "min": '''\
def _min(a, b):
    """Return the smaller of two; NaN if either is, which ca.fmin passes over."""
    return ca.if_else(a <= b, a, ca.if_else(b <= a, b, float("nan")))''',
    "max": '''\
def _max(a, b):
    """Return the larger of two; NaN if either is, which ca.fmax passes over."""
    return ca.if_else(a >= b, a, ca.if_else(b >= a, b, float("nan")))''',
}

SYSTEMS = f"""
_where, _sqrt, _most = ca.if_else, ca.sqrt, ca.fmax
_both, _either = ca.logic_and, ca.logic_or


def _fixed(x):
    return x

{ELIMINATION}

def _factored(n, *lower):
    \"\"\"Return the factors of a symmetric matrix, given by its lower triangle, and whether it is singular.\"\"\"
    rows, units = _rows(n, lower)
    eliminated, singular = _eliminated(n, rows)
    return (units, eliminated), singular


def _solved(factors, *right):
    \"\"\"Return the solution of a linear system, a list.\"\"\"
    units, eliminated = factors
    scaled = [unit * b for unit, b in zip(units, right)]
    return [unit * x for unit, x in zip(units, _substituted(eliminated, scaled))]
"""

LANGUAGE = language("CasADi", OPERATIONS, HELPERS)

USE = """\
NAME() returns a casadi.Function of t, y and the parameters p, of SX symbols, and NAME(ca.MX) one of MX symbols; its
result is NaN throughout where a matrix is singular to round-off. NAME_checked() makes one with a second result, 1 where
it is singular and 0 elsewhere. Given numbers for p and symbols for y, a function of SX symbols leaves nothing to be
computed that depends on p alone."""

ALONE = """\
{name}() makes a casadi.Function of SX symbols, {name}(ca.MX) one of MX symbols. The result is NaN throughout where a
mass matrix is singular; {name}_checked() makes one with a second result, 1 where it is singular and 0 elsewhere."""

EVALUATED = '''\


def evaluated(make, times, states):
    """Yield the results at some states, a list for each, and whether a matrix is singular there."""
    function = make()
    for t, y in zip(times, states):
        result, singular = function(t, y, model.DEFAULT_PARAMETERS)
        yield result.T.elements(), float(singular) != 0.0'''


FUNCTIONS = '''\
def {name}_checked(kind=ca.SX):
    """Return a Function of t, y, p with {described}, and whether a mass matrix is singular."""
    inputs = t, *vectors = kind.sym("t"), kind.sym("y", {states}), kind.sym("p", {parameters})
    y, p = map(ca.vertsplit, vectors)
{body}
    result, singular = kind({results}), kind({singular})
    return ca.Function("{name}_checked", list(inputs), [result, singular], ["t", "y", "p"], ["{name}", "singular"])


def {name}(kind=ca.SX):
    """Return a Function of t, y, p with {described}; NaN where a mass matrix is singular."""
    inputs = kind.sym("t"), kind.sym("y", {states}), kind.sym("p", {parameters})
    result, singular = {name}_checked(kind)(*inputs)
    result = ca.if_else(singular, float("nan"), result)
    return ca.Function("{name}", list(inputs), [result], ["t", "y", "p"], ["{name}"])
'''


LIBRARY = Library(
    language=LANGUAGE,
    head="import casadi as ca",
    systems=SYSTEMS,
    functions=FUNCTIONS,
    results=("ca.vertcat(*results)",) * 2 + ("ca.reshape(ca.vertcat(*results), {0[1]}, {0[0]}).T",),
    use=USE,
    alone=ALONE,
    evaluated=EVALUATED,
)


@register
class CasADi(TracedTarget):
    """Target `casadi`: a Python module of CasADi functions, and its test."""

    name = "casadi"
    about = "CasADi: a Python module that makes a casadi.Function of each quantity, quantities only"
    library = LIBRARY
