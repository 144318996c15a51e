"""One notation for all derivatives among the tokens of a formula: primes, dots of LaTeX, and d/dt in all its forms."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from lagrange.statement.typed.tokens import Token

OPENING = {"(": ")", "[": "]", "{": "}"}
"""Opening brackets and their closing brackets."""

_TOP = re.compile(r"d([0-9]?)(.*)", re.DOTALL)
_BOTTOM = re.compile(r"dt([0-9]?)")
LONGEST_CALL = 300
"""Most tokens of a call such as diff(x, t, 2)."""

_CALLS = ("diff", "Diff", "Derivative")


NESTED = 5
"""Most levels of nested dots and of derivatives inside diff(...); the readers of both are recursive."""


def with_derivatives(tokens: Sequence[Token]) -> list[Token]:
    """Return the tokens of a formula with derivatives marked.

    Dots and primes of a word become its `order` and `primes`. Any other derivative becomes a token of kind "rate" whose
    text is the order, followed by the operand. A subscript after a mark moves to its word.
    """
    return _leibniz(_marked(tokens, NESTED), NESTED)


def closing(tokens: Sequence[Token], place: int) -> int:
    """Return the index of the bracket that closes the one at `place`, or the number of tokens if none does."""
    depth = 0
    for i in range(place, len(tokens)):
        if tokens[i].is_sign(*OPENING):
            depth += 1
        elif tokens[i].is_sign(*OPENING.values()):
            depth -= 1
            if depth == 0:
                return i
    return len(tokens)


def _marked(tokens: Sequence[Token], levels: int) -> list[Token]:
    """Return the tokens with dots, primes and the subscripts after these joined to their words.

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
    """Return a word with its primes and subscripts, the tokens of a power between them, and the next index."""
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
    """Return the tokens with d^2x/dt^2, d/dt(...), also as LaTeX fractions, and diff(x, t, 2) replaced by rates.

    `levels` is the number of levels of nested diff(...) that are read.
    """
    replaced: list[Token] = []
    i = 0
    while i < len(tokens):
        match = _fraction(tokens, i) or _quotient(tokens, i) or _call(tokens, i)
        if match is None:
            replaced.append(tokens[i])
            i += 1
            continue
        order, operand, after = match
        replaced.append(Token("rate", str(order), tokens[i].begin, tokens[after - 1].end, spaced=tokens[i].spaced))
        replaced += _leibniz(operand, levels - 1) if levels and len(operand) > 1 else operand
        i = after
    return replaced


_Rate = tuple[int, list[Token], int]
"""Order of a derivative, tokens of its operand (none if the operand follows), and the next index."""


def _quotient(tokens: Sequence[Token], i: int) -> _Rate | None:
    """Return the derivative d^n x / dt^n that begins at index i, or None."""
    if tokens[i].is_sign("(") and i + 1 < len(tokens) and tokens[i + 1].kind == "word":  # (d^2/dt^2) x
        rate = _quotient(tokens, i + 1)
        ends = rate is not None and not rate[1] and tokens[rate[2] : rate[2] + 1]
        return (rate[0], [], rate[2] + 1) if rate and ends and ends[0].is_sign(")") else None
    top = _top(tokens, i, len(tokens))
    if top is None or top[2] >= len(tokens) or not tokens[top[2]].is_sign("/"):
        return None
    bottom = _bottom(tokens, top[2] + 1, len(tokens))
    return (top[0], top[1], bottom[1]) if bottom and bottom[0] == top[0] else None


def _fraction(tokens: Sequence[Token], i: int) -> _Rate | None:
    r"""Return the derivative \frac{d^n x}{dt^n} that begins at index i, or None."""
    if tokens[i].kind != "fraction" or not tokens[i + 1 : i + 2] or not tokens[i + 1].is_sign("{"):
        return None
    middle = closing(tokens, i + 1)
    if not tokens[middle + 1 : middle + 2] or not tokens[middle + 1].is_sign("{"):
        return None
    end = closing(tokens, middle + 1)
    if end == len(tokens):
        return None
    top, bottom = _top(tokens, i + 2, middle), _bottom(tokens, middle + 2, end)
    if top is None or bottom is None or top[2] != middle or bottom[1] != end or top[0] != bottom[0]:
        return None
    return top[0], top[1], end + 1


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
    brackets = (Token("sign", mark, place, place) for mark, place in (("(", inside[0].begin), (")", inside[-1].end)))
    return (order, [next(brackets), *inside[:comma], next(brackets)], end + 1) if order in (1, 2) else None


def _top(tokens: Sequence[Token], i: int, end: int) -> _Rate | None:
    """Return the order and the operand of d^n x, where x is joined to d or follows it; None for other tokens."""
    match = _TOP.fullmatch(tokens[i].text) if i < end and tokens[i].kind == "word" else None
    if match is None:
        return None
    order, rest = int(match.group(1) or 1), match.group(2)
    word, i = tokens[i], i + 1
    if rest:
        return order, [replace(word, text=rest)], i
    if not match.group(1):
        order, i = _order(tokens, i, end)
    if i < end and tokens[i].kind == "word":
        return order, [tokens[i]], i + 1
    if i < end and tokens[i].is_sign("(", "[", "{"):
        close = min(closing(tokens, i) + 1, end)
        return order, list(tokens[i:close]), close
    return order, [], i


def _bottom(tokens: Sequence[Token], i: int, end: int) -> tuple[int, int] | None:
    """Return the order of dt^n and the next index; None for other tokens."""
    bracket = i < end and tokens[i].is_sign("(", "{")
    i += bracket
    match = _BOTTOM.fullmatch(tokens[i].text) if i < end and tokens[i].kind == "word" else None
    if match is None:
        if not (i + 1 < end and [part.text for part in tokens[i : i + 2]] == ["d", "t"]):
            return None
        i += 1
    i += 1
    order = int(match.group(1)) if match and match.group(1) else 0
    if not order:
        order, i = _order(tokens, i, end)
    if bracket:
        if i >= end or not tokens[i].is_sign(")", "}"):
            return None
        i += 1
        if order == 1:
            order, i = _order(tokens, i, end)
    return order, i


def _order(tokens: Sequence[Token], i: int, end: int) -> tuple[int, int]:
    """Return the exponent at index i, 1 by default, and the next index."""
    if i < end and tokens[i].kind == "power" and tokens[i].text.isdigit():
        return int(tokens[i].text), i + 1
    if i + 1 < end and tokens[i].is_sign("^"):
        if tokens[i + 1].kind == "number" and tokens[i + 1].text.isdigit():
            return int(tokens[i + 1].text), i + 2
        if i + 3 < end and tokens[i + 1].is_sign("{", "(") and tokens[i + 2].text.isdigit():
            return int(tokens[i + 2].text), i + 4
    return 1, i
