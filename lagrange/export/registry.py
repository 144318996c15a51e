"""The targets that there are, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.errors import StatementError, listing
from lagrange.export.languages import BUILT_IN
from lagrange.export.module import SourceModule
from lagrange.export.target import REGISTERED, Target, register
from lagrange.statement.choice import one_of

for built_in in BUILT_IN:
    register(built_in)


ALIASES: Mapping[str, str] = {
    **dict.fromkeys(("c99", "ansi-c"), "c"),
    **dict.fromkeys(("c++", "cxx", "c++17"), "cpp"),
    **dict.fromkeys(("js", "node", "es", "esm"), "javascript"),
    **dict.fromkeys(("rs",), "rust"),
    **dict.fromkeys(("numpy", "py"), "python"),
    **dict.fromkeys(("f90", "f08", "fortran2008"), "fortran"),
    **dict.fromkeys(("jl",), "julia"),
    **dict.fromkeys(("matlab", "m"), "octave"),
    **dict.fromkeys(("fmi", "fmi2", "fmi3"), "fmu"),
}
"""Other names that targets go by."""


class TargetTable(Mapping[str, str]):
    """The targets: each name with a line about it; prints as a table."""

    def __init__(self, rows: Mapping[str, str]) -> None:
        self._rows = dict(rows)

    def __getitem__(self, name: str) -> str:
        return self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __str__(self) -> str:
        wide = max(map(len, self._rows), default=0) + 2
        return "\n".join(f"{name:<{wide}}{about}" for name, about in self._rows.items())

    def __repr__(self) -> str:
        return str(self)


def targets() -> TargetTable:
    """Return the targets of `system.export`, each with a line about it."""
    return TargetTable({name: target.about for name, target in REGISTERED.items()})


def find(name: str) -> Target:
    """Return a target by name. Raises StatementError for an unknown one, with the list."""
    if isinstance(name, str) and name not in REGISTERED:
        name = ALIASES.get(name.lower(), name)
    return REGISTERED[one_of(name, REGISTERED, "there is no target {given}; the targets are {known}.")]


def check_operations(target: Target, module: SourceModule) -> None:
    """Raise StatementError for a function that a target cannot express, with the targets that can."""
    for quantity in module.quantities:
        for one in quantity.program.instructions:
            if one.op in target.inexpressible:
                able = [name for name, other in REGISTERED.items() if one.op not in other.inexpressible]
                raise StatementError(
                    f"{quantity.name} of {module.name} contains {one.op}, which target {target.name!r} has no function "
                    f"for: {listing(able)} have one."
                )
