"""What modules of Python have in common, whatever computes in them: comments, names and numbers."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.export.comments import commented, plain
from lagrange.export.descriptions import places
from lagrange.export.module import SourceModule
from lagrange.machine.python_source import literal
from lagrange.procedure.form import REAL


def number(value: float) -> str:
    """Return a double with all its digits."""
    return literal(REAL, value)[1]


def statement_comment(module: SourceModule) -> list[str]:
    """Return the comment at the top: the statement that the file was made from."""
    return [f"# {plain(line)}".rstrip() for line in module.statement]


def named_places(module: SourceModule, array: str) -> Iterator[str]:
    """Yield comments on the places of the state and of an array of parameters, their names and default values."""
    yield ""
    yield from commented(places("y", module.state), "#")
    yield from commented(places(array, module.parameters), "#")
    for name, names in (("STATE_NAMES", module.state), ("PARAMETER_NAMES", module.parameters)):
        yield f"{name} = {tuple(names)!a}"
    yield f"DEFAULT_PARAMETERS = {module.values!a}"
    yield ""
