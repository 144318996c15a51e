"""The visitor over the statements of procedures, and a table of the ids that each statement reads and defines.

Printers and all passes use it. A new statement is added to `form`, to the table here, and as a method to each visitor.
Defining a visitor class without a method for some statement raises an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar, get_args

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    VECTOR_STATEMENTS,
    Block,
    Procedure,
    Statement,
    inner,
    walk,
)


class Fields(NamedTuple):
    """Names of the fields of a statement that hold ids: ids that the statement reads, and ids that it defines."""

    read: tuple[str, ...] = ()
    defined: tuple[str, ...] = ()


FIELDS: Mapping[type, Fields] = {
    form.Let: Fields(("args",), ("ref",)),
    form.SineCosine: Fields(("angle", "angle"), ("sine", "cosine")),
    form.VectorLet: Fields(("args",), ("ref",)),
    form.Reduce: Fields(("vector",), ("ref",)),
    form.VectorLoad: Fields(("array", "place"), ("ref",)),
    form.Gather: Fields(("array", "places", "mask"), ("ref",)),
    form.VectorStore: Fields(("array", "place", "value", "mask")),
    form.Scatter: Fields(("array", "places", "value", "mask")),
    form.Reserve: Fields((), ("ref",)),
    form.ReserveRecord: Fields((), ("ref",)),
    form.Part: Fields(("array", "start"), ("ref",)),
    form.Load: Fields(("array", "place"), ("ref",)),
    form.Store: Fields(("array", "place", "value")),
    form.Read: Fields(("record",), ("ref",)),
    form.Write: Fields(("record", "value")),
    form.Declare: Fields(("value",)),
    form.Get: Fields((), ("ref",)),
    form.Set: Fields(("value",)),
    form.When: Fields(("condition",)),
    form.Loop: Fields(("start", "stop"), ("place",)),
    form.Repeat: Fields(("condition",)),
    form.Each: Fields(("iterations", "folds"), ("place", "folds")),
    form.Call: Fields(("callee", "args"), ("refs",)),
    form.Leave: Fields(("values",)),
    form.Note: Fields(),
}
"""Fields of every kind of statement. Variables are excluded. An angle counts as read twice, for its sine and cosine."""


def operands(statement: Statement) -> tuple[int, ...]:
    """Return the ids that a statement itself reads, without statements inside its blocks.

    Arrays and records that the statement writes to are included; variables are not.
    """
    return tuple(ref for name in FIELDS[type(statement)].read for ref in _numbers(getattr(statement, name)))


def defined(statement: Statement) -> tuple[int, ...]:
    """Return the ids that a statement itself defines, without statements inside its blocks."""
    refs: list[int] = []
    for name in FIELDS[type(statement)].defined:
        value = getattr(statement, name)
        refs += [fold.ref for fold in value] if name == "folds" else _numbers(value)
    return tuple(refs)


def _numbers(value: Any) -> Iterator[int]:
    """Yield the ids in the value of a statement's field. A called procedure contains none."""
    match value:
        case int():
            yield value
        case form.Fold(value=first, factor=second):
            yield first
            if second is not None:
                yield second
        case tuple():
            for part in value:
                yield from _numbers(part)
        case Procedure() | None:
            return


def reads(block: Block) -> frozenset[int]:
    """Return the ids that the statements of a block read, including inner blocks."""
    return frozenset(ref for statement in walk(block) for ref in operands(statement))


def uses_of(block: Block) -> dict[int, int]:
    """Return how often each id is used in a block, by id.

    A use inside a loop counts twice if the value is defined outside of the loop.
    """
    uses: dict[int, int] = {}
    for statement in block:
        for ref in operands(statement):
            uses[ref] = uses.get(ref, 0) + 1
        loops = isinstance(statement, (form.Loop, form.Repeat, form.Each))
        for body in inner(statement):
            made = frozenset(ref for child in walk(body) for ref in defined(child))
            for ref, count in uses_of(body).items():
                uses[ref] = uses.get(ref, 0) + (count if ref in made or not loops else 2 * count)
    return uses


def loop_depth(block: Block) -> int:
    """Return the greatest depth of nested loops in a block."""
    depths = (
        loop_depth(body) + isinstance(statement, (form.Loop, form.Each))
        for statement in block
        for body in inner(statement)
    )
    return max(depths, default=0)


Method = TypeVar("Method", bound=Callable[..., Any])


def visits(*kinds: type) -> Callable[[Method], Method]:
    """Mark a method as the visitor of some kinds of statements."""

    def marked(method: Method) -> Method:
        method.__dict__["visits"] = kinds
        return method

    return marked


class Visitor:
    """Base class of passes over a procedure: calls the method for the class of each statement.

    A subclass has one method for each class of statements, marked by `visits`. It needs no method for vectors if it
    only prints procedures without vectors.
    """

    _methods: ClassVar[Mapping[type, str]] = {}

    def __init_subclass__(cls) -> None:
        """Collect the methods of a subclass. Raises TypeError if a class of statements has none."""
        methods = {
            kind: name
            for base in reversed(cls.__mro__)
            for name, method in vars(base).items()
            for kind in getattr(method, "visits", ())
        }
        missing = [kind.__name__ for kind in get_args(Statement) if kind not in (*methods, *VECTOR_STATEMENTS)]
        if missing:
            raise TypeError(f"{cls.__name__} has no method for {', '.join(missing)}")
        cls._methods = methods

    def statement(self, statement: Statement) -> Any:
        """Call the method for the class of a statement, and return its result.

        Raises LagrangeError for a statement on vectors without a method.
        """
        if type(statement) not in self._methods:
            raise LagrangeError(f"{type(self).__name__} prints no vectors: build the procedure with single values.")
        return getattr(self, self._methods[type(statement)])(statement)
