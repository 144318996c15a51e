"""Definitions in an answer: equations for new names, such as r = sqrt(x^2 + y^2), m r^2 phi' = L or w^2 = k/m."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from lagrange.statement.typed.names import SPELLINGS, Names, canonical
from lagrange.statement.typed.remarks import Clause
from lagrange.statement.typed.tokens import Token
from lagrange.statement.vocabulary.letters import GREEK

_CONSTANT = (["const"], ["constant"], ["konst"])  # Right sides that state that a quantity is constant
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")  # A name that a line may define

# A name of a force such as a tension T1, which two equations may have: one defines it for the other
_FORCE = re.compile(r"[TNSF](?:_?[0-9A-Za-z])?")
_LONE = (("",), ("", "2"), ("", "^", "2"))  # Sides that a definition may have: a name, written as "", and its square


def is_constant(side: Sequence[Token]) -> bool:
    """Return True if one side of an equation, as tokens, is the word "const"."""
    return [token.text for token in side] in _CONSTANT


@dataclass(frozen=True)
class Definition:
    """An equation that defines the name `name`: its two sides, of which one may be the name alone.

    `lone` is true if a side is the name or its square, or if the name is a force. If the equation also states that a
    value is constant, `constant` is a clause with that value; else None.
    """

    name: str
    sides: tuple[list[Token], list[Token]]
    lone: bool
    constant: Clause | None = None

    @classmethod
    def of(cls, clause: Clause, uses: Uses, names: Names) -> Definition | None:
        """Return the definition that a clause states, or None.

        A definition has one unknown name, which other clauses contain. A name that is not alone on a side is defined
        only if another clause states its derivative or that it is constant, or if it is a force in another clause.
        `uses` are the occurrences of unknown names in the answer.
        """
        sides = clause.sides()
        stated = is_constant(sides[-1])
        sides = sides[:-1] if stated else sides
        laws = [side for side in sides if len(sides) > 2 and side and clause.is_law(side[0].begin, side[-1].end)]
        sides = [side for side in sides if side not in laws]  # p = dL/dx' = m x' defines p
        if len(sides) > 2:  # p = m r^2 phi' = l: of the names the last one counts that other clauses have
            unknown = [side for side in sides if len(side) == 1 and not names.readings(side[0].text)]
            used = [side for side in unknown if uses.contain(canonical(side[0].text), clause)]
            rest = [side for side in sides if side not in unknown]
            sides = [used[-1], *rest] if used else sides
        words = [token for side in sides for token in side if token.kind == "word" and not names.readings(token.text)]
        marked = any(word.order or word.primes for word in words)
        if len(sides) != 2 or not all(sides) or marked or len({word.text for word in words}) != 1:
            return None
        name = "".join(GREEK.get(mark, mark) for mark in words[0].text)
        texts = [tuple("" if token in words else token.text for token in side) for side in sides]
        lone = [k for k, text in enumerate(texts) if text in _LONE]
        value = sides[1 - lone[0]] if lone else sides[0]
        changes = uses.changes(canonical(name), clause)
        shared = uses.contain(canonical(name), clause)
        force = shared and not stated and bool(_FORCE.fullmatch(name))
        if not (changes or force or (lone and shared)) or not _NAME.fullmatch(name):
            return None
        if not (lone or force) and names.order(sides[0] + sides[1]) > 1:
            return None
        kept = clause.part(value[0].begin, value[-1].end, aside=not stated)
        fixed = stated or (lone == [1] and names.order(value) == 1 and not changes)
        return cls(name, (sides[0], sides[1]), bool(lone) or force, replace(kept, constant=True) if fixed else None)


class Uses:
    """Places at which unknown words occur in an answer, a text of typed equations.

    `words` maps each word to the offsets of the clauses (parts of the text) that contain it. `changed` has only the
    clauses that state its derivative, or that it is constant.
    """

    def __init__(self, clauses: Sequence[Clause]) -> None:
        self.words: dict[str, set[int]] = {}
        self.changed: dict[str, set[int]] = {}
        for clause in clauses:
            constant = is_constant(clause.sides()[-1])
            for before, token in pairwise((None, *clause.tokens)):
                if token is None or token.kind != "word" or clause.names.readings(token.text):
                    continue
                word = canonical(token.text)
                self.words.setdefault(word, set()).add(clause.begin)
                if constant or token.order or token.primes or (before and before.kind == "rate"):
                    self.changed.setdefault(word, set()).add(clause.begin)

    def contain(self, name: str, clause: Clause) -> bool:
        """Return True if a clause other than `clause` contains a name, alone or in a product such as wt."""
        uses = (offsets for word, offsets in self.words.items() if name in word and word != f"d{name}")
        return any(offsets - {clause.begin} for offsets in uses)

    def changes(self, name: str, clause: Clause) -> bool:
        """Return True if a clause other than `clause` states the derivative of a name, or that it is constant."""
        rates = (name + ending for endings in SPELLINGS[1:] for ending in endings)
        offset_sets = [self.changed.get(name, set()), *(self.words.get(rate, set()) for rate in rates)]
        return any(offsets - {clause.begin} for offsets in offset_sets)
