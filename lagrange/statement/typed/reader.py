"""Read equations as people type them: plain, with primes or dots, in Unicode or LaTeX, over several lines.

The text becomes the strict notation of scene files, and only `scene.expressions` builds expressions from it. So limits
on length, depth and work apply, and no code is run.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.errors import SceneError, StatementError, listing
from lagrange.statement.coordinate import t
from lagrange.statement.scene.expressions import read_expression
from lagrange.statement.scene.toml_document import line_and_column
from lagrange.statement.typed.grammar import Choices, Formula, TypedFault, UnknownWord, faults_of, parsed
from lagrange.statement.typed.lines import equation_spans
from lagrange.statement.typed.matrices import rows_of, without_bars
from lagrange.statement.typed.names import RATES, Names, canonical
from lagrange.statement.typed.remarks import Clause, Definition, Uses, is_constant
from lagrange.statement.typed.respelling import MATRIX, PLAIN_LETTERS
from lagrange.statement.typed.tokens import Token, bracketed, tokens_of
from lagrange.statement.vocabulary.letters import GREEK, WORD

_HTML = re.compile(r"\s*<(?:!doctype|html)\b", re.IGNORECASE)
LONGEST_TEXT = 8_000  # Largest number of characters of one equation; the longest one of a scene has 2,517
LONGEST_ANSWER = 60_000  # Largest number of characters of a text with equations
_VALUE = sympy.Dummy("value", real=True)  # Symbol for a name that is defined, or for its square

# Matches words with marks that mean derivatives in formulas: Newton's, für
_OF_SENTENCES = re.compile(r"[^\W\d_]+['’]s\b|[^\W\d_]*[äöüÄÖÜ][^\W\d_]*")
# Matches a name that is not a symbol of the system, but may be a factor of both sides of an equation
_FREE = re.compile(rf"[A-Za-z](?:_?[0-9A-Z]|_[a-z])?|{'|'.join(GREEK.values())}")
MOST_FREE = 3  # Largest number of names in one equation that may be factors of both sides
EQUAL = 1e-20  # Largest difference of equal numbers of 30 digits, relative to the numbers or to 1

# Matches words and signs on the line of an equation for small motions
_SMALL = re.compile(r"\bsmall\b|\bkleine?[nr]?\b|\blineari[sz]|≈|\\approx", re.IGNORECASE)
# Matches the name H of a force or a Hamiltonian. With a bracket after it, H is Heaviside's function.
_NAME_H = re.compile(r"(?<!\w)H(?!\w|\}?\s*\()")
_NAMED_MATRIX = re.compile(rf"(?<!\w)([A-Z])\s*&?=\s*{MATRIX}")
# Matches a list or a vector: commas without a sign =, commas in brackets after it, or a unit vector
_LIST = re.compile(r"[^=]*,[^=]*|[^=]*=\s*[(\[][^=]*,[^=]*[)\]]\s*|.*(?:\\hat(?![A-Za-z]).*|\^)")
# Matches words before an equation that holds only at rest
_STILL = re.compile(r"\b(?:equilibri|stationary|static|gleichgewicht|ruhelage)", re.IGNORECASE)
# Replacements of these marks, of the same length. The apostrophe of a word becomes a letter that is similar to it.
_ACCENTS = str.maketrans("äöüÄÖÜ'’", "aouAOU\u02bc\u02bc")
MOST_CHAINED = 4  # Largest number of definitions of which each uses the one on the next line
MOST_DEFINED = 40  # Largest number of equations of one text that are tried as definitions
MOST_EQUATIONS = 1_000  # Largest number of equations of one text
MOST_TOLD = 20  # Largest number of faults that are written as sentences. Fewer fit into a message.
LONGEST_REFUSAL = 360  # Largest number of characters of the faults in a message, which then has less than 400
READ_SO_FAR = " Before the first fault it is read as {}."  # Sentence on the part of an equation before its first fault
LONGEST_SYMBOLS = 120  # Largest number of characters of the list of symbols in a message


@dataclass(frozen=True)
class Reading:
    """One reading of a typed equation. `zero` is its left minus its right side, and `right` its right side.

    `read` is the equation as it was understood, in the strict notation and with both sides. `differentiated` are the
    expressions whose time derivative was typed, as in d/dt(m x'), or as dp/dt with p = m x'. `terms` are the other
    terms of each side as typed, before SymPy adds like terms; () if nothing was differentiated or added. `meanings`
    maps the symbols that the answer defines to their values; all other symbols are those of the system.

    `others` are the less likely readings of the same equation. `aside` is true for a remark such as "in equilibrium x =
    m g/k", which need not hold for every motion. In a chain a = b = c, which is several equations, `link` is the index
    of the equation, from 0.
    """

    zero: Any
    right: Any = sympy.S.Zero
    read: str = ""
    differentiated: tuple[Any, ...] = ()
    terms: tuple[tuple[Any, ...], ...] = ()
    meanings: Mapping[Any, Any] = field(default_factory=dict)
    others: tuple[Reading, ...] = ()
    aside: bool = False
    link: int = 0


class TypedReader:
    """Reader of typed equations in the symbols of one system.

    `symbols` maps names as in scene files to SymPy expressions: q, q_dot and q_ddot of each coordinate, parameters,
    given functions and multipliers. `others` maps other spellings of multipliers and rates to such names. `meanings`
    maps the symbols that the answer defines, and their time derivatives, to their values.
    """

    def __init__(
        self, symbols: Mapping[str, Any], others: Mapping[str, str], meanings: Mapping[Any, Any] = MappingProxyType({})
    ) -> None:
        self.meanings = dict(meanings)
        self.symbols = {**symbols, **{symbol.name: symbol for symbol in meanings}}
        self.others = dict(others)
        self.names = Names(self.symbols, self.others, {symbol.name for symbol in meanings})
        pairs = [(base + low, base + high) for base in self.names.bases for low, high in pairwise(RATES)]
        known = {self.symbols[low]: self.symbols[high] for low, high in pairs if {low, high} <= self.symbols.keys()}
        self.rates = {low: high for low, high in known.items() if low.is_Symbol}  # {symbol: its time derivative}
        velocities = self.rates.keys() & self.rates.values()
        self.momenta = {symbol.name for symbol, x in self.meanings.items() if x.free_symbols & velocities}

    def _clauses(self, text: str, what: str) -> tuple[TypedReader, list[Clause]]:
        """Return the equations and remarks of a text as clauses, and a reader that knows the names defined in the text.

        Clauses that are definitions are left out. `what` is the label of the text in messages.
        """
        clean, spans = self._spans(text, what)
        clean = _OF_SENTENCES.sub(self._without_accents, clean)
        lines = [self._clause(clean, *span).without_brackets() for span in spans]
        whole = [self._with_plain_names(clause) for line in lines for clause in line.clauses()]
        try:
            rows = rows_of(without_bars([clause.tokens for clause in whole], self.names), self.names)
        except TypedFault as fault:
            raise StatementError(self._refusal(text, [fault], what)) from None
        clauses = [replace(clause, tokens=(*row,)) for clause, each in zip(whole, rows, strict=True) for row in each]
        if len(clauses) > MOST_EQUATIONS:
            raise StatementError(f"the text has {len(clauses)} equations, more than {MOST_EQUATIONS}: give fewer.")
        return self._with_definitions(clauses)

    def _spans(self, text: str, what: str) -> tuple[str, list[tuple[int, int]]]:
        """Return a text with blanks for all but formulas, and the spans (begin, end) of its equations.

        Raises StatementError, with the label `what`, for a text or an equation that is too long, and for HTML.
        """
        if len(text) > LONGEST_ANSWER:
            raise StatementError(
                f"the text has {len(text)} characters, and an answer may have {LONGEST_ANSWER}: shorten it."
            )
        if _HTML.match(text):
            raise StatementError("the text is an HTML page, which is not read: hand in plain text, Markdown or LaTeX.")
        clean, spans = equation_spans(text, self._is_coordinate)
        for begin, end in spans:
            if end - begin > LONGEST_TEXT:
                label = what or f"line {line_and_column(text, begin)[0]}"
                raise StatementError(
                    f"{label} has {end - begin} characters, more than the {LONGEST_TEXT} of an equation: shorten it."
                )
        return clean, spans

    def equations(self, text: str, what: str = "") -> list[Reading]:
        """Return the likeliest reading of each equation of a text. The list is empty if the text has only comments.

        A line such as r = sqrt(x^2 + y^2) defines a symbol for the other lines. Remarks and values of parameters are
        left out. Raises StatementError with all faults.

        `what` begins the message, such as "equation 2". A fault is located by its column, and by its line if the text
        has several lines.
        """
        text = text.translate(PLAIN_LETTERS)
        reader, clauses = self._clauses(text, what)
        read, faults, remarks = list[Reading](), list[TypedFault](), list[TypedFault]()
        exact = any(reader.names.order(clause.tokens) > 1 and not self._is_special(text, clause) for clause in clauses)
        for clause in clauses:
            wordless = all(token.kind in ("number", "sign") for token in clause.tokens)  # such as 0 = 0
            if clause.is_value() or (wordless and len(clauses) > 1):
                continue
            moves = reader.names.order(clause.tokens) > 1
            introduced = not moves and reader._is_introduced(text, clause.begin)
            narrow = clause.equation(moves=moves)
            named = len(clause.tokens) == 3 and reader._is_integral(*clause.sides())  # x' = v
            special = exact and self._is_special(text, clause)
            aside = special or (not moves and (clause.aside or introduced or named or narrow[0] > clause.begin))
            try:
                for link, (first, *others) in enumerate(reader._readings(clause, *narrow)):
                    read.append(replace(first, others=tuple(others), aside=aside, link=link))
            except TypedFault as fault:
                left_out = reader._is_left_out(clause, narrow, moves=moves) or introduced or special
                (remarks if left_out else faults).extend([fault, *fault.others])
        if faults or (remarks and not read):
            raise StatementError(reader._refusal(text, faults or remarks, what))
        return read

    def _is_left_out(self, clause: Clause, narrow: tuple[int, int], *, moves: bool) -> bool:
        """Return True if a clause that cannot be read may be ignored.

        Such a clause is a remark, a general law such as Lagrange's formula, or an equation with unknown names only.
        `narrow` is the span (begin, end) of the equation in the clause, without words around it. `moves` is true if the
        equation has an acceleration.
        """
        words = [side for side in clause.part(*narrow).sides() if any(token.kind == "word" for token in side)]
        foreign = [self._is_foreign(side) for side in words]
        if not moves and _LIST.fullmatch(clause.shown):
            return True
        if clause.is_law(clause.begin, clause.end) or (foreign and all(foreign)):
            return True
        return any(foreign) and clause.is_remark() if moves else any(foreign) or clause.is_remark()

    def unknown(self, text: str, what: str = "") -> set[str]:
        """Return the unknown words in clauses with accelerations. `what` is the label of the text in messages."""
        reader, clauses = self._clauses(text.translate(PLAIN_LETTERS), what)
        moving = (clause for clause in clauses if reader.names.order(clause.tokens) > 1)
        words = {token.text for clause in moving for token in clause.formula() if token.kind == "word"}
        return {canonical(word) for word in words if not reader.names.readings(word)}

    def _clause(self, text: str, begin: int, end: int) -> Clause:
        """Return text[begin:end] as a clause with its tokens."""
        return Clause(text, begin, end, tuple(tokens_of(text, begin, end)), self.names)

    def _with_plain_names(self, clause: Clause) -> Clause:
        """Return a clause without the (t) after names that are not symbols, such as F(t).

        H(x) becomes heaviside(x), unless H is a name elsewhere in the text. Kq becomes K q if K is a matrix.
        """
        tokens, named, after = list[Token](), bool(_NAME_H.search(clause.text)), 0
        matrices = {match.group(1) for match in _NAMED_MATRIX.finditer(clause.text)}
        for index, token in enumerate(clause.tokens):
            if index < after:
                continue
            following = [other.text for other in clause.tokens[index + 1 : index + 4]]
            unknown = token.kind == "word" and not self.names.readings(token.text)
            if unknown and following == ["(", "t", ")"]:
                after = index + 4
            elif unknown and token.text == "H" and following[:1] == ["("] and not named:
                token = replace(token, text="heaviside")
            elif unknown and token.text[0] in matrices and token.text[1:]:
                tokens.append(replace(token, text=token.text[0], end=token.begin + 1, order=0, primes=0))
                token = replace(token, text=token.text[1:], begin=token.begin + 1)
            tokens.append(token)
        return replace(clause, tokens=tuple(tokens))

    def _without_accents(self, match: re.Match[str]) -> str:
        """Return a word such as für or Newton's without its accents, unless it is a product of symbols."""
        words = [token.text for token in tokens_of(match.group(), 0, len(match.group())) if token.kind == "word"]
        return match.group() if all(map(self.names.readings, words)) else match.group().translate(_ACCENTS)

    def _is_introduced(self, text: str, begin: int) -> bool:
        """Return True if a sentence or "equilibrium", followed by a colon, precedes the offset `begin` on its line."""
        above, colon, rest = text[text.rfind("\n", 0, begin) + 1 : begin].rpartition(":")
        sentence = _STILL.search(above) or self._clause(above, 0, len(above)).is_remark(introduces=True)
        return bool(colon and sentence and not rest.strip())

    @staticmethod
    def _is_special(text: str, clause: Clause) -> bool:
        """Return True if a clause holds only for small motions or at rest, as its line or the heading above it says.

        Words about rest count only before the sign =.
        """
        line = text.rfind("\n", 0, clause.begin) + 1
        above = text[:line].rstrip()
        line = above.rfind("\n") + 1 if above.endswith(":") else line
        equality = text.find("=", clause.begin, clause.end)
        return bool(_SMALL.search(text, line, clause.end) or _STILL.search(text, line, max(equality, line)))

    def _is_coordinate(self, word: str) -> bool:
        """Return True if a word is the name of a coordinate."""
        return any(len(pieces) == 1 and pieces[0].name in self.names.bases for pieces in self.names.readings(word))

    def _readings(self, clause: Clause, begin: int, end: int) -> list[tuple[Reading, ...]]:
        """Return the readings of each equation of a clause; a = b = c is two equations. Raises TypedFault.

        If the clause cannot be read as a whole, only its part text[begin:end] is read.
        """
        try:
            return [self._readings_of(sides, clause.begin) for sides in self._equated(clause)]
        except TypedFault:
            if begin >= end or (begin, end) == (clause.begin, clause.end):
                raise
            return self._readings(clause.part(begin, end), begin, end)

    def _readings_of(self, sides: Sequence[Sequence[Token]], begin: int) -> tuple[Reading, ...]:
        """Return all readings of one equation, the likeliest first. Raises TypedFault if there are none.

        `sides` are the tokens of its sides, and `begin` is its offset.
        """
        faults = [fault for side in sides for fault in faults_of(side, self.names)]
        if faults:
            free = self._without_free_names(sides, begin)
            if free:
                return free
            fault = faults[0]
            fault.others = faults[1:]
            fault.read = self._read_before(sides, fault.offset)
            raise fault
        choices = Choices()
        formulas = [self._formulas(sides, choices)]
        readings = [self._built(formulas[0], begin)]
        for chosen in choices.others():
            with suppress(TypedFault):
                other = self._formulas(sides, Choices(chosen))
                if other not in formulas:
                    formulas.append(other)
                    readings.append(self._built(other, begin))
        return tuple(readings)

    def _without_free_names(self, sides: Sequence[Sequence[Token]], begin: int) -> tuple[Reading, ...]:
        """Return the readings of an equation divided by unknown names that are factors of both sides, or ().

        Example: the radius R of a pulley is such a name in (T1 - T2) R = 1/2 M R^2 x''/R.
        """
        words = [
            token for side in sides for token in side if token.kind == "word" and not self.names.readings(token.text)
        ]
        names = Counter(canonical(word.text) for word in words)
        if not 0 < len(names) <= MOST_FREE or not all(_FREE.fullmatch(name) and names[name] > 1 for name in names):
            return ()
        symbols = {name: sympy.Symbol(name, positive=True) for name in names}
        reader = TypedReader(self.symbols | symbols, self.others, self.meanings)
        ones = dict.fromkeys(symbols.values(), sympy.S.One)
        try:
            readings = reader._readings_of(sides, begin)
        except TypedFault:
            return ()
        cancelled = []
        for each in readings:
            if all(_is_factor(symbol, each.zero) for symbol in ones):
                zero, right, *inside = (x.xreplace(ones) for x in (each.zero, each.right, *each.differentiated))
                cancelled.append(Reading(zero, right, each.read, tuple(inside), meanings=self.meanings))
        return tuple(cancelled)

    def _read_before(self, sides: Sequence[Sequence[Token]], offset: int) -> str:
        """Return the part of an equation before `offset`, in the strict notation, without operators at its end.

        `sides` has the tokens of each side of the equation.
        """
        read: list[str] = []
        for side in sides:
            tokens = [token for token in side if token.end <= offset]
            while tokens and tokens[-1].is_sign(*"+-*/^"):
                tokens.pop()
            try:
                read += [formula.shown for formula in self._formulas([tokens], Choices())] if tokens else []
            except TypedFault:
                break
        return " = ".join(read)

    def _with_definitions(self, clauses: Sequence[Clause]) -> tuple[TypedReader, list[Clause]]:
        """Return a reader that knows the names defined in clauses, as in r = sqrt(x^2 + y^2), and the other clauses.

        A definition may use a name that is defined later. A name that no other clause contains is not defined. If a
        definition also states that a value is constant, as h = r^2 phi' = const or r^2 phi' = h, its clause remains.
        """
        reader, left, uses, tries = self, dict(enumerate(clauses)), Uses(clauses), 0
        for k in [*left] * MOST_CHAINED:
            narrow = left[k].part(*left[k].equation(moves=False)) if k in left and tries < MOST_DEFINED else None
            definition = Definition.of(narrow, uses, reader.names) if narrow else None
            if definition is not None:
                tries += 1
                known = reader._defined(definition)
                if known:
                    reader = TypedReader(reader.symbols, self.others, reader.meanings | known)
                    del left[k]
                    left |= {k: definition.constant} if definition.constant else {}
        return reader, [replace(clause, names=reader.names) for _, clause in sorted(left.items())]

    def _defined(self, definition: Definition) -> dict[Any, Any]:
        """Return {symbol: value} of a definition, or {} if no value is found.

        If the value changes in time, the result also has the symbols of its first and second time derivatives.
        """
        symbol, first, second = (sympy.Symbol(definition.name + ending, real=True) for ending in RATES)
        reader = TypedReader(self.symbols, self.others, self.meanings | {symbol: symbol})
        try:
            zero = reader._readings_of(definition.sides, 0)[0].zero.xreplace(self.meanings)
        except TypedFault:
            return {}
        for power in (1, 2):
            slope = sympy.diff(zero.xreplace({symbol**power: _VALUE}), _VALUE)
            rest = zero.xreplace({symbol**power: sympy.S.Zero})
            if slope == 0 or slope.has(_VALUE, symbol) or rest.has(symbol):
                continue
            known = {symbol: (-rest / slope) ** sympy.Rational(1, power)}
            with suppress(SceneError):
                for order, rate in enumerate((first, second), 1):
                    value = self.differentiated(known[symbol], order)
                    known |= {rate: value} if value != 0 else {}
            return known if definition.lone or len(known) > 1 else {}
        return {}

    def _equated(self, clause: Clause) -> list[list[list[Token]]]:
        """Return the equations that a clause states, each as a list of sides. Raises TypedFault.

        A side is a list of tokens. The chain a = b = c states a = b and a = c. A side of a chain is left out if all its
        names are unknown, such as p in p = m x' = const. A side between two others, such as F/m, is left out if one of
        its names is unknown. If a side equals "const", or if a side with velocities equals an unknown name, the
        equation states that the time derivative of that side is zero.
        """
        sides, begin = clause.sides(), clause.begin
        offsets = [token.begin for token in clause.tokens if token.is_sign("=")]
        for offset, (left, right) in zip(offsets, pairwise(sides), strict=True):
            if not (left and right):
                raise TypedFault(f"nothing stands {'right' if left else 'left'} of the sign of equality", offset)
        laws = [side for side in sides if len(sides) > 2 and clause.is_law(side[0].begin, side[-1].end)]
        plain = [
            side
            for side in sides
            if is_constant(side) or not (side in laws or self._is_foreign(side, between=side in sides[1:-1]))
        ]
        sides = plain if len(plain) > 1 else sides
        if len(sides) > 2 and not any(self.names.order(side) > 1 for side in sides):
            reason = f"there are {len(offsets)} signs of equality: write one equation with two sides"
            raise TypedFault(reason, offsets[1])
        if clause.constant:
            sides = [*sides, []]
        if clause.constant or (len(sides) > 1 and (is_constant(sides[-1]) or self._is_integral(*sides))):
            return [[[Token("rate", "1", begin, begin), *bracketed(side)]] for side in sides[:-1]]
        return [[sides[0], side] for side in sides[1:]] or [sides]

    def _is_foreign(self, side: Sequence[Token], *, between: bool = False) -> bool:
        """Return True if one side of an equation has unknown names, no known names, and no fault of another kind.

        If `between` is true, the side is between two others, and may also have known names.
        """
        faults = faults_of(side, self.names)
        words = sum(token.kind == "word" for token in side)
        unknown = bool(faults) and all(isinstance(fault, UnknownWord) for fault in faults)
        return unknown and (between or len(faults) == words)

    def _is_integral(self, side: Sequence[Token], *others: Sequence[Token]) -> bool:
        """Return True if one `side` of an equation has velocities and the other is one unknown name, as in p = C.

        `others` are the other sides. Such an equation states that a quantity is conserved.
        """
        names = [token.text for other in others for token in other]
        unknown = len(names) == 1 and names[0].isidentifier() and not self.names.readings(names[0])
        return unknown and not self.names.hint(names[0]) and self.names.order(side) == 1

    def _formulas(self, sides: Sequence[Sequence[Token]], choices: Choices) -> list[Formula]:
        formulas: list[Formula] = []
        for side in sides:
            formulas.append(parsed(side, self.names, choices, sum(len(formula.rates) for formula in formulas)))
        return formulas

    def _built(self, formulas: Sequence[Formula], begin: int) -> Reading:
        """Return the reading of an equation from one formula per side.

        Raises TypedFault, located at `begin`, if the reader of scene files refuses a formula.
        """
        names, differentiated, terms = dict(self.symbols), list[Any](), list[tuple[Any, ...]]()
        try:
            for formula in formulas:
                for name, (operand, order) in formula.rates.items():
                    inside = read_expression(operand, names)
                    names[name] = self.differentiated(inside, order)
                    if order == 1:
                        differentiated.append(inside)
                momenta = [name for name in re.findall(r"\w+(?=_dot\b)", formula.text) if name in self.momenta]
                differentiated += [self.meanings[self.symbols[name]] for name in momenta]
            values = [read_expression(formula.text, names) for formula in formulas]
            counts = [len(sympy.Add.make_args(value)) for value in values]  # less than typed if there are like terms
            if any(formula.rates or len(formula.terms) > n for formula, n in zip(formulas, counts, strict=True)):
                terms = [tuple(read_expression(term, names) for term in formula.terms) for formula in formulas]
        except SceneError as error:
            read = " = ".join(formula.shown for formula in formulas)
            raise TypedFault(f"read as {read[:120]}: {error.reason.removesuffix('.')[:160]}", begin) from None
        left, right = (*values, sympy.S.Zero)[:2]
        shown = " = ".join(formula.shown for formula in formulas)
        return Reading(left - right, right, shown, tuple(differentiated), tuple(terms), self.meanings)

    def differentiated(self, expression: Any, order: int) -> Any:
        """Return the time derivative of order `order` of an expression along the motion.

        Raises SceneError if a symbol, such as an acceleration, has no derivative in the equations.
        """
        expression = expression.xreplace({x: value for x, value in self.meanings.items() if x not in self.rates})
        for _ in range(order):
            left = expression.free_symbols - set(self.rates)
            last = [symbol for symbol in left if str(symbol).endswith("_ddot") or str(symbol).startswith("lambda")]
            if last:
                raise SceneError(
                    f"equations of motion do not contain the time derivative of {last[0]}: write the equation without "
                    "it."
                )
            pairs = [pair for pair in self.rates.items() if expression.has(pair[0])]
            expression = sympy.Add(sympy.diff(expression, t), *(sympy.diff(expression, x) * rate for x, rate in pairs))
        return expression

    def _refusal(self, text: str, faults: Sequence[TypedFault], what: str) -> str:
        """Return the error message for a text: its faults with their places, then the symbols of the system.

        The message has as many faults as fit into it. `what` is the label of the text.
        """
        pieces = (piece for word in WORD.findall(text) for reading in self.names.readings(word) for piece in reading)
        if not any(piece.kind == "symbol" and piece.name != "t" for piece in pieces):
            shown = "".join(mark for mark in " ".join(text.split())[:60] if mark.isprintable())
            start = f"{what or 'the text'} '{shown}' has no symbol of this system."
            return f"{start} An answer is an equation {self.example()}"
        sentences = []
        for fault in faults[:MOST_TOLD]:
            line, column = line_and_column(text, fault.offset)
            start = f"line {line}" if "\n" in text.strip() or not what else what
            end = "" if fault.reason.endswith((".", "?")) else "."
            sentences.append(f"{start}, column {column}: {fault.reason}{end}")
        end = f" The symbols are {self._symbols()}."
        if faults[0].read and len(sentences[0] + faults[0].read + end) < LONGEST_REFUSAL - len(READ_SO_FAR):
            end = READ_SO_FAR.format(faults[0].read) + end
        while len(sentences) > 1 and len(" ".join(sentences) + end) > LONGEST_REFUSAL:
            sentences.pop()
        left = len(faults) - len(sentences)
        more = f" {left} more {'fault follows' if left == 1 else 'faults follow'}." if left else ""
        return " ".join(sentences) + more + end

    def example(self) -> str:
        """Return the end of a sentence for a message: an example of an answer, and the symbols of the system."""
        return f"such as {[*self.names.bases, *self.names.names][0]}'' = ... The symbols are {self._symbols()}."

    def _symbols(self) -> str:
        """Return the names of the system's symbols, listed as text for a message."""
        names = listing(name for name in self.symbols if not name.endswith(("_dot", "_ddot")))
        if len(names) > LONGEST_SYMBOLS:
            names = names[:LONGEST_SYMBOLS].rsplit(",", 1)[0] + " and others"
        for base in self.names.bases[:1]:
            names += f", with derivatives such as {base}'' or {base}_ddot"
        return names


def _is_factor(symbol: Any, expression: Any) -> bool:
    """Return True if an expression is a power of a symbol times other factors, or zero, at two random points."""
    others = sorted(expression.free_symbols - {symbol}, key=str)
    dice, values = random.Random(1), list[Any]()
    for _ in range(2):
        point = {other: sympy.Float(dice.uniform(0.5, 1.5), 30) for other in others}
        values += (sympy.N(expression.xreplace(point | {symbol: sympy.Integer(x)}), 30) for x in (1, 2))
    a, b, c, d = values
    numbers = all(x.is_Float or x.is_Integer for x in values)
    return bool(numbers and abs(a * d - b * c) <= EQUAL * max(abs(a * d), 1))
