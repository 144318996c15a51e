"""Derivatives among the tokens of a formula, in one form for all notations: primes, LaTeX dots, and d/dt."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

from lagrange.statement.typed.tokens import Token

OPENING = {"(": ")", "[": "]", "{": "}"}  # Opening brackets and their closing brackets

LONGEST_QUOTIENT = 20  # Most tokens of d^n or of /dt^n
LONGEST_CALL = 300  # Most tokens of a call such as diff(x, t, 2)

_CALLS = ("diff", "Diff", "Derivative")


NESTED = 5  # Most levels of nested dots and of derivatives inside diff(...); the readers of both are recursive


def with_derivatives(tokens: Sequence[Token]) -> list[Token]:
    """Return the tokens of a formula with derivatives in one form.

    LaTeX dots and primes of a word are added to its `primes`. Any other derivative becomes a token of kind "rate",
    followed by its operand; its text is the order. If the operand is simply what follows, as in d/dt m x, the kind is
    "operator". A subscript after a prime moves to its word.
    """
    return _leibniz(_marked(tokens, NESTED), NESTED)


def closing(tokens: Sequence[Token], start: int) -> int:
    """Return the index of the bracket that closes the one at index `start`, or the number of tokens if none does."""
    depth = 0
    for i in range(start, len(tokens)):
        if tokens[i].is_sign(*OPENING):
            depth += 1
        elif tokens[i].is_sign(*OPENING.values()):
            depth -= 1
            if depth == 0:
                return i
    return len(tokens)


def _marked(tokens: Sequence[Token], levels: int) -> list[Token]:
    """Return the tokens with dots and primes, and the subscripts that follow them, joined to their words.

    `levels` is the number of levels of nested dots that are read.
    """
    joined: list[Token] = []
    i = 0
    while i < len(tokens):
        token = tokens[i]
        i += 1
        if token.kind == "dots" and i < len(tokens) and levels:
            group = list(tokens[i : closing(tokens, i) + 1]) if tokens[i].is_sign("{", "(") else [tokens[i]]
            inside = _marked(group[1:-1] if len(group) > 1 else group, levels - 1)
            i += len(group)
            by_time = [following.text for following in tokens[i : i + 3]] == ["{", "t", "}"]  # of \\dv{x}{t}
            i += 3 * by_time
            if len(inside) == 1 and inside[0].kind == "word":
                word = replace(inside[0], begin=token.begin, spaced=token.spaced)
                token = replace(word, primes=word.primes + int(token.text))
            else:
                joined += [replace(token, kind="rate"), *group]
                continue
        if token.kind == "word":
            token, power, i = _with_marks(token, tokens, i)
            joined += [token, *power]
        else:
            joined.append(token)
    return joined


def _with_marks(word: Token, tokens: Sequence[Token], i: int) -> tuple[Token, list[Token], int]:
    """Return a word joined with primes and subscripts from index `i` on, the tokens of its power, and the next index.

    A power is read only if a subscript follows it, as in x^2_1.
    """
    power: list[Token] = []
    while i < len(tokens):
        token = tokens[i]
        if token.kind == "prime":
            word, i = replace(word, primes=word.primes + int(token.text), end=token.end), i + 1
        elif token.kind == "index":
            word, i = replace(word, text=word.text + token.text, end=token.end), i + 1
        elif token.is_sign("^") and not power:
            end = closing(tokens, i + 1) + 1 if tokens[i + 1 : i + 2] and tokens[i + 1].is_sign("{") else i + 2
            inside = [part for part in tokens[i + 1 : end] if not part.is_sign("{", "}")]
            if inside and all(part.kind == "prime" for part in inside):
                word, i = replace(word, primes=word.primes + sum(int(part.text) for part in inside)), end
            elif end < len(tokens) and tokens[end].kind == "index":
                power, i = list(tokens[i:end]), end
            else:
                break
        else:
            break
    return word, power, i


def _leibniz(tokens: Sequence[Token], levels: int) -> list[Token]:
    """Return the tokens with d^2x/dt^2, d/dt(...) and diff(x, t, 2) replaced by rates.

    `levels` is the number of levels of nested diff(...) that are read.
    """
    replaced: list[Token] = []
    i = 0
    while i < len(tokens):
        match = _quotient(tokens, i) if tokens[i].text[0] in "d({\\" else None
        match = match or _call(tokens, i)
        if match is None:
            if (
                tokens[i].is_sign(")")
                and len(replaced) > 1
                and replaced[-1].kind == "operator"
                and replaced[-2].is_sign("(")
            ):
                del replaced[-2]  # the bracket of (d/dt) x
            else:
                replaced.append(tokens[i])
            i += 1
            continue
        order, operand, after = match
        kind = "rate" if operand else "operator"
        replaced.append(Token(kind, str(order), tokens[i].begin, tokens[after - 1].end, spaced=tokens[i].spaced))
        replaced += _leibniz(operand, levels - 1) if levels and len(operand) > 1 else operand
        i = after
    return replaced


# Order of a derivative, tokens of its operand (none if the operand follows), and the next index
_Rate = tuple[int, list[Token], int]
_POWER = r"(\^(?:\([0-9]+ \)|[0-9]+ ))?"
_TOP = re.compile(rf"(\\?\()?d(?:([0-9]?)([^\W\d]\S*) |([0-9]?) {_POWER})")
_BOTTOM = {
    begin: re.compile(rf"(?:\(t \))?{middle}(\()?d ?t([0-9]?) {_POWER}(?(1)\){end})")
    for begin, middle, end in ((None, "/", _POWER), ("(", r"\)/", _POWER), (r"\(", r"\)", ""))
}
r"""Numerators such as d^2, dx and d2x, and what follows each begin of a numerator: (t)/dt^2.

