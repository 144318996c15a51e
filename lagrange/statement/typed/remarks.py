"""Sort the words of a typed answer outside of its equations: remarks, units, definitions, clauses not about the motion.

A part of an equation is left out only if it is set apart: prose in brackets, prose after a comma or similar, and words
before the equation that end with a connecting word. Any other word that is not a symbol is a fault. A clause without an
acceleration may be left out as a whole, since the other clauses must then determine the motion. A clause may define a
new name, such as r = sqrt(x^2 + y^2), m r^2 phi' = L or w^2 = k/m.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise, takewhile

from lagrange.statement.typed.lines import CLOSE, OPEN, depth_of, separated
from lagrange.statement.typed.names import SPELLINGS, Names, canonical
from lagrange.statement.typed.respelling import CONSEQUENCE
from lagrange.statement.typed.tokens import Token
from lagrange.statement.vocabulary.letters import GREEK

_ASIDES = "where|with|for|if|when|since|because|as|here|assuming|provided|using|wobei|mit|fur|wenn|falls|weil|da"
# Words that may precede an equation directly
_CONNECTING = re.compile(
    "so|thus|hence|therefore|then|and|or|are|gives|yields|get|obtain|find|is|be|that|reads|becomes|follows|which|finally|"
    "answer|solution|result|eom|also|und|oder|somit|daher|damit|dann|folgt|gilt|ist|lautet|ergibt|sich|antwort|"
    "ergebnis|losung"
)
# Words that are read as signs of operations
OPERATIONS = {"plus": "+", "minus": "-", "times": "*", "mal": "*", "over": "/", "durch": "/"}
_UNREAD = ("squared", "divided", "geteilt", "multiplied")  # Words for operations that are refused

# Words before which an equation is not read, unless a comma and a connecting word follow
_NEGATIONS = ("not", "nicht", "no", "kein", "keine", "wrong", "falsch")
_AFTER_COMMA = re.compile(rf"[^=,;.]*[,;.]\s*(?:{_CONNECTING.pattern})\b")

# Short words that may occur between symbols, which they do not make prose
_JOINING = ("and", "or", "und", "oder", "by", "per", "pro", "of")
# Words with which prose after an equation may begin
_ENDING = (*_JOINING, "is", "be", "we", "this", "it", "ist", "sei", "wir", "das", "dies", "es")
_ARROW = re.compile(rf"{CONSEQUENCE}|(?:[,;]\s*[\w()-]+(?:[ \t][\w()-]+)?\s*)?:")
_ASIDE = re.compile(rf"(?<!\\)\b(?:{_ASIDES})\b", re.IGNORECASE)
_UNIT = r"(?:rad|degrees|deg|kg|cm|mm|km|sec|Nm|Hz|m|s|N|J|W|g|°)"
# The quantifier *+ must be possessive. Otherwise the time is exponential in the length of a text "3 g- 3 g- 3 g- ...".
_UNITS = rf"{_UNIT}(?:\s?[*/·.]?\s?(?:{_UNIT}|[\^²³⁻¹\-0-9]))*+"
_UNITS_ALONE = re.compile(rf"\s*(?:{_UNITS}|\w+\s+in\s+{_UNITS}(?:,\s*\w+\s+in\s+{_UNITS})*)[\s.]*")
_NUMBER_AT_END = re.compile(rf"=\s*[-+]?[0-9][0-9.,]*(?:\s*[*·×]\s*10\s*\^?\s*[-0-9]+)?\s*(?:{_UNITS})?[\s.]*$")
_ALWAYS = r"(?:\b(?:for|fur)\s+)?\b(?:all|any|every|alle)\s+(?:times?|zeiten|t)|∀\s?t"
# Matches words at the end of an equation without a meaning for it: Q.E.D., for all times
_PROVEN = re.compile(rf"(?:\bq\.?\s?e\.?\s?d|\bw\.?\s?z\.?\s?b\.?\s?w|{_ALWAYS})[.)\s]*$", re.IGNORECASE)
_MARK = re.compile(rf"[,;!←]|\.\s|//|<?--|<-|\u2014|\\q?quad(?![A-Za-z])|[ \t]{{2,}}|{_ASIDE.pattern}", re.IGNORECASE)
_BRACKET = re.compile(r"(?<!\S)[(\[]([^()\[\]{}=]*)[)\]]")
# Matches signs of formulas. A hyphen in a word is not one.
_SIGNS = re.compile(r"[=^|\\+*/−·]|-(?![^\W\d_])|(?<![^\W\d_])-")
# Matches a remark such as "dividing both by m"
_DIVISION = re.compile(r"\s*(?:after\s+)?divid(?:ed|ing)\s(?:\w+\s)?by\s[^=+]*", re.IGNORECASE)
_INEQUALITY = re.compile(r"(?<![-=<])[<>](?![=>])|[<>]=|[≤≥]|\\(?:[lg]eq?|[lg]t)(?![A-Za-z])")
_NEVER = re.compile(r"[=^|\\]")
_LAGRANGE = re.compile(r"(?:∂|\\partial)\s*[LTVU]\b|\bd[LTVU]\b")
_STATEMENT = re.compile(r"(?<!\S)[(\[](?=[^()\[\]=]*=)")
_STATEMENT_END = re.compile(r"(?<!\S)[(\[][^()\[\]=]*=[^()\[\]]*([)\]]\s*[,;])")
_DEFINED = re.compile(r"[\s(]*\\?[^\W\d_][\w{}\\]*\s*(?:\^2|\*\*2|²|\([^()=]*\))?\s*=")
# Matches the definition of the Lagrangian, L = T - V
_ENERGIES = re.compile(r"=\s*[TK]\s*[-\u2212]\s*[VU]\s*(?:=|$)")
_AT_START = re.compile(r"\s*\w+['’]*\s*\(\s*0\s*\)\s*")

_PUNCTUATION = " \t\r\n.,;"

SYMBOL, FORMULA, NAME, WORD, SHORT = "symbol", "formula", "name", "word", "short"
"""Kinds of words: a symbol or product of the system, also misspelled; a function or derivative; another name such as
F_x; a word of a sentence; a short word that does not make prose out of symbols."""


def kind_of(text: str) -> str:
    """Return the kind of a word that is not a symbol of the system.

    It is `FORMULA` for a function or derivative, `NAME` for another name such as F_x or Omega, and `WORD` for a word of
    a sentence. It is `SHORT` for a word of at most two letters and for words such as "and", which may occur among
    symbols without making them prose.
    """
    lower = text.lower()
    if lower in (*OPERATIONS, *_UNREAD):
        return FORMULA
    if lower in _JOINING:
        return SHORT
    spelled = text[1:].islower() or text in "aI" or (text.isupper() and len(text) > 2)
    if not (spelled and text.isalpha()) or "dot" in lower or lower in GREEK.values():
        return NAME
    return WORD if len(text) > 2 else SHORT


@dataclass(frozen=True)
class Clause:
    """Part text[begin:end] of an answer, which consists of typed equations and remarks, with its tokens.

    In the tokens derivatives have one form for all notations. `names` are the symbols of the system. `aside` is true
    after words such as "where" and "with". `constant` is true if the part states that its value is constant.
    """

    text: str
    begin: int
    end: int
    tokens: tuple[Token, ...]
    names: Names
    aside: bool = False
    constant: bool = False

    @property
    def shown(self) -> str:
        """The text of the clause itself: text[begin:end], unchanged."""
        return self.text[self.begin : self.end]

    @cached_property
    def words(self) -> tuple[Token, ...]:
        """Words of the clause as tokens, with kinds such as NAME or WORD."""
        words = []
        for token in (token for token in self.tokens if token.kind == "word"):
            pieces = next(iter(self.names.readings(token.text)), [])
            if token.order or token.primes or any(piece.kind == "function" or piece.order for piece in pieces):
                kind = FORMULA
            elif pieces or self.names.hint(token.text):
                kind = SYMBOL
            else:
                kind = kind_of(self.text[token.begin : token.end])
            words.append(replace(token, kind=kind))
        return tuple(words)

    def part(self, begin: int, end: int, *, aside: bool = False) -> Clause:
        """Return text[begin:end] of this clause as a clause. `aside` is true for a remark beside an equation."""
        tokens = tuple(token for token in self.tokens if begin <= token.begin < end)
        return Clause(self.text, begin, end, tokens, self.names, aside)

    def formula(self) -> list[Token]:
        """Return the tokens of the clause, with signs in place of words for operations that are not symbols."""
        return [
            replace(token, kind="sign", text=OPERATIONS[token.text])
            if token.text in OPERATIONS and token.kind == "word" and not self.names.readings(token.text)
            else token
            for token in self.tokens
        ]

    def sides(self) -> list[list[Token]]:
        """Return the sides of the equation in the clause. Each is a list of tokens."""
        sides: list[list[Token]] = [[]]
        for token in self.formula():
            if token.is_sign("="):
                sides.append([])
            else:
                sides[-1].append(token)
        return sides

    def without_brackets(self) -> Clause:
        """Return the clause with blanks in place of brackets that contain prose or units."""
        text = self.text
        for match in _BRACKET.finditer(text, self.begin, self.end):
            unit = match.group()[0] == "[" and _UNITS_ALONE.fullmatch(match.group(1))  # [m] at the end of a line
            if self._is_apart(*match.span(1)) or (unit and not text[match.end() : self.end].strip()):
                text = text[: match.start()] + " " * len(match.group()) + text[match.end() :]
        return replace(self, text=text, tokens=tuple(token for token in self.tokens if not text[token.begin].isspace()))

    def clauses(self) -> list[Clause]:
        """Return the clauses into which this line is divided.

        The line is divided at arrows and colons, before brackets with an equation, and at words such as "where" between
        two signs of equality. A word that is a symbol of the system does not divide it.
        """
        text, begin, end = self.text, self.begin, self.end
        asides = [match for match in _ASIDE.finditer(text, begin, end) if "=" in text[match.end() : end]]
        # Spans between two clauses, and True if the second clause is a remark beside the first
        cuts = [(match.span(), False) for match in _ARROW.finditer(text, begin, end)]
        cuts += [(match.span(), True) for match in asides if not self.names.readings(match.group())]
        cuts += [(match.span(), True) for match in _STATEMENT.finditer(text, begin, end)]
        cuts += [(match.span(1), False) for match in _STATEMENT_END.finditer(text, begin, end)]
        cuts += [(span, False) for span in self._prose() if "=" in text[begin : span[0]]]
        clauses, start, aside = [], begin, False
        for (left, right), begins_aside in sorted(cuts):
            if begins_aside and "=" not in text[start:left] and text[start:left].strip():
                continue
            clauses.append(self._trimmed(start, left, aside))
            start, aside = right, begins_aside or (aside and text[left] not in CLOSE)
        clauses.append(self._trimmed(start, end, aside))
        parts = (part._trimmed(*span, part.aside) for part in clauses for span in separated(text, part.begin, part.end))
        return [clause for clause in parts if clause.end > clause.begin]

    def _trimmed(self, begin: int, end: int, aside: bool) -> Clause:
        """Return text[begin:end] as a clause, without punctuation and unpaired brackets at its ends.

        `aside` is true for a remark beside an equation.
        """
        text = self.text
        depth = depth_of(text[begin:end])
        while end > begin and (text[end - 1] in " \t\r\n,;" or (text[end - 1] in OPEN and depth > 0)):
            end -= 1
            depth -= text[end] in OPEN
        while aside and end > begin and text[end - 1] in ")] ." and (depth < 0 or text[end - 1] in " ."):
            end -= 1
            depth += text[end] in CLOSE
        while begin < end and text[begin] in " \t\r\n,;":
            begin += 1
        if text[begin : begin + 1] == "(" and text[end - 1] == ")" and "=" in text[begin:end]:
            enclosed = all(accumulate((mark in OPEN) - (mark in CLOSE) for mark in text[begin : end - 1]))
            begin, end = begin + enclosed, end - enclosed
        return self.part(begin, end, aside=aside)

    def equation(self, *, moves: bool) -> tuple[int, int]:
        """Return the span (begin, end) of the equation in this clause, without words before it and remarks after it.

        `moves` is true if the equation has an acceleration. Then words before it are left out only if they end with a
        connecting word, or if they are more than two.
        """
        begin, end = self._after_words(moves=moves), self._before_remarks()
        introduced = any(word.end == begin and self._is_connecting(word) for word in self.words)
        comma = self.text.find(",", begin, end)
        if not moves and comma > 0 and self._is_apart(begin, comma):
            begin = comma + 1
        last = [word for word in self.words if begin < word.begin < end and self._is_connecting(word)][-1:]
        if last and not self.text[last[0].end : end].strip(_PUNCTUATION):
            end = last[0].begin
        if self.text[begin:end].lstrip().startswith(("=", "*", "/", "^") if introduced else ("=", "+", "*", "/", "^")):
            begin = self.begin  # Words before a sign are part of the equation
        while end > begin and self.text[end - 1] in _PUNCTUATION:
            end -= 1
        while end > begin and self.text[begin] in _PUNCTUATION:
            begin += 1
        return begin, end

    def _after_words(self, *, moves: bool) -> int:
        """Return the offset of the equation after the words before it. `moves` is true if it has an acceleration."""
        run = self._introduction()
        sure = not moves or [word.kind for word in run].count(WORD) > 2
        ends = [word.kind != SYMBOL if sure else self._is_connecting(word) for word in run]
        cut = max((i for i, last in enumerate(ends, 1) if last), default=0)
        kinds = [word.kind for word in run[:cut]]
        return run[cut - 1].end if cut and kinds.count(WORD) >= kinds.count(SYMBOL) else self.begin

    def _before_remarks(self) -> int:
        """Return the offset of the first remark after the equation, or the end of the clause."""
        proven = _PROVEN.search(self.text, self.begin, self.end)
        end = proven.start() if proven else self.end
        end -= bool(proven) and self.text[:end].endswith("(")
        for mark in reversed([*_MARK.finditer(self.text, self.begin, end)]):
            wide = mark.group().isspace()
            if self._is_unit(mark.end(), end) if wide else self._is_apart(mark.end(), end, bare=mark.group().isalpha()):
                end = mark.start()
        return end

    def is_remark(self, *, introduces: bool = False) -> bool:
        """Return True if this clause, which has no acceleration and cannot be read, is not about the motion.

        It is prose, a sentence, an inequality, or the definition of another quantity such as L = T - V. A word at the
        beginning makes the clause a sentence, except after "where". If `introduces` is true, the clause ends with a
        colon before an equation, and only a sentence is a remark.
        """
        run = [word.kind for word in self._introduction()]
        sentence = WORD in run and len(run) - run.count(SYMBOL) > 1
        if introduces:
            return sentence
        kinds = [word.kind for word in self.words]
        if _INEQUALITY.search(self.text, self.begin, self.end):
            return True
        left, equality, _ = self.shown.partition("=")
        if not equality:
            bare = not _SIGNS.search(self.shown) and FORMULA not in kinds
            joining = bool(kinds) and {*kinds} <= {WORD, SHORT}
            prose = kinds[:1] == [WORD] and kinds[-1] in (WORD, SHORT)
            return self._is_apart(self.begin, self.end) or (bare and (prose or joining))
        begin, _ = self.equation(moves=False)
        first = next((word.kind for word in self.words if word.begin >= begin), SYMBOL)
        if _DEFINED.match(self.text, begin, self.end) and first in (NAME, WORD, SHORT):
            return True
        explained = left.strip().isalnum() and self._is_apart(self.begin + len(left) + 1, self.end)
        return explained or sentence or (not self.aside and kinds[:1] == [WORD])

    def is_law(self, begin: int, end: int) -> bool:
        """Return True if text[begin:end] contains Lagrange's formula, d/dt dL/dq' - dL/dq = 0."""
        return bool(_LAGRANGE.search(self.text, begin, end))

    def is_value(self) -> bool:
        """Return True if the clause states a value of a parameter, a value of a coordinate at t = 0, or L = T - V."""
        name, _, _ = self.shown.partition("=")
        if _AT_START.fullmatch(name) or _ENERGIES.search(self.text, self.begin, self.end):
            return True
        pieces = next(iter(self.names.readings(name.strip())), [])
        constant = len(pieces) == 1 and pieces[0].kind == "symbol" and not pieces[0].moves
        return constant and bool(_NUMBER_AT_END.fullmatch(self.text, self.begin + len(name), self.end))

    def _introduction(self, first: int = 0) -> Sequence[Token]:
        """Return consecutive words from word number `first` on, between which there are only blanks and punctuation.

        If `first` is 0, the first word must begin the clause. The words end before a symbol, a function, a negation, or
        a word that is followed by "=", since such a word is a name.
        """
        offset, run = self.words[first].begin if first else self.begin, list[Token]()
        for word in self.words[first:]:
            negated = self._spelled(word) in _NEGATIONS and not _AFTER_COMMA.match(self.text, word.end, self.end)
            named = self.text[word.end : self.end].lstrip().startswith("=")
            if negated or named or word.kind in (FORMULA, NAME) or self.text[offset : word.begin].strip(_PUNCTUATION):
                break
            run.append(word)
            offset = word.end
        return run

    def _prose(self) -> Iterator[tuple[int, int]]:
        """Yield the spans (begin, end) of prose, such as "we get", at which a line is divided.

        Prose is three words in a row that are not symbols, or two if one is connecting. It precedes an equation, or it
        ends the clause and begins with a word such as "and" or "is".
        """
        for i in range(1, len(self.words)):
            run = [*takewhile(lambda word: word.kind in (WORD, SHORT), self._introduction(i))]
            plain = [word.kind for word in run].count(WORD)
            if plain > 2 or (len(run) > 1 and any(map(self._is_connecting, run))):
                rest = self.text[run[-1].end : self.end]
                value = self.text.rfind("=", self.begin, run[0].begin)
                ends = not rest.strip(_PUNCTUATION) and not _ASIDE.search(self.text, value, run[0].begin)
                if "=" in rest or (ends and self._spelled(run[0]) in _ENDING):
                    yield run[0].begin, run[-1].end

    def _is_unit(self, begin: int, end: int) -> bool:
        """Return True if text[begin:end] is a unit, and not all of its words are symbols of the system."""
        unit = _UNITS_ALONE.fullmatch(self.text, begin, end)
        return bool(unit) and any(word.kind != SYMBOL for word in self.words if begin <= word.begin < end)

    def _is_apart(self, begin: int, end: int, *, bare: bool = False) -> bool:
        """Return True if text[begin:end] is prose or a unit, which is left out in brackets or after punctuation.

        Prose has at least as many words as symbols and names together. If `bare` is true, it follows "where" without a
        comma, and must have more words.
        """
        words = [word for word in self.words if begin <= word.begin and word.end <= end]
        kinds = [word.kind for word in words]
        names = len(kinds) - kinds.count(WORD) - kinds.count(SHORT)
        if self._is_unit(begin, end) or _DIVISION.fullmatch(self.text, begin, end):
            return True
        if FORMULA in kinds or kinds.count(WORD) < max(1, names + bare):
            return False
        product = any(
            not {left.kind, right.kind} & {WORD, SHORT} and self.text[left.end : right.begin].isspace()
            for left, right in pairwise(words)
        )
        signs = _SIGNS if names or re.search(r"\d", self.text[begin:end]) else _NEVER
        return not product and not signs.search(self.text, begin, end)

    def _is_connecting(self, word: Token) -> bool:
        return bool(_CONNECTING.fullmatch(self._spelled(word)))

    def _spelled(self, word: Token) -> str:
        return self.text[word.begin : word.end].lower() if word.kind != SYMBOL else ""


_CONSTANT = (["const"], ["constant"], ["konst"])  # Right sides that state that a quantity is constant
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")  # Matches a name that a line may define

# Matches the name of a force, such as a tension T1: one equation may define it, and another use it
_FORCE = re.compile(r"[TNSFHVf](?:_?[0-9A-Za-z])?")
_LONE = (("",), ("", "2"), ("", "^", "2"))  # Sides that are the defined name, written as "", or its square


def is_constant(side: Sequence[Token]) -> bool:
    """Return True if a side of an equation, a list of tokens, is the word "const"."""
    return [token.text for token in side] in _CONSTANT


@dataclass(frozen=True)
class Definition:
    """Equation that defines the name `name`. It has two `sides`, of which one may be the name alone.

    `lone` is true if a side is the name or its square, if the name is a force, if the equation has no velocities, or if
    it says that the name is a multiple of a known symbol. If the equation also states that a value is constant,
    `constant` is a clause with that value; else None.
    """

    name: str
    sides: tuple[list[Token], list[Token]]
    lone: bool
    constant: Clause | None = None

    @classmethod
    def of(cls, clause: Clause, uses: Uses, names: Names) -> Definition | None:
        """Return the definition that a clause states, or None.

        A definition has one unknown name, which other clauses contain. If the equation is not `lone`, another clause
        must state the derivative of the name or that it is constant. A word such as Mt in Mt = M + m is also a name if
        it is a product of symbols. `uses` are the occurrences of unknown names in the answer.
        """
        stated, sides = is_constant(clause.sides()[-1]), _defining_sides(clause, uses, names)
        words = [token for side in sides for token in side if token.kind == "word" and not names.readings(token.text)]
        if not words and len(sides) == 2 and _renames(sides[0], sides[1], names):
            words = sides[0]
        marked = any(word.order or word.primes for word in words)
        if len(sides) != 2 or not all(sides) or marked or len({word.text for word in words}) != 1:
            return None
        name = "".join(GREEK.get(mark, mark) for mark in words[0].text)
        changes, shared = uses.changes(canonical(name), clause), uses.contain(canonical(name), clause)
        texts = [tuple("" if token in words else token.text for token in side) for side in sides]
        alone = [k for k, text in enumerate(texts) if text in _LONE]  # Indices of the sides that are the name
        order = names.order(sides[0] + sides[1])
        if alone or stated:
            lone = bool(alone)
        elif _FORCE.fullmatch(name):  # With constraints, f is a force of constraint, and defines nothing
            lone = shared and not (name[0] == "f" and any(known.startswith("lambda_") for known in names.names))
        else:
            lone = order == 0 or _is_multiple(sides, words, names)
        if not (changes or (lone and shared)) or not _NAME.fullmatch(name) or (order > 1 and not lone):
            return None
        value = sides[1 - alone[0]] if alone else sides[0]
        constant = None
        if stated or (alone == [1] and names.order(value) == 1 and not changes):
            constant = replace(clause.part(value[0].begin, value[-1].end, aside=not stated), constant=True)
        return cls(name, (sides[0], sides[1]), lone, constant)


def _defining_sides(clause: Clause, uses: Uses, names: Names) -> list[list[Token]]:
    """Return the sides of a clause that is tried as a definition, without "const", general laws and unused names.

    Examples: p = dL/dx' = m x' defines p. Of the unknown names in p = m r^2 phi' = l, the last one that other clauses
    contain is defined.
    """
    sides = clause.sides()
    sides = sides[:-1] if is_constant(sides[-1]) else sides
    if len(sides) > 2:
        sides = [side for side in sides if not (side and clause.is_law(side[0].begin, side[-1].end))]
    if len(sides) > 2:
        unknown = [side for side in sides if len(side) == 1 and not names.readings(side[0].text)]
        used = [side for side in unknown if uses.contain(canonical(side[0].text), clause)]
        sides = [used[-1], *(side for side in sides if side not in unknown)] if used else sides
    return sides


def _is_multiple(sides: Sequence[Sequence[Token]], words: Sequence[Token], names: Names) -> bool:
    """Return True if one side is a known symbol, and the other one of `words` times constants, as in a = R alpha."""
    others = [token for side in sides if len(side) > 1 for token in side if token.kind == "word" and token not in words]
    known = [side for side in sides if len(side) == 1 and side[0].kind == "word"]
    constant = not any(piece.moves for token in others for piece in names.readings(token.text)[0])
    return len(known) == 1 and constant


def _renames(left: Sequence[Token], right: Sequence[Token], names: Names) -> bool:
    """Return True if the left side is one word that is a product of symbols, and no coordinate is on either side.

    An equation between parameters alone can only define a name.
    """
    words = [token for token in (*left, *right) if token.kind == "word"]
    readings = [names.readings(word.text) for word in words]
    moving = any(piece.moves and piece.name != "t" for pieces in readings for piece in pieces[0])
    return len(left) == 1 and len(words) > 1 and words[0] is left[0] and len(readings[0][0]) > 1 and not moving


class Uses:
    """Clauses of an answer in which unknown words and products of symbols occur.

    An answer is a text of typed equations, and clauses are its parts. `words` maps each word to the offsets of the
    clauses that contain it. `changed` has only clauses that state its derivative, or that it is constant.
    """

    def __init__(self, clauses: Sequence[Clause]) -> None:
        self.words: dict[str, set[int]] = {}
        self.changed: dict[str, set[int]] = {}
        for clause in clauses:
            constant = is_constant(clause.sides()[-1])
            for before, token in zip((None, *clause.tokens), clause.tokens, strict=False):
                if token.kind != "word" or len(next(iter(clause.names.readings(token.text)), [])) == 1:
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
        """Return True if a clause other than `clause` states the derivative of a name, or that the name is constant."""
        rates = (name + ending for endings in SPELLINGS[1:] for ending in endings)
        offset_sets = [self.changed.get(name, set()), *(self.words.get(rate, set()) for rate in rates)]
        return any(offsets - {clause.begin} for offsets in offset_sets)
