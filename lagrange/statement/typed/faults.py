"""Faults of a typed text that are found before parsing: unknown words, impossible derivatives, unmatched brackets."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.statement.typed.derivatives import OPENING
from lagrange.statement.typed.names import Names, Piece
from lagrange.statement.typed.remarks import WORD, kind_of
from lagrange.statement.typed.tokens import Token
from lagrange.statement.vocabulary.letters import GREEK


class TypedFault(Exception):
    """A fault of a typed text: its reason as a sentence without the final period, and its offset in the text.

    `read` is the strict text of the equation before the fault, or "".
    """

    def __init__(self, reason: str, place: int, read: str = "") -> None:
        super().__init__(reason)
        self.reason, self.place, self.read = reason, place, read


class UnknownWord(TypedFault):
    """Fault of a word that is neither a symbol of the system nor a product of symbols."""


def faults_of(tokens: Sequence[Token], names: Names) -> list[TypedFault]:
    """Return the faults that are found before parsing: characters, unknown words, impossible derivatives, brackets."""
    faults = [TypedFault(token.text, token.begin) for token in tokens if token.kind == "fault"]
    for i, token in enumerate(tokens):
        if token.kind == "word":
            faults += _word_faults(token, tokens[i + 1 : i + 2], names)
        elif token.kind == "index":
            faults.append(TypedFault("a subscript follows no symbol", token.begin))
    return sorted([*faults, *_bracket_faults(tokens)], key=lambda fault: fault.place)


def _word_faults(token: Token, following: Sequence[Token], names: Names) -> list[TypedFault]:
    name = token.text[:60]
    readings = names.readings(token.text)
    powered = bool(following) and (following[0].is_sign("^") or following[0].kind == "power")
    readings = [reading for reading in readings if all(piece.kind != "e" or powered for piece in reading)]
    if not readings:
        prose = kind_of(token.text) == WORD and token.text not in GREEK.values()
        hint = names.hint(token.text) or (" Write a remark after '#'." if prose else "")
        return [UnknownWord(f"{name!r} is not a symbol of this system.{hint}", token.begin)]
    if not differentiated(readings, token, names):
        return [TypedFault(f"{name!r} has no derivative of this order here", token.begin)]
    return []


def differentiated(readings: list[list[Piece]], token: Token, names: Names) -> list[list[Piece]]:
    """Return the readings of a word, with the dots of `token` on the first factor and its primes on the last one.

    Readings whose symbols have no such derivative are left out.
    """
    results = []
    for pieces in readings:
        first = names.derivative(pieces[0], token.order) if token.order else pieces[0]
        changed = [first, *pieces[1:]]
        last = changed[-1]
        if token.primes and last is not None:
            changed[-1] = names.derivative(last, token.primes)
        known = [piece for piece in changed if piece is not None]
        if len(known) == len(changed):
            results.append(known)
    return results


def _bracket_faults(tokens: Sequence[Token]) -> list[TypedFault]:
    """Return the faults of unmatched brackets."""
    faults, opened = [], []
    for token in tokens:
        if token.is_sign(*OPENING):
            opened.append(token)
        elif token.is_sign(*OPENING.values()):
            if opened and OPENING[opened[-1].text] == token.text:
                opened.pop()
            else:
                faults.append(TypedFault(f"{token.text!r} closes nothing", token.begin))
                opened = opened[:-1]
    return faults + [TypedFault(f"{token.text!r} is never closed", token.begin) for token in opened]
