"""A quantity of a model as a function for JAX, loaded from the text that files have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError
from lagrange.export.languages.jax import source
from lagrange.machine.model import Model
from lagrange.machine.python_source import defined
from lagrange.recipes.missing import missing
from lagrange.recipes.text import entries, quantity_program


@dataclass(frozen=True, eq=False)
class JaxFunction:
    """A quantity as a function of t, y (2n,) and p, for jax.jit, jax.grad and jax.vmap.

    `checked` returns (result, whether a mass matrix is singular), and `source` is the text that defines both.
    """

    function: Callable[[Any, Any, Any], Any]
    checked: Callable[[Any, Any, Any], Any]
    source: str

    def __repr__(self) -> str:
        return "<JaxFunction of (t, y, p)>"

    def __call__(self, t: Any, y: Any, p: Any) -> Any:
        """Return the quantity, NaN throughout where a mass matrix is singular."""
        return self.function(t, y, p)


def jax_function(model: Model, quantity: str) -> JaxFunction:
    """Return a quantity as a function; see `Model.as_jax`."""
    program = quantity_program(model, quantity)
    try:
        import jax
    except ImportError as error:
        raise missing("as_jax", "pip install jax", error) from error
    if not jax.config.jax_enable_x64:
        raise StatementError(
            "JAX computes in single precision, which has 7 digits: say jax.config.update('jax_enable_x64', True) "
            "before arrays are made, then model.as_jax()."
        )
    text = source(program, quantity, entries(model))
    function: Any = defined(text, quantity, {})
    return JaxFunction(function, function.__globals__[f"{quantity}_checked"], text)
