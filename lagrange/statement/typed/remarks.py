"""Words in an answer outside of equations: remarks, units, clauses such as "where g = 9.81", whole sentences.

A word belongs to a sentence only if it is not a symbol of the system. Text that can be read as an equation is kept
completely. A word that may be a misspelled symbol is kept, so that it is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

from lagrange.statement.typed.latex import ARROW
from lagrange.statement.typed.lines import CLOSE, OPEN, depth_of

_ASIDES = (
    *("where", "with", "for", "if", "when", "since", "because", "as", "here", "assuming", "provided", "using", "by"),
    *("wobei", "mit", "für", "wenn", "falls", "weil", "da"),
)
_LINKS = (
    *("so", "thus", "hence", "therefore", "then", "and", "or", "gives", "yields", "we", "get", "obtain", "is", "that"),
    *("from", "let", "answer", "solution", "eom", "ok", "qed", "done", "finally", "also", "und", "somit"),
)
_ARROW = re.compile(rf"=>|->|[⇒→⟹⟶∴]|{ARROW}")
_ASIDE = re.compile(rf"\b(?:{'|'.join(_ASIDES)})\b", re.IGNORECASE)
_UNIT = r"(?:rad|degrees|deg|kg|cm|mm|km|sec|Nm|Hz|m|s|N|J|W|g|°)"
# Without the possessive *+ the time is exponential in the length of a text such as "3 g- 3 g- 3 g- ...".
_UNITS = rf"{_UNIT}(?:\s?[*/·.]?\s?(?:{_UNIT}|[\^²³⁻¹\-0-9]))*+"
_UNITS_AT_END = re.compile(rf"\s(?:\[\s*{_UNITS}\s*\]|\(\s*{_UNITS}\s*\)|{_UNITS})[\s.]*$")
_NUMBER_AT_END = re.compile(rf"=\s*[-+]?[0-9][0-9.,]*(?:\s*[*·×]\s*10\s*\^?\s*[-0-9]+)?\s*(?:{_UNITS})?[\s.]*$")
_OPERATOR_AT_END = re.compile(r"[-+*/^=(\[{,\u2212·]\s*$")
_LETTERS = re.compile(r"[\s,;.]*(?:[A-Za-z]\.)+[A-Za-z]\.?\s*$")
_LAGRANGE = re.compile(r"∂|\\partial|\bd(?:L|T|V|U)\b")
_DEFINITION = re.compile(r"\(\s*(?=([^\W\d_]\w*)\s*(?:\^2|\*\*2|²)?\s*=)")
_DEFINED = re.compile(r"[\s(]*([^\W\d_]\w*)\s*(?:\([^()=]*\)\s*)?:?=")
_AT_START = re.compile(r"\s*\w+['’]*\s*\(\s*0\s*\)\s*")


@dataclass(frozen=True)
class Word:
    """The span of a word in a text.

    `known` is true for symbols and products of the system, also misspelled, and functions. `formula` is true for
    functions and derivatives, which sentences do not contain.
    """

    begin: int
    end: int
    known: bool
    formula: bool = False


@dataclass(frozen=True)
class Clause:
    """The span of one clause of a line. `aside` is true after words such as "where" and "with"."""

    begin: int
    end: int
    aside: bool = False


def clauses_of(text: str, begin: int, end: int, known: Callable[[str], bool]) -> list[Clause]:
    """Return the clauses of text[begin:end]: it is divided at arrows, at words such as "where" and before "(name =".

    A word that is a symbol of the system does not divide.
    """
    cuts = [(match.span(), False) for match in _ARROW.finditer(text, begin, end)]
    cuts += [(match.span(), True) for match in _ASIDE.finditer(text, begin, end) if not known(match.group())]
    cuts += [(match.span(), True) for match in _DEFINITION.finditer(text, begin, end) if not known(match.group(1))]
    clauses, start, aside = [], begin, False
    for (left, right), opens in sorted(cuts):
        clauses.append(_trimmed(text, start, left, aside))
        start, aside = right, opens
    clauses.append(_trimmed(text, start, end, aside))
    return [clause for clause in clauses if clause.end > clause.begin]


def _trimmed(text: str, begin: int, end: int, aside: bool) -> Clause:
    """Return a clause without punctuation at its ends and without brackets whose other ends are in other clauses."""
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
        enclosed = _brackets(text, begin, end)[begin] == end - 1
        return Clause(begin + enclosed, end - enclosed, aside)
    return Clause(begin, end, aside)


@dataclass(frozen=True)
class Line:
    """A part text[begin:end] of an answer, with its words."""

    text: str
    begin: int
    end: int
    words: tuple[Word, ...]

    @property
    def shown(self) -> str:
        """Text of the part."""
        return self.text[self.begin : self.end]

    def narrower(self) -> Iterator[tuple[int, int]]:
        """Yield candidate spans of the equation, without the words before and after it."""
        head = self._after_introduction()
        for start in dict.fromkeys((self.begin, head)):
            if start != self.begin:
                yield start, self.end
            for cut in self._remarks(start):
                before = self.text[start:cut].rstrip(" ,;")
                if "=" in before and not _OPERATOR_AT_END.search(before):
                    yield start, start + len(before)

    def is_remark(self) -> bool:
        """Return True if a part that cannot be read is not about the motion.

        It is a sentence, a definition of another quantity such as L = T - V, or Lagrange's formula.
        """
        if "=" not in self.shown or _LAGRANGE.search(self.shown):
            return True
        defined = _DEFINED.match(self.text, self.begin, self.end)
        first = self.words[0] if self.words else None
        if defined and first and first.begin == defined.start(1) and not first.known:
            return True
        return self._has_sentence(self.begin)

    def is_sentence(self) -> bool:
        """Return True if the part has two adjacent words of which one is not a symbol."""
        return self._has_sentence(self.begin)

    def is_value(self, parameter: Callable[[str], bool]) -> bool:
        """Return True if a part states a value of a parameter, such as g = 9.81, or of a coordinate at t = 0."""
        name, _, _ = self.shown.partition("=")
        if _AT_START.fullmatch(name):
            return True
        place = self.begin + len(name)
        return parameter(name.strip()) and bool(_NUMBER_AT_END.fullmatch(self.text, place, self.end))

    def _after_introduction(self) -> int:
        """Return the offset after the words that introduce an equation, `begin` without such words."""
        colon = self.text.rfind(":", self.begin, self.end)
        if colon >= 0 and any(not word.known for word in self.words if word.end <= colon):
            return colon + 1
        run: list[Word] = []
        place = self.begin
        for word in self.words:
            if word.formula or self.text[place : word.begin].strip(" \t\r\n.,;"):
                break
            run.append(word)
            place = word.end
        strange = [word for word in run if not word.known]
        if not strange or (len(run) == 1 and not self._links(run[0])):
            return self.begin
        if len(strange) == 1 and len(run) > 1 and not self._is_word(strange[0]):
            return self.begin
        return strange[-1].end

    def _remarks(self, begin: int) -> Iterator[int]:
        """Yield offsets at which a remark or a unit begins that reaches to the end of the part."""
        strange = [word for word in self.words if not word.known and word.begin >= begin]
        unit = _UNITS_AT_END.search(self.text, begin, self.end)
        if unit and any(word.begin >= unit.start() for word in strange):
            yield unit.start()
        if not strange:
            return
        place = strange[0].begin
        opened = (i for i, closing in _brackets(self.text, begin, place).items() if closing == place)
        bracket = next(opened, None)
        if bracket is not None:
            if self._is_remark_in_brackets(bracket):
                yield bracket
            return
        separator = max(self.text.rfind(mark, begin, place) for mark in (",", ";", "  ", "\t", ". "))
        for cut in (separator, place):
            if cut > begin and self._is_sentence(cut):
                yield cut

    def _is_remark_in_brackets(self, begin: int) -> bool:
        """Return True if brackets at the end of a part contain words, or one word of more than three letters."""
        inside = [word for word in self.words if word.begin >= begin]
        spaced = self.text[begin - 1 : begin].isspace()
        alone = len(inside) == 1 and (inside[0].end - inside[0].begin > 3 or self._links(inside[0]))
        plain = not re.search(r"[-+*/^=]", self.text[begin : self.end])
        strange = len(inside) > 1 and all(self._is_word(word) for word in inside)
        return spaced and (self._has_sentence(begin) or (alone and plain) or strange)

    def _is_sentence(self, begin: int) -> bool:
        """Return True if the end of a part consists of words and not of factors."""
        rest, words = self.text[begin : self.end], [word for word in self.words if word.begin >= begin]
        if _LETTERS.match(rest) or (len(words) == 1 and self._links(words[0])):
            return True
        return not re.search(r"[+*/^]", rest) and self._has_sentence(begin)

    def _has_sentence(self, begin: int) -> bool:
        """Return True if two adjacent words follow of which one is neither a symbol nor a short name."""
        pairs = pairwise(word for word in self.words if word.begin >= begin)
        return any(
            not self.text[left.end : right.begin].strip(" \t\r\n.,;:")
            and self.text[left.end : right.begin]
            and not left.formula
            and (self._is_word(left) or self._is_word(right))
            for left, right in pairs
        )

    def _is_word(self, word: Word) -> bool:
        spelled = self.text[word.begin : word.end]
        return not word.known and "dot" not in spelled and (len(spelled) > 2 or self._links(word))

    def _links(self, word: Word) -> bool:
        """Return True if a word is a conjunction or another word that joins equations."""
        return self.text[word.begin : word.end].lower() in (*_LINKS, *_ASIDES)


def _brackets(text: str, begin: int, end: int) -> dict[int, int]:
    """Return {offset of an opening bracket: offset of its closing one} in text[begin:end]; `end` if none closes it."""
    pairs, opened = dict[int, int](), list[int]()
    for i in range(begin, end):
        if text[i] in OPEN:
            opened.append(i)
            pairs[i] = end
        elif text[i] in CLOSE and opened:
            pairs[opened.pop()] = i
    return pairs