A numerator may begin with a bracket, or with \\frac and a bracket.

The patterns match tokens as `_spelled` writes them.
"""


def _quotient(tokens: Sequence[Token], i: int) -> _Rate | None:
    """Return the derivative d^n x / dt^n that begins at index i, where x may be joined to d; else None."""
    top, after = _match(_TOP, tokens, i)
    if top is None:
        return None
    bracket, joined, name, digit, power = top.groups()
    operand = [replace(tokens[after - 1], text=name)] if name else list[Token]()
    if not name and after < len(tokens) and (tokens[after].kind == "word" or tokens[after].is_sign(*OPENING)):
        end = after if tokens[after].kind == "word" else closing(tokens, after)
        operand = list(tokens[after : end + 1])
        after += len(operand)
    bottom, after = _match(_BOTTOM[bracket], tokens, after)
    if bottom is None:
        return None
    orders = [(joined or digit, power), bottom.groups()[1:]]
    above, below = (next((int(x.strip("^() ")) for x in order if x), 1) for order in orders)
    return (above, operand, after) if above == below else None


def _match(pattern: re.Pattern[str], tokens: Sequence[Token], i: int) -> tuple[re.Match[str] | None, int]:
    """Return the match of a pattern with the tokens from index i on, and the index after it."""
    texts = list(map(_spelled, tokens[i : i + LONGEST_QUOTIENT]))
    match = pattern.match("".join(texts))
    return match, i + 1 + [*accumulate(map(len, texts))].index(match.end()) if match else i


def _spelled(token: Token) -> str:
    r"""Return a token as `_quotient` reads it: round brackets, \ for \frac, ^ before powers, a blank after words."""
    if token.kind == "sign":
        return {"{": "(", "}": ")", "\\frac": "\\"}.get(token.text, token.text)
    return f"{'^' * (token.kind == 'power')}{token.text} " if token.kind in ("word", "number", "power") else "'"


def _call(tokens: Sequence[Token], i: int) -> _Rate | None:
    """Return the derivative diff(x, t, 2), Derivative(x, (t, 2)) or D[x, {t, 2}] that begins at index i, or None."""
    opened = i + 1 < len(tokens) and tokens[i + 1].is_sign(*OPENING)
    named = tokens[i].text in _CALLS or (tokens[i].text == "D" and opened and tokens[i + 1].text == "[")
    if not (opened and named and tokens[i].kind == "word"):
        return None
    end = closing(tokens[: i + LONGEST_CALL], i + 1)
    if end >= min(len(tokens), i + LONGEST_CALL):
        return None
    inside = list(tokens[i + 2 : end])
    depth, comma = 0, 0
    while comma < len(inside) and not (depth == 0 and inside[comma].is_sign(",")):
        depth += inside[comma].is_sign(*OPENING) - inside[comma].is_sign(*OPENING.values())
        comma += 1
    by = [token.text for token in inside[comma:] if token.kind != "sign"]
    if not comma or not by or any(word != "t" and not word.isdigit() for word in by):
        return None
    order = sum(1 if word == "t" else int(word) - 1 for word in by)
    brackets = (Token("sign", mark, offset, offset) for mark, offset in (("(", inside[0].begin), (")", inside[-1].end)))
    return (order, [next(brackets), *inside[:comma], next(brackets)], end + 1) if order in (1, 2) else None
