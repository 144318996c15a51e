"""SymPy to text: the spelling of scenes, which `text.read_expression` reads back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise, permutations, product
from typing import Any

import sympy
from sympy.core.relational import Relational

from lagrange.errors import formula
from lagrange.statement.lexer import DEEPEST, WORDS
from lagrange.statement.text import RefusalError

LONG = 300
"""Most operations of an expression whose terms are sorted for people; sorting takes seconds for thousands."""

MOST_RELATED = 4
"""Most relations of one condition: they are tried in every order."""

SUM, PRODUCT, POWER, ATOM = range(4)
"""Binding strength of the outermost operation of a text, weakest first."""

_NAMES = {word.build: name for name, word in WORDS.items() if isinstance(word.build, type)}


def expression_text(expression: Any) -> str:
    """Return the text of an expression in plain symbols. Raises RefusalError if scenes have no text for it."""
    return _Writer(ordered=bool(sympy.count_ops(expression) <= LONG)).text(expression)


class _Writer:
    """Writes expressions; with `ordered` terms and factors are in SymPy's order for people."""

    def __init__(self, *, ordered: bool) -> None:
        self.ordered = ordered
        self.depth = 0
        self.kinds: tuple[tuple[Any, Callable[[Any], tuple[str, int]]], ...] = (
            (sympy.Symbol, lambda symbol: (str(symbol.name), ATOM)),
            (sympy.Number, _number),
            (sympy.Add, self.sum),
            (sympy.Mul, self.product),
            (sympy.Pow, self.power),
            (sympy.Piecewise, self.condition),
            (sympy.core.numbers.Pi, lambda _: ("pi", ATOM)),
            (sympy.core.numbers.Exp1, lambda _: ("exp(1)", ATOM)),
            (tuple(_NAMES), self.call),
        )

    def text(self, node: Any, least: int = SUM) -> str:
        """Return the text of a node, in parentheses if its binding strength is below `least`."""
        write = next((write for kind, write in self.kinds if isinstance(node, kind)), None)
        if write is None:
            raise RefusalError(f"{formula(node, 60)}, which has no name in a scene")
        self.depth += 1
        if self.depth > 2 * DEEPEST:
            raise RefusalError(f"parts that stand more than {DEEPEST} deep in each other: state it in parts")
        text, holds = write(node)
        self.depth -= 1
        return text if holds >= least else f"({text})"

    def sum(self, node: Any) -> tuple[str, int]:
        """Return the text of a sum and its binding strength."""
        first, *others = node.as_ordered_terms() if self.ordered else node.args
        text = self.text(first)
        for term in others:
            number, rest = term.as_coeff_Mul()
            text += f" - {self.text(-number * rest, PRODUCT)}" if number < 0 else f" + {self.text(term, PRODUCT)}"
        return text, SUM

    def product(self, node: Any) -> tuple[str, int]:
        """Return the text of a product, with divisors after a slash, and its binding strength.

        SymPy expands a number times a sum when it reads a text: 1/(8*(x + y)) would become 1/(8*x + 8*y), and
        -(x + y)*z would become (-x - y)*z. The text avoids both.
        """
        number, rest = node.as_coeff_Mul()
        factors = sympy.Mul.make_args(rest)
        if self.ordered and rest.is_Mul:
            factors = rest.as_ordered_factors()
        below = [1 / one for one in factors if one.is_Pow and one.exp.is_Rational and one.exp < 0]
        above = sorted((one for one in factors if 1 / one not in below), key=lambda one: one.is_Add)
        divisor = number.q if isinstance(number, sympy.Rational) else 1
        size = abs(number) * divisor
        texts = [self.text(one, PRODUCT + (not one.is_Mul)) for one in above]
        if size != 1 or not texts:
            texts.insert(0, self.text(size))
        signed = f"-{'1*' * texts[0].startswith('(')}" * bool(number < 0) + "*".join(texts)
        divisors = [self.text(one, PRODUCT + (not one.is_Mul)) for one in below]
        alone = any(one.is_Add for one in below)
        numbers = [str(divisor)] * (divisor != 1)
        joined = divisors if alone else [*numbers, *divisors]
        text = signed + (f"/({'*'.join(joined)})" if len(joined) > 1 else "".join(f"/{one}" for one in joined))
        return text + "".join(f"/{one}" for one in numbers * alone), PRODUCT if number >= 0 else SUM

    def power(self, node: Any) -> tuple[str, int]:
        """Return the text of a power or a root, and its binding strength."""
        base, exponent = node.base, node.exp
        if exponent.is_Rational and exponent < 0:
            return self.product(node)
        if exponent == sympy.S.Half:
            return f"sqrt({self.text(base)})", ATOM
        return f"{self.text(base, ATOM)}**{self.text(exponent, ATOM)}", POWER

    def call(self, node: Any) -> tuple[str, int]:
        """Return the text of a function call, and its binding strength."""
        given = node.pargs if isinstance(node, sympy.Heaviside) else node.args
        return f"{_NAMES[node.func]}({', '.join(map(self.text, given))})", ATOM

    def condition(self, node: Any) -> tuple[str, int]:
        """Return the text "value if condition else ...", and its binding strength."""
        *branches, (last, otherwise) = node.args
        if otherwise != sympy.true:
            raise RefusalError("a condition that leaves a case without a value")
        chosen = [f"{self.text(value)} if {case} else " for value, when in branches for case in self._cases(when)]
        return f"({''.join(chosen)}{self.text(last)})", ATOM

    def _cases(self, condition: Any) -> Iterator[str]:
        """Yield the alternatives of a condition as chained comparisons: it holds if one of them does."""
        for case in condition.args if isinstance(condition, sympy.Or) else (condition,):
            relations = case.args if isinstance(case, sympy.And) else (case,)
            if len(relations) > MOST_RELATED or not all(isinstance(part, Relational) for part in relations):
                raise RefusalError(f"the condition {formula(case, 60)}, which is no chain of comparisons")
            yield self._chain(relations)

    def _chain(self, relations: Sequence[Any]) -> str:
        """Return the conjunction of relations as one chain, such as 0 < x < 1."""
        for ordered in permutations(relations):
            for turned in product((False, True), repeat=len(ordered)):
                chain = [one.reversed if turn else one for one, turn in zip(ordered, turned, strict=True)]
                if all(one.rhs == other.lhs for one, other in pairwise(chain)):
                    return self.text(chain[0].lhs) + "".join(f" {one.rel_op} {self.text(one.rhs)}" for one in chain)
        raise RefusalError(f"the condition {formula(sympy.And(*relations), 60)}, which is no chain of comparisons")


def _number(number: Any) -> tuple[str, int]:
    if isinstance(number, sympy.Rational):
        text = str(number)
        return text, SUM if number < 0 else ATOM if number.q == 1 else PRODUCT
    value = float(number)
    if sympy.Rational(number) != sympy.Rational(value):
        raise RefusalError(f"the number {formula(number, 40)}, which has more digits than a floating-point number")
    return repr(value), ATOM if value >= 0 else SUM
