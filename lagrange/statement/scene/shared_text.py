"""SymPy to text, symbol for symbol, with a definition for each long part that occurs more than once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import sympy
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And, BooleanAtom, Not, Or

from lagrange.errors import formula
from lagrange.statement.scene.guard import RefusalError
from lagrange.statement.scene.lexer import LONGEST_EVALUATED
from lagrange.statement.scene.unevaluated import FLOAT, PRODUCT, SUM
from lagrange.statement.vocabulary.words import WORDS

SHARED = 40
"""Smallest length, in characters, of a part that gets a definition because it occurs twice."""

LONG_PART = 400
"""Largest number of characters of a part inside another one. A longer part has a definition."""

DEEP = 12
"""Largest number of levels of a part; each has at most four of the `expressions.DEEPEST` levels. A deeper part has a
definition."""

IF, TERM, FACTOR, BASE, ATOM = range(5)
"""Binding strength of the outermost operation of a text, weakest first."""

_NAMES = {word.build: name for name, word in WORDS.items() if isinstance(word.build, type)}
_LOGIC = {And: " and ", Or: " or "}


class Text(NamedTuple):
    """The text of a part, its binding strength, and the levels of parts in it."""

    text: str
    strength: int = ATOM
    depth: int = 0

    def at(self, least: int) -> str:
        """Return the text, in parentheses if it binds weaker than `least`."""
        return self.text if self.strength >= least else f"({self.text})"


class SharedText:
    """Writes expressions as texts, and definitions of their shared parts: `definitions` has them in order of use.

    `leaves` maps symbols and functions of time to their texts. Raises RefusalError for a part without a text.
    """

    def __init__(self, roots: Iterable[Any], leaves: Mapping[Any, str], taken: Iterable[str]) -> None:
        self.definitions: dict[str, str] = {}
        self._known = {leaf: Text(text) for leaf, text in leaves.items()}
        self._leaves = frozenset(leaves)
        self._uses = self._counted(roots)
        self._prefix = next(prefix for prefix in _prefixes() if not any(name.startswith(prefix) for name in taken))
        self._kinds: tuple[tuple[Any, Callable[[Any], Text]], ...] = (
            (sympy.Number, _number),
            (sympy.Add, self._sum),
            (sympy.Mul, self._product),
            (sympy.Pow, self._power),
            (tuple(_NAMES), self._call),
            (Relational, self._relation),
            (sympy.core.numbers.Pi, lambda _: Text("pi")),
            (sympy.core.numbers.Exp1, lambda _: Text("exp(1)")),
            (sympy.Piecewise, self._branches),
            ((And, Or), self._logic),
            (Not, lambda node: Text(f"not {self._part(node.args[0]).at(ATOM)}", IF)),
            (BooleanAtom, lambda node: Text(str(bool(node)))),
            (ITE, self._choice),
            (AppliedUndef, self._function),
        )

    def text(self, expression: Any) -> str:
        """Return the text of an expression. Definitions of its parts are added first."""
        for node in self._parts_first(expression):
            self._known[node] = self._entry(node, root=node is expression)
        return self._known[expression].text

    def _counted(self, roots: Iterable[Any]) -> dict[Any, int]:
        """Count the occurrences of each distinct part, inside others and as a whole expression."""
        uses: dict[Any, int] = {}
        todo = list(roots)
        while todo:
            node = todo.pop()
            uses[node] = uses.get(node, 0) + 1
            if uses[node] == 1 and node not in self._leaves:
                todo.extend(node.args)
        return uses

    def _parts_first(self, expression: Any) -> Iterable[Any]:
        todo = [expression] if expression not in self._known else []
        while todo:
            node = todo[-1]
            inside = () if isinstance(node, (sympy.Derivative, sympy.Subs)) else node.args
            fresh = [part for part in inside if part not in self._known]
            if fresh:
                todo.extend(fresh)
                continue
            todo.pop()
            if node not in self._known:
                yield node

    def _entry(self, node: Any, *, root: bool) -> Text:
        """Return the text of a node inside other texts: its own text, or the name of its definition."""
        if isinstance(node, ExprCondPair):
            return Text("")
        write = next((write for kind, write in self._kinds if isinstance(node, kind)), None)
        if write is None:
            raise RefusalError(f"{formula(node, 60)}, which has no name in a scene")
        entry = write(node)
        shared = self._uses.get(node, 0) > 1 and len(entry.text) >= SHARED
        alone = root and self._uses.get(node, 0) == 1
        return self._defined(entry) if not alone and (shared or entry.depth > DEEP) else entry

    def _defined(self, entry: Text) -> Text:
        name = f"{self._prefix}{len(self.definitions) + 1}"
        self.definitions[name] = entry.text
        return Text(name)

    def _part(self, node: Any) -> Text:
        """Return the text of a part of another node, the name of its definition if it is long."""
        entry = self._known[node]
        if len(entry.text) > LONG_PART:
            entry = self._known[node] = self._defined(entry)
        return entry

    def _joined(self, parts: list[Text], text: str, strength: int) -> Text:
        return Text(text, strength, 1 + max((part.depth for part in parts), default=0))

    def _sum(self, node: Any) -> Text:
        parts = [self._part(term) for term in node.args]
        if isinstance(node.args[0], sympy.Add) and parts[0].strength < ATOM:
            return self._listed(SUM, parts)
        text = parts[0].at(TERM)
        for term, part in zip(node.args[1:], parts[1:], strict=True):
            minus = part.text.startswith("-") and _is_signed(term, part)
            text += f" - {part.text[1:]}" if minus else f" + {part.at(FACTOR)}"
        if len(text) > LONGEST_EVALUATED:
            return self._listed(SUM, parts)
        return self._joined(parts, text, TERM)

    def _listed(self, name: str, parts: list[Text]) -> Text:
        return self._joined(parts, f"{name}({', '.join(part.text for part in parts)})", ATOM)

    def _product(self, node: Any) -> Text:
        number, *factors = node.args
        parts = [self._part(factor) for factor in node.args]
        sign = ""
        if isinstance(number, sympy.Number) and number < 0:
            sign = "-"
            if number != -1 or not isinstance(number, sympy.Integer):
                factors.insert(0, -number)
            elif isinstance(factors[0], (sympy.Number, sympy.Mul)):
                return self._listed(PRODUCT, parts)
        else:
            factors.insert(0, number)
        if factors[0] == 1 or isinstance(factors[0], sympy.Mul):
            return self._listed(PRODUCT, parts)
        first = factors[0]
        head = _number(first) if isinstance(first, sympy.Number) else self._part(first)
        text = head.text if isinstance(first, sympy.Rational) else head.at(BASE)
        if _is_divisor(first):
            text = f"{self._part(first.base).at(ATOM)}**-1"
        for factor in factors[1:]:
            if _is_divisor(factor):
                text += f"/{self._part(factor.base).at(BASE)}"
            else:
                text += f"*{self._part(factor).at(BASE)}"
        return self._joined(parts, sign + text, FACTOR if not sign else TERM)

    def _power(self, node: Any) -> Text:
        base, exponent = self._part(node.base), self._part(node.exp)
        if node.exp == sympy.S.Half:
            return self._joined([base], f"sqrt({base.text})", ATOM)
        if _is_divisor(node):
            return self._joined([base], f"1/{base.at(BASE)}", FACTOR)
        power = exponent.text if isinstance(node.exp, sympy.Integer) else exponent.at(ATOM)
        return self._joined([base, exponent], f"{base.at(ATOM)}**{power}", BASE)

    def _call(self, node: Any) -> Text:
        arguments = node.pargs if isinstance(node, sympy.Heaviside) else node.args
        if isinstance(node, sympy.exp) and node.args == (1,):
            return Text(f"exp({SUM}(1))")  # exp(1) is the constant E
        return self._listed(_NAMES[node.func], [self._part(argument) for argument in arguments])

    def _function(self, node: Any) -> Text:
        if node.func != sympy.Function(node.func.__name__):
            raise RefusalError(f"{formula(node, 60)}, a function with assumptions")
        return self._listed(node.func.__name__, [self._part(argument) for argument in node.args])

    def _relation(self, node: Any) -> Text:
        left, right = parts = [self._part(side) for side in node.args]
        return self._joined(parts, f"{left.at(TERM)} {node.rel_op} {right.at(TERM)}", IF)

    def _logic(self, node: Any) -> Text:
        parts = [self._part(part) for part in node.args]
        return self._joined(parts, _LOGIC[node.func].join(part.at(ATOM) for part in parts), IF)

    def _choice(self, node: Any) -> Text:
        condition, first, second = parts = [self._part(part) for part in node.args]
        second = self._last(node.args[2], ITE)
        return self._joined(parts, f"({first.at(ATOM)} if {condition.at(ATOM)} else {second.at(ATOM)})", ATOM)

    def _branches(self, node: Any) -> Text:
        pairs = [(self._part(value), self._part(condition)) for value, condition in node.args]
        last = "None"
        if len(pairs) > 1 and node.args[-1].cond == sympy.true:
            pairs.pop()
            last = self._last(node.args[-1].expr, sympy.Piecewise).text
        parts = [part for pair in pairs for part in pair]
        text = "".join(f"{value.text} if {condition.text} else " for value, condition in pairs)
        return self._joined(parts, f"({text}{last})", ATOM)

    def _last(self, node: Any, kind: Any) -> Text:
        """Return the text of the last branch. One with branches has a definition: they would count as further ones."""
        entry = self._part(node)
        if isinstance(node, kind) and entry.text.startswith("("):
            entry = self._known[node] = self._defined(entry)
        return entry


def _prefixes() -> Iterable[str]:
    prefix = "part"
    while True:
        prefix += "_"
        yield prefix


def _is_divisor(node: Any) -> bool:
    return isinstance(node, sympy.Pow) and node.exp == -1 and not isinstance(node.base, sympy.Number)


def _is_signed(term: Any, part: Text) -> bool:
    """Return True if a text with a minus sign is a negative number or a product with a negative number at its head.

    A definition has no sign, and neither has a sum such as -x + y.
    """
    if part.strength == ATOM:
        return False
    if isinstance(term, sympy.Number):
        return True
    return isinstance(term, sympy.Mul) and isinstance(term.args[0], sympy.Number)


def _number(number: Any) -> Text:
    if isinstance(number, sympy.Rational):
        return Text(str(number), TERM if number < 0 else ATOM if number.q == 1 else FACTOR)
    if number._prec == 53 and sympy.Float(value := float(number)) == number:
        return Text(repr(value), ATOM if value >= 0 else TERM)
    sign, mantissa, exponent, _ = number._mpf_
    return Text(f"{FLOAT}({'-' * sign}{int(mantissa)}, {int(exponent)}, {int(number._prec)})")
