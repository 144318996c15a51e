r"""Divide a typed formula into tokens: words, numbers, signs, LaTeX commands such as \dfrac and \ddot, with offsets.

Derivatives get one form for all notations: primes, LaTeX dots, and d/dt. `typed.names` finds the symbols in words.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

from lagrange.statement.typed.respelling import AND, MATRIX_MARKS, NOT, OR
from lagrange.statement.vocabulary.functions import ALIASES, WORDS
from lagrange.statement.vocabulary.letters import GREEK

# Combining marks above a letter, and the order of the time derivative that each means
DOTS = {"\N{COMBINING DOT ABOVE}": 1, "\N{COMBINING DIAERESIS}": 2, "\N{COMBINING THREE DOTS ABOVE}": 3}
# Marks after a letter that mean derivatives, and the order of the derivative
PRIMES = {**dict.fromkeys("'’‘′´`˙", 1), **dict.fromkeys('"″”“¨', 2)}
ORDERS = ("<", "<=", ">", ">=")  # Signs of a comparison
CONNECTIVES = {AND: "and", OR: "or", NOT: "not"}  # Signs between conditions
# Signs of formulas, with the plain sign of each
SIGNS = {
    "**": "^",
    "==": "=",
    "≤": "<=",
    "≥": ">=",
    **{sign: sign for sign in ORDERS},
    **{mark: mark for mark in (*"+-*/^=()[]{}|,", *MATRIX_MARKS)},
    **dict.fromkeys("\u2212\u2013\u2014\u2010\u2011\u2012", "-"),
    **dict.fromkeys("·⋅×∗•", "*"),
    **dict.fromkeys("÷∕⁄", "/"),
    "√": "sqrt",
    **CONNECTIVES,
}
# LaTeX commands for signs, with the plain sign of each
_COMMAND_SIGNS = {
    **dict.fromkeys(("cdot", "times", "ast"), "*"),
    **dict.fromkeys(("lvert", "rvert", "vert", "mid"), "|"),
    **dict.fromkeys(("lbrace", "lparen"), "("),
    **dict.fromkeys(("rbrace", "rparen"), ")"),
    **dict.fromkeys(("le", "leq"), "<="),
    **dict.fromkeys(("ge", "geq"), ">="),
    **dict.fromkeys(("land", "wedge"), "and"),
    **dict.fromkeys(("lor", "vee"), "or"),
    **dict.fromkeys(("lnot", "neg"), "not"),
    "lt": "<",
    "gt": ">",
    "div": "/",
    "prime": "'",
    "{": "(",
    "}": ")",
    "|": "|",
}
# LaTeX commands followed by a numerator and a denominator
_FRACTIONS = ("frac", "dfrac", "tfrac", "cfrac", "sfrac", "nicefrac")
# LaTeX commands for time derivatives, and the order of the derivative
_DERIVATIVES = {"dot": 1, "ddot": 2, "dddot": 3, "dv": 1, "odv": 1}
# LaTeX commands before a group in braces that is one word
_WORD_GROUPS = (
    *("mathrm", "text", "textrm", "mathit", "operatorname", "mathsf"),
    *("mathbf", "boldsymbol", "rm", "mathop", "vec", "hat"),
)
# LaTeX commands that change only the appearance of a formula
_SPACES = (
    *(f"{size}{side}" for size in ("big", "Big", "bigg", "Bigg") for side in ("", "l", "r")),
    *("quad", "qquad", "cancel", "bcancel", "displaystyle", "textstyle", "limits", "nonumber", "notag"),
    *("thinspace", "space", "hfill", "blacksquare", *",;:!>"),
)
# LaTeX commands for letters and functions, with the word for each
_COMMAND_WORDS = {f"var{name}": name for name in ("phi", "theta", "epsilon", "rho", "sigma", "pi")} | {
    name: name
    for name in (
        *(*GREEK.values(), "pi", "ell", "min", "max", "sqrt", "exp", "log", "ln", "sgn", "arcsin", "arccos", "arctan"),
        *("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh"),
    )
}
# Matches a command that is an operator between two values
OPERATOR = rf"\\(?:{'|'.join(name for name, sign in _COMMAND_SIGNS.items() if sign in '*/')})(?![A-Za-z])"
# Characters similar to letters of a name, with the letter's name
GREEK_VARIANTS = {"ϕ": "phi", "ϑ": "theta", "ϵ": "epsilon", "ϱ": "rho", "µ": "mu", "π": "pi", "ℓ": "ell", "ς": "sigma"}
_NUMBER = re.compile(r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+(?![A-Za-z0-9_]))?")
# Matches a number such as 0,5, without blanks around the comma and without a further comma or point
_DECIMAL_COMMA = re.compile(r"([0-9]+)(?:,|\{,\})([0-9]+)(?![0-9]|[.,][0-9])")
_LONE = re.compile(r"\s*([0-9A-Za-z])")  # Matches an argument of a fraction without braces

_COMMAND = re.compile(r"\\([A-Za-z]+|.)", re.DOTALL)
_BLANK = re.compile(r"[\s~&$\u00a0\u2009\u200b\u2061\u2062\u2063]+")
_GROUP = re.compile(r"\s*\{\s*([^{}]*?)\s*\}")
_INDEX = re.compile(r"\s*_\s*(?:\{((?:[^{}]|\{[^{}]*\})*)\}|\\([A-Za-z]+)|([A-Za-z0-9]))")
_INDEX_COMMAND = re.compile(rf"\\(?:{'|'.join(_WORD_GROUPS)})(?![A-Za-z])|[{{}}\\]")
_LETTER = f"[A-Za-z{''.join(GREEK)}]"
_PLAIN_INDEX = re.compile(rf"_([0-9]+|{_LETTER}(?:{_LETTER}|[0-9])*)")
_BRACKETED = re.compile(r"\[([A-Za-z][A-Za-z0-9_]*)\]")
_RATE = re.compile(r"\.(d{1,2})ot\b|(?:\(t\))?\.diff\(\s*t\s*(?:,\s*([t2])\s*)?\)")
_OPERAND = re.compile(r"\(|\s[^\W\d_]")  # Matches the begin of the operand of ddot as a word: a bracket or a symbol
_BEFORE_DIGITS = ("sin", "cos", "tan", "cot", "sqrt")  # Functions after which a digit begins a new word, as in sin2x

SEVERAL = {"Eq", "diff", "Derivative", *(name for name, word in WORDS.items() if word.most != 1)}
SEVERAL |= {name for name, strict in ALIASES.items() if strict in SEVERAL}
"""Functions of several arguments. In their brackets a comma between digits is not a decimal comma."""

# Matches a fraction that is not an exponent: small digits such as ¹⁄₂, or one character such as ½
_SMALL_FRACTION = re.compile(r"(?<![\w)\]}̇̈'])[⁰¹²³⁴⁵⁶⁷⁸⁹]+[⁄∕/][₀₁₂₃₄₅₆₇₈₉]+|[¼-¾⅐-⅞↉]")
_SUPERSCRIPT = re.compile(r"([⁺⁻]?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
_SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉ₐₑₕᵢⱼₖₗₘₙₒₚᵣₛₜᵤᵥₓ", "0123456789aehijklmnoprstuvx", strict=True))
OPENING = {"(": ")", "[": "]", "{": "}"}  # Closing bracket of each opening bracket
LONGEST_QUOTIENT = 20  # Largest number of tokens of d^n or of /dt^n
LONGEST_CALL = 300  # Largest number of tokens of a call such as diff(x, t, 2)
_CALLS = ("diff", "Diff", "Derivative")  # Functions that are derivatives of their first argument
NESTED = 5  # Largest number of levels of nested dots and diff(...), which are read recursively


@dataclass(frozen=True)
class Token:
    """Piece of a formula: its `kind`, its `text` in one notation, and its place text[begin:end] in the typed text.

    Kinds: "word", "number", "sign", "power" (a superscript), "prime" (text is the order), "index" (a subscript that
    follows a mark), "dots" (a LaTeX command for a derivative; text is the order), "rate" and "operator" (a time
    derivative; text is the order), "fault" (text is a sentence). `order` is the number of dots on the first letter of a
    word, and `primes` the number of primes after the word. `spaced` is true if a blank precedes the token.
    """

    kind: str
    text: str
    begin: int
    end: int
    order: int = 0
    spaced: bool = False
    primes: int = 0

    def is_sign(self, *signs: str) -> bool:
        """Return True if the token is one of these signs."""
        return self.kind == "sign" and self.text in signs


def bracketed(tokens: Sequence[Token]) -> list[Token]:
    """Return the tokens of a formula, with a bracket before and after them."""
    (begin, _), (last, end) = ((token.begin, token.end) for token in (tokens[0], tokens[-1]))
    return [Token("sign", "(", begin, begin), *tokens, Token("sign", ")", last, end)]


def tokens_of(text: str, begin: int, end: int) -> list[Token]:
    """Return the tokens of text[begin:end], with derivatives in one form.

    LaTeX dots and primes of a word are added to its `primes`. Any other derivative becomes a token of kind "rate",
    followed by its operand. If the operand is not marked, as in d/dt m x, the kind is "operator". The text of both
    kinds is the order. A subscript after a prime moves to its word. A character that cannot be read becomes a token of
    kind "fault".
    """
    return _leibniz(_marked(_Scanner(text, end).scan(begin), NESTED), NESTED)


class _Scanner:
    """Scanner that divides a text into tokens, in one pass from left to right."""

    def __init__(self, text: str, end: int) -> None:
        self.text, self.end = text[:end], end
        self.tokens: list[Token] = []
        self.spaced = False
        self.listing: list[bool] = []  # True for each open bracket of a function of several arguments

    def scan(self, offset: int) -> list[Token]:
        """Return all tokens of the text from an offset on."""
        while offset < self.end:
            blank = _BLANK.match(self.text, offset)
            if blank:
                self.spaced, offset = True, blank.end()
                continue
            offset = self._token(offset)
        return self.tokens

    def _add(self, kind: str, text: str, begin: int, end: int, order: int = 0) -> int:
        if kind == "sign" and text in "([{":
            self.listing.append(bool(self.tokens) and self.tokens[-1].text in SEVERAL)
        elif kind == "sign" and text in ")]}" and self.listing:
            self.listing.pop()
        self.tokens.append(Token(kind, text, begin, end, order, self.spaced))
        self.spaced = False
        return end

    def _token(self, offset: int) -> int:
        """Add the token at an offset to the list of tokens, and return the offset after it."""
        text, mark = self.text, self.text[offset]
        decimal = _DECIMAL_COMMA.match(text, offset)
        if decimal and not any(self.listing[-1:]):
            return self._add("number", ".".join(decimal.groups()), *decimal.span())
        if number := _NUMBER.match(text, offset):
            return self._add("number", number.group().removesuffix("."), *number.span())
        if small := _SMALL_FRACTION.match(text, offset):
            return self._fraction(unicodedata.normalize("NFKC", re.sub("[∕/]", "⁄", small.group())), *small.span())
        if superscript := _SUPERSCRIPT.match(text, offset):
            sign = "-" if superscript.group(1) == "⁻" else ""
            return self._add("power", sign + unicodedata.normalize("NFKC", superscript.group(2)), *superscript.span())
        if mark == "\\":
            return self._command(offset)
        if mark in PRIMES:
            return self._add("prime", str(PRIMES[mark]), offset, offset + 1)
        for sign in (text[offset : offset + 2], mark):
            if sign in SIGNS:
                return self._add("sign", SIGNS[sign], offset, offset + len(sign))
        index, after = self._indices(offset)
        if index:
            return self._add("index", index, offset, after)
        if mark.isalpha():  # Letters of all alphabets are read, so that messages name whole words
            return self._word(offset)
        return self._add("fault", f"the character {_named(mark)} cannot stand in an equation", offset, offset + 1)

    def _fraction(self, text: str, begin: int, end: int) -> int:
        """Add a fraction, such as "1⁄2", to the list of tokens. A whole number before it is added to it, as in 1½."""
        above, below = map(int, text.split("⁄"))
        last = self.tokens[-1] if self.tokens else None
        if last and last.end == begin and last.kind == "number" and last.text.isdigit():
            begin, above = self.tokens.pop().begin, int(last.text) * below + above
        return self._add("number", f"{above}/{below}", begin, end)

    def _word(self, offset: int) -> int:
        """Add the word at an offset to the list of tokens, and return the offset after it.

        A word consists of letters, digits and subscripts. A letter with dots begins a new word.
        """
        begin, spelled, order = offset, "", 0
        while offset < self.end:
            mark = self.text[offset]
            if not (mark.isalpha() or (mark.isascii() and mark.isdigit())):
                break
            letter, dots, after = _dotted(self.text, offset, self.end)
            if (dots and spelled) or (mark.isdigit() and spelled in _BEFORE_DIGITS):
                break
            spelled, order, offset = spelled + letter, order or dots, after
            index, offset = self._indices(offset)
            spelled += index
            if offset < self.end and self.text[offset] in DOTS and not order:
                order, offset = DOTS[self.text[offset]], offset + 1
        bracketed = _BRACKETED.match(self.text, offset) if spelled in ("lambda", "λ") else None
        if bracketed:
            spelled, offset = f"{spelled}_{bracketed.group(1)}", bracketed.end()
        rate = _RATE.match(self.text, offset)
        if rate:
            order, offset = order + (len(rate.group(1)) if rate.group(1) else 1 + bool(rate.group(2))), rate.end()
        if spelled in _DERIVATIVES and _OPERAND.match(self.text, offset):  # ddot(x) and ddot x
            return self._add("dots", str(_DERIVATIVES[spelled]), begin, offset)
        return self._add("word", spelled, begin, offset, order)

    def _indices(self, offset: int) -> tuple[str, int]:
        """Return consecutive subscripts at an offset as one text, such as _1_dot, and the offset after them."""
        joined = ""
        while offset < self.end:
            index = _PLAIN_INDEX.match(self.text, offset) or _INDEX.match(self.text, offset)
            if self.text[offset] in _SUBSCRIPTS:
                joined, offset = joined + _SUBSCRIPTS[self.text[offset]], offset + 1
            elif index:
                inside = _INDEX_COMMAND.sub("", next(group for group in index.groups() if group is not None))
                joined, offset = joined + "_" + re.sub(r"[\s,]+", "_", inside.strip()), index.end()
            else:
                break
        return joined, offset

    def _command(self, offset: int) -> int:
        """Add the token for the LaTeX command at an offset to the list of tokens, and return the next offset."""
        match = _COMMAND.match(self.text, offset)
        if match is None:
            return self._add("fault", "a backslash stands at the end", offset, offset + 1)
        name, after = match.group(1), match.end()
        if name in _SPACES or name.isspace():
            self.spaced = True
            return after
        if name in _COMMAND_SIGNS:
            sign = _COMMAND_SIGNS[name]
            return self._add("prime", "1", offset, after) if sign == "'" else self._add("sign", sign, offset, after)
        if name in _FRACTIONS:
            after = self._add("sign", "\\frac", offset, after)
            for _ in range(2):
                lone = _LONE.match(self.text, after)
                if lone:
                    self._add("sign", "{", *lone.span(1))
                    self._add("number" if lone.group(1).isdigit() else "word", lone.group(1), *lone.span(1))
                    after = self._add("sign", "}", *lone.span(1))
            return after
        if name in _DERIVATIVES:
            twice = self.text.startswith("[2]", after)  # \\dv[2]{x}{t}
            return self._add("dots", str(_DERIVATIVES[name] + twice), offset, after + 3 * twice)
        if name in _WORD_GROUPS:
            group = _GROUP.match(self.text, after)
            if group and group.group(1):
                index, end = self._indices(group.end())
                return self._add("word", group.group(1).replace("\\_", "_").replace(" ", "_") + index, offset, end)
            if group is None:  # \mathrm d sets one letter upright
                return after
        if name in _COMMAND_WORDS:
            index, end = self._indices(after)
            return self._add("word", _COMMAND_WORDS[name] + index, offset, end)
        instead = r": write \frac{}{}" if name == "over" else ""
        return self._add("fault", f"the LaTeX command {_named(name[:30])} is not known here{instead}", offset, after)


def _dotted(text: str, offset: int, end: int) -> tuple[str, int, int]:
    """Return the letter at an offset, the number of dots above it, and the offset after it.

    A variant of a Greek letter is spelled by its name, such as phi. A letter with other marks keeps them, without dots.
    """
    begin, offset = offset, offset + 1
    while offset < end and unicodedata.combining(text[offset]):
        offset += 1
    base, *marks = list(unicodedata.normalize("NFD", text[begin:offset]))
    if any(mark not in DOTS for mark in marks):
        return text[begin:offset], 0, offset
    return GREEK_VARIANTS.get(base, base), sum(DOTS[mark] for mark in marks), offset


def _named(mark: str) -> str:
    """Return a character or a command as printable text for a message."""
    if len(mark) > 1 or (mark.isascii() and mark.isalpha()):
        return f"\\{mark}"
    if mark.isprintable() and mark.isascii():
        return repr(mark)
    return f"U+{ord(mark):04X} ({unicodedata.name(mark, 'control character')})"


def closing(tokens: Sequence[Token], start: int) -> int:
    """Return the index of the bracket that closes the one at index `start`, or the number of tokens without one."""
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
    """Return the tokens of a formula, with dots, primes and the subscripts after them joined to their words.

    `levels` is the largest number of levels of nested dots.
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
            if len(inside) != 1 or inside[0].kind != "word":
                joined += [replace(token, kind="rate"), *group]
                continue
            primes = inside[0].primes + int(token.text)
            token = replace(inside[0], begin=token.begin, spaced=token.spaced, primes=primes)
        power: list[Token] = []
        if token.kind == "word":
            token, power, i = _with_marks(token, tokens, i)
        joined += [token, *power]
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
    """Return the tokens with d^2x/dt^2, d/dt(...) and diff(x, t, 2) replaced by tokens of kind "rate" or "operator".

    The operand follows the token. `levels` is the largest number of levels of nested diff(...).
    """
    replaced: list[Token] = []
    i = 0
    while i < len(tokens):
        match = _quotient(tokens, i) if tokens[i].text[0] in "d({\\" else None
        match = match or _call(tokens, i)
        if match is None:
            before = [token.text if token.kind == "sign" else token.kind for token in replaced[-2:]]
            if tokens[i].is_sign(")") and before == ["(", "operator"]:
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
r"""Patterns of d^n x/dt^n. `_TOP` matches a numerator such as d^2, dx or d2x. `_BOTTOM` matches the rest, as (t)/dt^2.

Keys of `_BOTTOM` are the beginnings of the numerator: none, a bracket, or \frac with a bracket. The patterns match the
text of tokens that `_spelled` returns.
"""


