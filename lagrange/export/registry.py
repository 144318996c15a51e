"""Find a target of `System.export` by name or alias, and refuse models it cannot express."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.errors import StatementError, listing
from lagrange.export.languages import ALIASES
from lagrange.export.module import SourceModule
from lagrange.export.target import Target, every_target, target_names, target_of
from lagrange.show.notebook.html_card import table
from lagrange.statement.choice import one_of


class TargetTable(Mapping[str, str]):
    """A mapping from the name of each target to a line about it; prints as a table."""

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

    def _repr_html_(self) -> str:
        return table(("target", "about"), list(self._rows.items()))


def targets() -> TargetTable:
    """Return the targets of `System.export`, {name: a line about it}."""
    return TargetTable({name: target.about for name, target in every_target().items()})


def find(name: str) -> Target:
    """Return a target by name or alias. Raises StatementError for an unknown name, with the known ones."""
    known = target_names()
    if isinstance(name, str) and name not in known:
        name = ALIASES.get(name.lower(), name)
    return target_of(one_of(name, known, "there is no target {given}; the targets are {known}."))


def missing_operation(target: Target, module: SourceModule) -> tuple[str, str] | None:
    """Return the name of a quantity and of a function in it that a target cannot express, or None."""
    operations = ((quantity.name, each.op) for quantity in module.quantities for each in quantity.program.instructions)
    return next((pair for pair in operations if pair[1] in target.inexpressible), None)


def check_operations(target: Target, module: SourceModule) -> None:
    """Raise StatementError for a function that a target cannot express; the message names the targets that can."""
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, op = missing
        able = [name for name, other in every_target().items() if op not in other.inexpressible]
        raise StatementError(
            f"{quantity} of {module.name} contains {op}, which target {target.name!r} has no function for: "
            f"{listing(able)} have one."
        )
