"""Export to JAX: functions in double precision for `jax.jit`, `jax.grad` and `jax.vmap`."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.export.programs import filled
from lagrange.export.target import register
from lagrange.export.traced import ELIMINATION, OPERATORS, Library, TracedTarget, language
from lagrange.procedure.spelling import Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

LARGEST_TRACED = 4
"""Largest order of a matrix that is eliminated by written-out formulas; LAPACK solves larger systems. In a batch,
formulas take 30 ns instead of 290 for order 2, and 200 ns instead of 520 for order 4. For order 6 they take as long as
LAPACK, and five times as long to compile."""

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

LIBRARY = Library(
    language("JAX", OPERATIONS),
    systems=filled("jax", "systems", elimination=ELIMINATION, largest=LARGEST_TRACED),
    results=("jnp.stack(results).reshape({0!r})", "jnp.stack(results)", "jnp.stack(results).reshape({0!r})"),
    setting='jax.config.update("jax_enable_x64", True)  # double precision, for all of JAX in this process',
)


@register
class Jax(TracedTarget):
    """Target `jax`: a Python module of JAX functions, and its test."""

    name = "jax"
    about = "JAX: a Python module of functions for jax.jit, jax.grad and jax.vmap, quantities only"
    library = LIBRARY
