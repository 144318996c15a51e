"""Lists and dicts of formulas and names: subclasses of Python's own that a notebook shows as formulas."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from lagrange.errors import UnknownKey, listing, shown
from lagrange.show.notation.formula import SideWriter
from lagrange.show.notation.sections import Formula
from lagrange.show.notation.text import Notation
from lagrange.show.notebook.html_card import table
from lagrange.show.notebook.page_writer import PageWriter, Part, joined
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import MOST_WORDS
from lagrange.statement.scene.library import library
from lagrange.statement.statement import Statement


class EquationList(list[Any]):
    """A list of SymPy equations; a notebook shows it as formulas in the symbols of a statement."""

    def __init__(self, equations: Iterable[Any], statement: Statement) -> None:
        super().__init__(equations)
        self.statement = statement

    def __reduce__(self) -> tuple[Any, ...]:
        return EquationList, (list(self), self.statement)

    def _repr_markdown_(self) -> str:
        pairs = [(f"entry {k}", law.lhs, law.rhs) for k, law in enumerate(self)]
        return joined(_formulas(pairs, self.statement), "`print(...)` has it.")


class ExpressionDict(dict[Any, Any]):
    """A dict from symbols to SymPy expressions; a notebook shows it as formulas.

    `shown` maps a key to the left side of its formula, such as the acceleration of a coordinate.
    """

    def __init__(self, expressions: Mapping[Any, Any], statement: Statement, shown: Mapping[Any, Any]) -> None:
        super().__init__(expressions)
        self.statement, self.shown = statement, dict(shown)

    def __reduce__(self) -> tuple[Any, ...]:
        return ExpressionDict, (dict(self), self.statement, self.shown)

    def __missing__(self, key: Any) -> Any:
        raise UnknownKey(
            f"{shown(key)} is not a coordinate of this system: the keys are the coordinates "
            f"{listing(map(name_of, self), MOST_WORDS)} themselves, not their names."
        )

    def _repr_markdown_(self) -> str:
        rows = [(f"that of {key}", self.shown.get(key, key), value) for key, value in self.items()]
        return joined(_formulas(rows, self.statement), "`print(...)` has it.")


class ExpressionTuple(tuple[Any, ...]):
    """A tuple of SymPy expressions that prints in the spelling of scene files."""

    statement: Statement

    def __new__(cls, expressions: Iterable[Any], statement: Statement) -> ExpressionTuple:
        """Return the tuple, with the statement whose symbols the expressions contain."""
        entries = super().__new__(cls, expressions)
        entries.statement = statement
        return entries

    def __reduce__(self) -> tuple[Any, ...]:
        return ExpressionTuple, (tuple(self), self.statement)

    def written(self) -> list[str]:
        """Return the text of each expression, in the spelling of scene files."""
        return list(map(SideWriter(self.statement, Notation).setter.write, self))

    def __repr__(self) -> str:
        return f"({', '.join(self.written())}{',' * (len(self) == 1)})"


class SceneList(list[str]):
    """A list of the names of scenes; a notebook shows it with descriptions."""

    def __init__(self, names: Iterable[str], about: Iterable[str] = ()) -> None:
        super().__init__(names)
        self.about = tuple(about)

    def _repr_html_(self) -> str:
        return table(("scene", "about"), list(zip(self, self.about, strict=False)))


def scenes() -> list[str]:
    """Return the names of the scenes in the library."""
    entries = library()
    return SceneList((entry.name for entry in entries), (entry.about for entry in entries))


def _formulas(rows: Iterable[tuple[str, Any, Any]], statement: Statement) -> Iterator[Part]:
    """Yield formulas as parts of a page; `rows` has the name, the left side and the right side of each."""
    writer = PageWriter(statement)
    return ((name, writer.short(Formula(tuple(sides)), name, "`print(...)` has it.")) for name, *sides in rows)
