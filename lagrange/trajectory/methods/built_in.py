"""Registration of this package's methods: each enters its name in the file of its family."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Maker = TypeVar("Maker", bound=Callable[..., Any])

_ENTERED: dict[str, dict[str, Callable[..., Any]]] = {}


def built_in(name: str) -> Callable[[Maker], Maker]:
    """Return a decorator that makes a function or class a method: `method="name"` calls it without arguments.

    The function or class is public as `lagrange.methods.X` under its own name X. The first line of its docstring is its
    row in the table of methods. The tests check its claims.
    """

    def enter(maker: Maker) -> Maker:
        _ENTERED.setdefault(maker.__module__, {})[name] = maker
        return maker

    return enter


def entered(family: str) -> dict[str, Callable[..., Any]]:
    """Return the constructors of the methods in the module `family`, by method name, in the order of the file."""
    return _ENTERED[family]