def _quotient(tokens: Sequence[Token], i: int) -> _Rate | None:
    """Return the derivative d^n x / dt^n at index i as (order, operand, next index), or None if there is none.

    x may be joined to d, as in dx/dt. The operand is a list of tokens.
    """
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
    """Return the match of `pattern` with the text of the tokens from index i on, and the index after the match.

    Without a match the index is i.
    """
    texts = list(map(_spelled, tokens[i : i + LONGEST_QUOTIENT]))
    match = pattern.match("".join(texts))
    return match, i + 1 + [*accumulate(map(len, texts))].index(match.end()) if match else i


def _spelled(token: Token) -> str:
    r"""Return a token as text for the patterns of quotients.

    Braces become round brackets, and \frac becomes \. A power begins with ^. Words, numbers and powers end with a
    blank. A token of another kind becomes an apostrophe.
    """
    if token.kind == "sign":
        return {"{": "(", "}": ")", "\\frac": "\\"}.get(token.text, token.text)
    return f"{'^' * (token.kind == 'power')}{token.text} " if token.kind in ("word", "number", "power") else "'"


def _call(tokens: Sequence[Token], i: int) -> _Rate | None:
    """Return the derivative diff(x, t, 2), Derivative(x, (t, 2)) or D[x, {t, 2}] that begins at index i, or None.

    The derivative is returned as (order, operand in brackets, next index).
    """
    opened = i + 1 < len(tokens) and tokens[i + 1].is_sign(*OPENING)
    named = tokens[i].text in _CALLS or (tokens[i].text == "D" and opened and tokens[i + 1].text == "[")
    if not (opened and named and tokens[i].kind == "word"):
        return None
    end = closing(tokens[: i + LONGEST_CALL], i + 1)
    if end >= min(len(tokens), i + LONGEST_CALL):
        return None
    inside = list(tokens[i + 2 : end])
    depths = accumulate(token.is_sign(*OPENING) - token.is_sign(*OPENING.values()) for token in inside)
    commas = (k for k, depth in enumerate(depths) if depth == 0 and inside[k].is_sign(","))
    comma = next(commas, len(inside))
    by = [token.text for token in inside[comma:] if token.kind != "sign"]
    if not comma or not by or any(word != "t" and not word.isdigit() for word in by):
        return None
    order = sum(1 if word == "t" else int(word) - 1 for word in by)
    return (order, bracketed(inside[:comma]), end + 1) if order in (1, 2) else None
