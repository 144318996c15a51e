"""Print a program for JAX: a function that `jax.jit`, `jax.grad` and `jax.vmap` take, in double precision."""

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

LARGEST_TRACED = 4
"""Largest order of a matrix that is eliminated entry by entry; a larger one goes to LAPACK. In a batch, order 2 takes
30 ns instead of 290, order 4 200 instead of 520. Order 6 takes as long either way, and five times as long to
compile."""

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{function.name: call(f"jnp.{function.array_name}({{0}})") for function in ELEMENTARY.values()},
    **{op: call(f"_{op}({{0}})") for op in ("log", "sinh", "cosh", "tanh", "atanh")},
    **{op: call(f"jnp.{op}({{0}})") for op in ("sqrt", "abs", "sign")},
    "power": call("jnp.power({0}, {1})"),
    "atan2": call("jnp.arctan2({0}, {1})"),
    "erf": call("jax.scipy.special.erf({0})"),
    "min": call("jnp.minimum({0}, {1})"),
    "max": call("jnp.maximum({0}, {1})"),
    "and": call("jnp.logical_and({0}, {1})"),
    "or": call("jnp.logical_or({0}, {1})"),
    "not": call("jnp.logical_not({0})"),
    "select": call("jnp.where({0}, {1}, {2})"),
}
"""JAX function by operation."""

HEAD = """\
import jax
import jax.numpy as jnp"""

HELPERS = {
    "log": '''\
def _log(x):
    """Return log x. XLA takes log(a ** b) for b log(abs(a)), and log(sqrt(a)) alike: not where it sees neither."""
    return jnp.log(jnp.where(x >= 0.0, x, jnp.nan))''',
    "sinh": '''\
def _sinh(x):
    """Return sinh x to 3 ulp; jnp.sinh is off by 4 for small x, and by a third of x for large."""
    small, half = jnp.abs(x) < 1.0, jnp.exp(0.5 * x)
    inner, series = jnp.where(small, x, 0.0), 1.0
    for k in range(9, 0, -1):
        series = 1.0 + inner * inner / (2 * k * (2 * k + 1)) * series
    return jnp.where(small, inner * series, 0.5 * half * half - 0.5 / half / half)''',
    "cosh": '''\
def _cosh(x):
    """Return cosh x to 3 ulp; jnp.cosh is off by as many ulp as a third of x."""
    half = jnp.exp(0.5 * x)
    return 0.5 * half * half + 0.5 / half / half''',
    "tanh": '''\
def _tanh(x):
    """Return tanh x to 3 ulp; jnp.tanh is off by 6 where x is near 19."""
    large = jnp.abs(x) > 1.0
    rest = 1.0 - 2.0 / (jnp.exp(2.0 * jnp.abs(jnp.where(large, x, 2.0))) + 1.0)
    return jnp.where(large, jnp.sign(x) * rest, jnp.tanh(jnp.where(large, 0.0, x)))''',
    "atanh": '''\
def _atanh(x):
    """Return atanh x to 3 ulp; jnp.arctanh is off by a hundred where x is near 0.41."""
    size = jnp.where(x < 0.0, -x, x)
    found = 0.5 * jnp.log1p(2.0 * size / (1.0 - size))
    return jnp.where(x < 0.0, -found, found)''',
}

