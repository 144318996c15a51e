"""The refusal of a recipe whose package is not installed."""

from __future__ import annotations

from lagrange.errors import StatementError


def missing(method: str, command: str, error: ImportError) -> StatementError:
    """Return the error of a method without its package; it names the package, and the command that installs it."""
    package = command.rsplit(maxsplit=1)[-1]
    return StatementError(f"model.{method}() needs {package}, which cannot be imported ({error}): {command}")
