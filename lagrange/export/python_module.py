"""Comments, names and default values that all exported Python modules have."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.export.comments import commented
from lagrange.export.descriptions import places
from lagrange.export.module import SourceModule


def named_places(module: SourceModule, array: str) -> Iterator[str]:
    """Yield lines: comments on the entries of the state and of an array of parameters, names and default values."""
    yield ""
    yield from commented(places("y", module.state), "#")
    yield from commented(places(array, module.parameters), "#")
    for name, names in (("STATE_NAMES", module.state), ("PARAMETER_NAMES", module.parameters)):
        yield f"{name} = {tuple(names)!a}"
    yield f"DEFAULT_PARAMETERS = {module.values!a}"
    yield ""
