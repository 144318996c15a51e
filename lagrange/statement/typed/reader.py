"""Reader for equations as people type them: plain, with primes or dots, in Unicode or LaTeX, over several lines.

The text becomes the strict notation of scene files, and only `statement.text` builds expressions: lengths, depths and
work have the bounds that it sets, and nothing is ever executed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.errors import SceneError, StatementError, listing
from lagrange.statement.coordinate import t
from lagrange.statement.letters import WORD
from lagrange.statement.text import read_expression
from lagrange.statement.typed.derivatives import with_derivatives
from lagrange.statement.typed.faults import TypedFault, faults_of
from lagrange.statement.typed.grammar import Choices, Formula, parsed
from lagrange.statement.typed.lines import equation_spans
from lagrange.statement.typed.names import Names
from lagrange.statement.typed.tokens import Token, tokens_of

LONGEST_TEXT = 20_000
"""Characters of one equation; a longer text is no equation that a person wrote."""

_ABBREVIATION = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]{0,30})\s*=(?!=)")
"""A name alone on the left side."""

MOST_EQUATIONS = 1_000
"""Equations of one text."""

LONGEST_REFUSAL = 360
"""Characters up to which a refusal lists further faults; with the count of the others it stays below 400."""

LONGEST_SYMBOLS = 120
"""Characters of the list of symbols at the end of a message."""


@dataclass(frozen=True)
class Reading:
    """One way to understand an equation: what is zero, and the right side, in the symbols of the reader.

    `read` is the equation in the strict notation, with both its sides.
    """

    zero: Any
    right: Any
    read: str


@dataclass(frozen=True)
class TypedEquation:
    """An equation with all its readings, the likeliest first, and the line on which it begins (from 1)."""

    readings: tuple[Reading, ...]
    line: int


class TypedReader:
    """Reads typed equations in the symbols of one system.

    `symbols` maps strict names to SymPy expressions: q, q_dot and q_ddot of each coordinate, parameters, given
    functions and multipliers. `multipliers` maps other spellings of multipliers to strict names.
    """

    def __init__(self, symbols: Mapping[str, Any], multipliers: Mapping[str, str]) -> None:
        self.symbols = dict(symbols)
        self.multipliers = dict(multipliers)
        self.names = Names(self.symbols, self.multipliers)
        self.rates = self._rates()

    def equations(self, text: str, what: str = "") -> list[TypedEquation]:
        """Return the equations of a text, none if there are only comments. Raises StatementError with all faults.

        A line such as r = sqrt(x^2 + y^2) introduces a symbol for the lines after it.

        `what` begins a refusal, such as "equation 2"; places are columns, and lines where the text has several.
        """
        clean, spans = equation_spans(text)
        if len(spans) > MOST_EQUATIONS:
            raise StatementError(f"the text has {len(spans)} equations, and {MOST_EQUATIONS} are the most.")
        found, faults, reader = [], list[TypedFault](), self
        for begin, end in spans:
            if end - begin > LONGEST_TEXT:
                label = what or f"line {_line(text, begin)}"
                raise StatementError(
                    f"{label} has {end - begin} characters, and {LONGEST_TEXT} are the most of an equation."
                )
            known = reader._abbreviation(clean, begin, end, clean[end:])
            if known:
                reader = TypedReader(reader.symbols | known, self.multipliers)
                continue
            try:
                found.append(TypedEquation(reader._readings(clean, begin, end), _line(text, begin)))
            except _Faults as error:
                faults += error.faults
        if faults:
            raise StatementError(self._refusal(text, faults, what))
        return found

    def _readings(self, text: str, begin: int, end: int) -> tuple[Reading, ...]:
        """Return the readings of one equation. Raises _Faults."""
        strict = self._strict(text[begin:end])
        if strict is not None:
            return (strict,)
        sides = self._sides(text, begin, end)
        faults = [fault for side in sides for fault in faults_of(side, self.names)]
        if faults:
            raise _Faults(faults)
        choices = Choices()
        first = self._formulas(sides, choices)
        formulas = [first]
        for chosen in choices.others():
            try:
                other = self._formulas(sides, Choices(chosen))
            except _Faults:
                continue
            if other not in formulas:
                formulas.append(other)
        readings = [self._built(formulas[0], begin)]
        for one in formulas[1:]:
            try:
                readings.append(self._built(one, begin))
            except _Faults:
                continue
        return tuple(readings)

    def _abbreviation(self, text: str, begin: int, end: int, later: str) -> dict[str, Any]:
        """Return the symbol that a line such as r = sqrt(x^2 + y^2) introduces for later lines, {} for an equation."""
        match = _ABBREVIATION.match(text, begin, end)
        if match is None or self.names.readings(match.group(1)):
            return {}
        if not re.search(rf"\b{match.group(1)}\b", later):
            return {}
        try:
            readings = self._readings(text, match.end(), end)
        except _Faults:
            return {}
        return {match.group(1): readings[0].zero} if not readings[0].right else {}

    def _strict(self, text: str) -> Reading | None:
        """Return the reading of a text in the strict notation, None if it is not in it."""
        sides = text.strip().replace("==", "=").split("=")
        if len(sides) > 2 or any(mark in text for mark in "<>!"):
            return None
        try:
            values = [read_expression(side, self.symbols) for side in sides]
        except SceneError:
            return None
        shown = " = ".join(" ".join(side.split()) for side in sides)
        return _reading(values, shown)

    def _sides(self, text: str, begin: int, end: int) -> list[list[Token]]:
        """Return the tokens of the sides of an equation. Raises _Faults."""
        tokens = with_derivatives(tokens_of(text, begin, end))
        places = [i for i, token in enumerate(tokens) if token.is_sign("=")]
        if len(places) == 2 and places[0] == 1 and tokens[0].kind == "word" and not self.names.readings(tokens[0].text):
            tokens, places = tokens[2:], [places[1] - 2]  # a = x'' = ... gives the acceleration a name
        if len(places) > 1:
            raise _Faults(
                [
                    TypedFault(
                        f"there are {len(places)} signs of equality: write one equation with two sides",
                        tokens[places[1]].begin,
                    )
                ]
            )
        if not places:
            return [tokens]
        sides = [tokens[: places[0]], tokens[places[0] + 1 :]]
        for side, name in zip(sides, ("left", "right"), strict=True):
            if not side:
                raise _Faults([TypedFault(f"nothing stands {name} of the sign of equality", tokens[places[0]].begin)])
        return sides

    def _formulas(self, sides: Sequence[Sequence[Token]], choices: Choices) -> list[Formula]:
        found: list[Formula] = []
        try:
            for side in sides:
                found.append(parsed(side, self.names, choices, sum(len(one.rates) for one in found)))
        except TypedFault as fault:
            raise _Faults([fault]) from None
        return found

    def _built(self, formulas: Sequence[Formula], begin: int) -> Reading:
        """Return the expressions of strict text. Raises _Faults where the strict reader refuses it."""
        names = dict(self.symbols)
        try:
            for formula in formulas:
                for name, (operand, order) in formula.rates.items():
                    names[name] = self._differentiated(read_expression(operand, names), order)
            values = [read_expression(formula.text, names) for formula in formulas]
        except SceneError as error:
            read = " = ".join(formula.shown for formula in formulas)
            raise _Faults(
                [TypedFault(f"read as {read[:120]}: {error.reason.removesuffix('.')[:160]}", begin)]
            ) from None
        return _reading(values, " = ".join(formula.shown for formula in formulas))

    def _rates(self) -> dict[Any, Any]:
        """Return the derivative of each symbol that has one."""
        pairs = (
            (name, f"{base}{ending}")
            for base in self.names.bases
            for name, ending in ((base, "_dot"), (f"{base}_dot", "_ddot"))
        )
        return {
            self.symbols[name]: self.symbols[rate]
            for name, rate in pairs
            if name in self.symbols and rate in self.symbols
        }

    def _differentiated(self, expression: Any, order: int) -> Any:
        """Return the derivative along the motion. Raises SceneError where one is missing."""
        for _ in range(order):
            left = expression.free_symbols - set(self.rates)
            last = [symbol for symbol in left if str(symbol).endswith("_ddot") or str(symbol).startswith("lambda")]
            if last:
                raise SceneError(f"the time derivative of {last[0]} is in no equation of motion.")
            terms = [
                sympy.diff(expression, symbol) * rate for symbol, rate in self.rates.items() if expression.has(symbol)
            ]
            expression = sympy.Add(sympy.diff(expression, t), *terms)
        return expression

    def _refusal(self, text: str, faults: Sequence[TypedFault], what: str) -> str:
        """Return all faults with their places, and the symbols of the system at the end."""
        if not any(self._known(word) for word in WORD.findall(text)):
            shown = " ".join(text.split())[:60]
            return (
                f"{what or 'the text'} {shown!r} has no symbol of this system. An answer is an equation such as "
                f"{self._example()}."
            )
        told = [self._told(text, fault, what) for fault in faults]
        end = f" The symbols are {self._symbols()}."
        kept = next(k for k in range(len(told), 0, -1) if k == 1 or len(" ".join(told[:k]) + end) <= LONGEST_REFUSAL)
        left = len(told) - kept
        more = f" {left} more {'fault follows' if left == 1 else 'faults follow'}." if left else ""
        return " ".join(told[:kept]) + more + end

    @staticmethod
    def _told(text: str, fault: TypedFault, what: str) -> str:
        """Return a fault as a sentence with its place: line and column of a text, or the column of one equation."""
        line, column = _line(text, fault.place), fault.place - text.rfind("\n", 0, fault.place)
        place = f"line {line}, column {column}" if "\n" in text.strip() or not what else f"{what}, column {column}"
        return f"{place}: {fault.reason}{'' if fault.reason.endswith(('.', '?')) else '.'}"

    def _known(self, word: str) -> bool:
        """Return whether a word has a reading that is more than a number or a function."""
        return any(piece.kind == "symbol" and piece.name != "t" for one in self.names.readings(word) for piece in one)

    def _example(self) -> str:
        """Return what an answer looks like, without giving it away."""
        first = self.names.bases[0] if self.names.bases else self.names.names[0]
        return f"{first}'' = ..., or {first}_ddot = ..., with {self._symbols()} on its sides"

    def _symbols(self) -> str:
        """Return the names of the system as a message lists them."""
        names = listing(name for name in self.symbols if not name.endswith(("_dot", "_ddot")))
        if len(names) > LONGEST_SYMBOLS:
            names = names[:LONGEST_SYMBOLS].rsplit(",", 1)[0] + " and others"
        rates = (
            f", with derivatives such as {self.names.bases[0]}'' or {self.names.bases[0]}_ddot"
            if self.names.bases
            else ""
        )
        return names + rates


class _Faults(Exception):
    """All faults of one equation."""

    def __init__(self, faults: list[TypedFault]) -> None:
        super().__init__(faults)
        self.faults = faults


def _reading(values: Sequence[Any], read: str) -> Reading:
    right = values[1] if len(values) > 1 else sympy.S.Zero
    return Reading(values[0] - right, right, read)


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1