SYSTEMS = f"""
_where, _most, _sqrt, _fixed = jnp.where, jnp.maximum, jnp.sqrt, jax.lax.stop_gradient
_both, _either = jnp.logical_and, jnp.logical_or
{ELIMINATION}

def _factored(n, *lower):
    \"\"\"Return the factors of a symmetric matrix, given by its lower triangle, and whether it is singular.\"\"\"
    if n <= {LARGEST_TRACED}:
        rows, units = _rows(n, lower)
        eliminated, singular = _eliminated(n, rows)
        return (units, eliminated), singular
    i, j = jnp.indices((n, n))
    entries = jnp.stack([jnp.asarray(x, jnp.float64) for x in lower])
    a = entries[jnp.maximum(i, j) * (jnp.maximum(i, j) + 1) // 2 + jnp.minimum(i, j)]
    diagonal = jnp.diagonal(a)
    inert = jnp.abs(diagonal) > 0.0
    units = jnp.where(inert, 1.0 / jnp.sqrt(jnp.where(inert, jnp.abs(diagonal), 1.0)), 0.0)
    for _ in range(2):
        sizes = (jnp.abs(a) * units).max(axis=1)
        units = jnp.where((units == 0.0) & (sizes > 0.0), 1.0 / jnp.where(sizes > 0.0, sizes, 1.0), units)
    units = _fixed(jnp.where(units == 0.0, 1.0, units))
    a = units[:, None] * a * units
    largest = jnp.where(inert, 1.0, 1.0 / PREFERENCE)
    lu, exchanges = jax.scipy.linalg.lu_factor(a / largest[:, None])
    vanishes = (jnp.abs(jnp.diagonal(lu)) <= PIVOT).any()
    return (units, (lu, exchanges), largest), vanishes


def _solved(factors, *right):
    \"\"\"Return the solution of a linear system, a list.\"\"\"
    units = factors[0]
    if isinstance(units, list):
        scaled = [unit * b for unit, b in zip(units, right)]
        return [unit * x for unit, x in zip(units, _substituted(factors[1], scaled))]
    b = jnp.stack([jnp.asarray(x, jnp.float64) for x in right])
    return list(units * jax.scipy.linalg.lu_solve(factors[1], units * b / factors[2]))
"""

LANGUAGE = language("JAX", OPERATIONS, HELPERS)

USE = """\
NAME(t, y, p) returns a quantity for y of shape (STATE,) and parameters p of shape (PARAMETERS,); NaN throughout where a
matrix is singular to round-off. NAME_checked(t, y, p) returns (result, whether it is singular). Both are functions of
arrays alone: take jax.jit, jax.grad, jax.jacfwd and jax.vmap of them. What depends on p alone is computed once for a
batch of states where p is not in the batch: jax.vmap(rhs, (None, 0, None))."""

ALONE = """\
It is in double precision: jax.config.update("jax_enable_x64", True) comes first. The result is NaN throughout where a
mass matrix is singular; {name}_checked returns (result, whether it is singular)."""

EVALUATED = '''\
import jax
import jax.numpy as jnp


def evaluated(function, times, states):
    """Return the results at some states, a list for each, and whether a matrix is singular there."""
    batch = jax.jit(jax.vmap(function, (0, 0, None)))
    results, singular = batch(jnp.array(times), jnp.array(states), jnp.array(model.DEFAULT_PARAMETERS))
    return zip(results.reshape(len(times), -1).tolist(), singular.tolist())'''


FUNCTIONS = '''\
def {name}_checked(t, y, p):
    """Return {described}, and whether a mass matrix is singular."""
    t, y, p = (jnp.asarray(x, jnp.float64) for x in (t, y, p))
    if t.shape or y.shape != ({states},) or p.shape != ({parameters},):
        raise ValueError(f"t, y, p have the shapes {{t.shape}}, {{y.shape}}, {{p.shape}}: give {shapes} (see jax.vmap)")
{body}
    return {results}, jnp.asarray({singular})


def {name}(t, y, p):
    """Return {described}; NaN throughout where a mass matrix is singular."""
    result, singular = {name}_checked(t, y, p)
    return jnp.where(singular, jnp.nan, result)
'''


LIBRARY = Library(
    language=LANGUAGE,
    head=HEAD,
    systems=SYSTEMS,
    functions=FUNCTIONS.replace("{shapes}", "(), ({states},), ({parameters},)"),
    results=("jnp.stack(results).reshape({0!r})", "jnp.stack(results)", "jnp.stack(results).reshape({0!r})"),
    use=USE,
    alone=ALONE,
    evaluated=EVALUATED,
    setting='jax.config.update("jax_enable_x64", True)  # double precision, for all of JAX in this process',
)


@register
class Jax(TracedTarget):
    """Target `jax`: a Python module of JAX functions, and its test."""

    name = "jax"
    about = "JAX: a Python module of functions for jax.jit, jax.grad and jax.vmap, quantities only"
    library = LIBRARY
