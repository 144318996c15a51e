"""Order of factors in a product and of terms in a sum, as textbooks print them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, cached_property
from typing import Any

from sympy import Add, Derivative
from sympy.core.function import AppliedUndef

from lagrange.show.notation.text import index_parts
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement

LETTERS = ("G", "m M mu", "I J Theta", "g", "", "l L R r a b d h s w length radius", "omega Omega nu")
"""Parameters by the usual meaning of their letters: masses, moments of inertia, gravity, others, lengths, rates.

Textbooks print m g l, m l^2 omega^2, and G m1 m2 with G first. In the same class the order is that of the statement.
"""
OTHERS = LETTERS.index("")
CLASS_OF = {letter: rank for rank, letters in enumerate(LETTERS) for letter in letters.split()}
PARAMETER, MULTIPLIER, POSITION, VELOCITY, ACCELERATION, FUNCTION = range(6)
GRAVITY = (PARAMETER, LETTERS.index("g"))
MASS = (PARAMETER, LETTERS.index("m M mu"))
LAST = (POSITION, 0, 1_000_000)
"""Rank of time and of symbols that are not in the statement: after the coordinates."""

Key = tuple[Any, ...]


class BookOrder:
    """Sort keys for the factors and terms of a statement's formulas, in plain symbols.

    `rank` maps each symbol to its place in the order: the kind of symbol, the class of its letter, its index in the
    statement. Kinds are parameter, multiplier, position, velocity and acceleration, in this order.
    """

    def __init__(self, statement: Statement) -> None:
        plain = list(statement.plain.values())
        self.rank: dict[Any, tuple[int, int, int]] = {}
        unset = [p for p in statement.parameters if p not in statement.defaults]
        stated = [*statement.defaults, *sorted(unset, key=_natural)]
        for index, parameter in enumerate(stated):
            head, _ = index_parts(parameter.name)
            self.rank[parameter] = (PARAMETER, CLASS_OF.get(head, OTHERS), index)
        for index, constraint in enumerate(statement.constraints):
            self.rank[constraint.multiplier] = (MULTIPLIER, 0, index)
        for index, symbol in enumerate(plain):
            self.rank[symbol] = (POSITION + index % 3, 0, index // 3)
        self.typed: frozenset[Any] = frozenset()
        """Sums and products of an answer, whose signs are kept, too."""
        self._statement = statement
        self.factor = cache(self._key)  # the same factors occur often

    @cached_property
    def sums(self) -> frozenset[Any]:
        """The sums that the statement contains. Formulas keep the signs of their terms as the author chose them."""
        statement = self._statement
        stated = [statement.lagrangian, statement.dissipation, *statement.forces]
        stated += [constraint.expression for constraint in statement.constraints]
        stated += [entry for point in statement.positions.values() for entry in point]
        return frozenset(node for part in stated for node in part.xreplace(statement.plain).atoms(Add))

    def symbols(self, expression: Any) -> list[tuple[int, int, int]]:
        """Return the ranks (kind, class of the letter, index) of the symbols in an expression, in ascending order.

        Time and unknown symbols rank after the coordinates.
        """
        return sorted(self.rank.get(symbol, LAST) for symbol in expression.free_symbols)

    def moves(self, expression: Any) -> bool:
        """Return True if an expression contains a symbol that is not a parameter."""
        return any(rank[0] != PARAMETER for rank in self.symbols(expression))

    def follows(self, factor: Any) -> bool:
        """Return True if a factor is printed after a fraction of constants: a function, or a factor with variables."""
        return self.moves(factor) or bool(self.factor(factor)[0] >= ACCELERATION)

    def _key(self, factor: Any) -> Key:
        """Return the sort key of a factor."""
        base, exponent = factor.as_base_exp()
        if function := given_function(base):
            return (ACCELERATION, 1, base.derivative_count if base.is_Derivative else 0, 0, function)
        ranks = self.symbols(factor)
        if base.is_Add and exponent.is_Integer:
            highest = max((rank[0] for rank in ranks), default=PARAMETER)
            first = next((rank for rank in ranks if rank[0] == min(highest, POSITION)), (highest, 0, 0))
            return (highest, *first[1:], 0, str(base))
        if base.is_Symbol and not exponent.free_symbols and (exponent.is_Integer or not self.moves(base)):
            return (*self.rank.get(base, LAST), 1, base.name)
        if not ranks:
            return (PARAMETER, -1, 0, 0, str(base))
        moving = [rank for rank in ranks if rank[0] != PARAMETER]
        lead = (moving or ranks)[0]
        kind = {"sin": 0, "cos": 1}.get(type(base).__name__, 2)
        root = base.is_Symbol or base.is_Add
        return (FUNCTION, 0 if root else 1 + lead[0], lead[2], kind, str(base))

    def term(self, term: Any) -> Key:
        """Return the sort key of a term: accelerations come first, then velocities, then all other terms.

        Among the others, squares and products of coordinates come first, as in x^2 + y^2 - l^2. Constants follow, as in
        l + x and m1 + m2 sin(theta)^2. Terms with the acceleration of gravity g, then functions of time alone, come
        last.
        """
        ranks = self.symbols(term)
        highest = max((rank[0] for rank in ranks), default=PARAMETER)
        indices = [rank[2] for rank in ranks if rank[0] == highest for _ in range(self._power(term, rank))]
        degree = self._degree(term) if highest == VELOCITY else 0
        last = self._last(ranks) if highest <= POSITION else 0
        return (-max(highest, POSITION), degree, last, self._place(term, highest), indices, ranks)

    def _last(self, ranks: list[tuple[int, int, int]]) -> int:
        """Return the class of a term by the ranks of its symbols, which are in ascending order.

        It is 1 for a product with the acceleration of gravity g. It is 2 for a function of time alone, which is printed
        last, and 0 for any other term.
        """
        if ranks and ranks[-1] == LAST and not any(rank[0] == POSITION for rank in ranks if rank != LAST):
            return 2
        return int(len(ranks) > 1 and any(rank[:2] == GRAVITY for rank in ranks))

    def _degree(self, term: Any) -> int:
        """Return the class of a term for sorting by its velocities.

        It is 1 for a product of several velocities, 2 for a single velocity to the first power, and 0 for all other
        terms, such as squares. A term with sums as factors has the highest class of their terms.
        """
        factors = term.as_powers_dict()
        powers = [e for base, e in factors.items() if self.rank.get(base, LAST)[0] == VELOCITY]
        if not powers:
            sums = (base.args for base, e in factors.items() if base.is_Add and e == 1)
            return max((self._degree(part) for parts in sums for part in parts), default=0)
        return 1 if len(powers) > 1 else 2 if powers == [1] else 0

    def _power(self, term: Any, rank: tuple[int, int, int]) -> int:
        """Return the degree of the symbol with rank `rank` in a product, 1 if it is not found.

        The degree sorts x^2 before x y, and x y before y^2.
        """
        powers = term.as_powers_dict()
        return next((int(e) for base, e in powers.items() if self.rank.get(base) == rank and e.is_Integer and e > 0), 1)

    def _place(self, term: Any, highest: int) -> int:
        if highest > POSITION:
            return 0
        _, rest = term.as_coeff_Mul()
        degree = 0
        for factor in rest.as_ordered_factors() if rest.is_Mul else [rest]:
            base, exponent = factor.as_base_exp()
            if self.moves(base) or self.moves(exponent):
                if not base.is_Symbol or not exponent.is_Integer:
                    return 3
                degree += int(exponent)
        return 1 if degree == 0 else 2 if degree == 1 else 0

    def terms(self, parts: Iterable[Any], subtracted: Callable[[Any], bool]) -> list[Any]:
        """Return the terms of a sum in order. A positive term comes first, unless the sum begins with accelerations.

        `subtracted` returns True for a term with a minus sign. A subtracted constant comes last, as in x + y - l.
        """
        ordered = sorted(parts, key=self.term)
        if not subtracted(ordered[0]) or self.term(ordered[0])[0] == -ACCELERATION:
            return ordered
        if not self.moves(ordered[0]):
            ordered.sort(key=lambda part: not self.moves(part))
        first = next((part for part in ordered if not subtracted(part)), ordered[0])
        ordered.remove(first)
        return [first, *ordered]

    def reversible(self, total: Any, term: Any) -> bool:
        """Return True if the minus sign of a term may be moved into its factor `total`: -(m1 - m2)*g is (m2 - m1)*g.

        `total` must be a difference of two masses, or another difference of constants that does not occur in the
        statement. A stated difference such as R - r is usually positive, and is kept. A term that a user typed is not
        changed.
        """
        if not total.is_Add or len(total.args) != 2 or sum(map(_negative, total.args)) != 1 or self.moves(total):
            return False
        masses = all(rank[:2] == MASS for rank in self.symbols(total))
        return (masses or total not in self.sums) and term not in self.typed

    def turned(self, total: Any) -> bool:
        """Return True if a sum in parentheses is better written as minus its negative.

        A sum of the statement keeps its signs if it has a positive term. Any other sum is written so that most of its
        terms are positive. If half of them are positive, the first term is.
        """
        negative = sum(map(_negative, total.args))
        if negative == len(total.args):
            return True
        preferred = self._preferred(total)
        if preferred is not None:
            return bool(preferred != total)
        if 2 * negative != len(total.args):
            return 2 * negative > len(total.args)
        return _negative(min(total.args, key=self.term))

    def oriented(self, factor: Any) -> tuple[int, Any]:
        """Return (sign, factor), whose product is the given factor, so that the new factor has the signs of textbooks.

        SymPy turns cos(a - b) and sin(a - b) to cos(b - a) and -sin(b - a). If the user typed only a - b, this is
        undone.
        """
        if factor.is_Add:
            return (-1, -factor) if self.turned(factor) else (1, factor)
        argument = factor.args[0] if factor.is_Function else factor
        if not argument.is_Add or self._preferred(argument) in (None, argument):
            return 1, factor
        sign = {factor: 1, -factor: -1}.get(factor.func(-argument, *factor.args[1:]))
        return (1, factor) if sign is None else (sign, factor.func(-argument, evaluate=False))

    def _preferred(self, total: Any) -> Any:
        """Return a sum or its negative, whichever the user typed, else whichever the statement contains.

        Returns None if both or neither occur.
        """
        for sums in (self.typed, self.sums):
            if (total in sums) != (-total in sums):
                return total if total in sums else -total
        return None


def given_function(node: Any) -> str:
    """Return the name of a given function of time or of its derivative; empty for any other expression."""
    function = node.expr if isinstance(node, Derivative) else node
    return str(function.func.__name__) if isinstance(function, AppliedUndef) and function.args == (t,) else ""


def _natural(parameter: Any) -> list[tuple[int, str]]:
    """Return the sort key of a parameter's name, by which m2 comes before m10."""
    head, parts = index_parts(parameter.name)
    return [(int(part) if part.isdigit() else 0, part) for part in (head, *parts)]


def _negative(term: Any) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)
