"""Names of what a store has of each member, and of what a table or a data set has."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lagrange.errors import StatementError
from lagrange.members.keep import OUTPUTS, STATE, Column

MEMBER, CHECKSUM, BLOCK, VARIABLE = "member", "checksum", "block", "variable"
"""Dimension of the members; in a store the variable with checksums of each block of them, and its two dimensions."""

OVER = "÷"
"""Stands for a slash in a name of a store, where a slash would divide folders."""


def stored_names(column: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the variables that a column is stored as: one for each entry of a state, by its name."""
    if column == STATE:
        return tuple(f"{name}_end" for name in names)
    return names if column == OUTPUTS else (column.replace("/", OVER),)


def start_name(label: str, names: Collection[str]) -> str:
    """Return the name of the values with which something varies, where a state has its own."""
    return f"{label}_start" if label in names else label


def check_names(columns: Sequence[Column], names: Sequence[str], labels: Sequence[str], *, store: bool) -> None:
    """Refuse a coordinate or a varying parameter that has the name of something else that is kept of each member."""
    kept = {column.name for column in columns}
    taken = {MEMBER, *kept - {STATE, OUTPUTS}, *((CHECKSUM,) if store else ())}
    taken.update(
        dimension for column in columns if column.name not in (STATE, OUTPUTS) for dimension in column.dimensions
    )
    taken.update(f"{name}_start" for name in names if name in labels)
    if STATE in kept:
        taken.update(f"{name}_end" for name in names)
    own = [*(names if kept & {STATE, OUTPUTS} else ()), *labels]
    twice = next((name for name in own if name in taken), None)
    if twice is not None:
        raise StatementError(
            f"{twice} is a name of the system, and the results of an ensemble have one of this name: give the system "
            "another name for it, or keep something else."
        )
