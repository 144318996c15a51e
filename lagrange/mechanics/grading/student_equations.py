"""Read a student's equations of motion, split them into coefficients, and test whether they hold at a state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import Any

import sympy

from lagrange.errors import StatementError, formula, listing, suggestion
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.mechanics.grading.motion_samples import MotionSample
from lagrange.mechanics.plain_form import vanishes_in_symbols as vanishes
from lagrange.statement.coordinate import constraint_of, name_of, t
from lagrange.statement.expression import TEXTS, entries, expression, in_full
from lagrange.statement.parameters import Survey, coordinate_name
from lagrange.statement.random_states import SamplePoint
from lagrange.statement.rotation import shorthands
from lagrange.statement.scene.guard import LARGEST_EXPONENT
from lagrange.statement.statement import Statement
from lagrange.statement.typed.lines import parts_of_document
from lagrange.statement.typed.names import RATES, canonical
from lagrange.statement.typed.reader import Reading, TypedReader
from lagrange.statement.vocabulary.letters import WORD

MULTIPLIER = "lambda_"  # Prefix that turns the name of a constraint into the name of its multiplier

FORCES = ("T", "N", "S", "F", "f", "mu", "FT", "FN", "FS", "FR", "Ff", "Fc", "fs")
"""Letters that may be typed for the multiplier of the only constraint of a system, unless the system has a symbol of
this name. The letter must be the only unknown name in the answer. With several constraints, a letter of USUAL has the
number of its constraint, such as T1."""

# Letters that are read as the force of the only constraint even if the answer has other unknown names
USUAL = ("T", "N", "S", "FT", "FN", "FS", "Fc")
# Usual letters for derivatives of a coordinate, if it is the only one of its kind. omega may be a frequency instead
RATE_LETTERS = {name: {"v": "_dot", "a": "_ddot"} for name in ("x", "y", "z", "s", "r", "h")}
RATE_LETTERS |= {name: dict.fromkeys(("alpha", "angularacceleration"), "_ddot") for name in ("theta", "phi", "psi")}
ORDINALS = ("", "second", "third", "fourth", "fifth")  # Names of the equations in a = b = c after the first


@dataclass(frozen=True)
class StudentEquation(Reading):
    """An equation of a student's answer as it was understood, with SymPy symbols in place of functions of time.

    `label` names the equation in messages. `index` is the index of the equation in the answer; a chain a = b = c is one
    equation in the answer and several here. `letters` maps multipliers to the letters that were typed for them.
    `others` are other readings of an ambiguous text. `note` is a sentence on why an equation counts as correct, such as
    for rounded decimals, or "".
    """

    label: str = ""
    letters: Mapping[Any, Any] = field(default_factory=dict)
    others: tuple[StudentEquation, ...] = ()
    note: str = ""
    index: int = 0

    def with_numbers(self, numbers: Mapping[Any, Any]) -> StudentEquation:
        """Return the equation with its numbers replaced by the table `numbers`, {number: expression}: g for 9.81."""
        meanings = {symbol: value.xreplace(numbers) for symbol, value in self.meanings.items()}
        zero, right = self.zero.xreplace(numbers), self.right.xreplace(numbers)
        return replace(self, zero=zero, right=right, meanings=meanings)


def read_equations(answer: Any, statement: Statement) -> list[StudentEquation]:
    """Return the equations of a student's answer: a list, a dict by coordinate, one text, one expression, or one Eq.

    A text has = or == between two sides, or is an expression that is zero. In it q_dot and q_ddot are derivatives of
    the coordinate q, and lambda_name is the multiplier of the constraint `name`. Raises StatementError, with the
    equation's label, if an equation cannot be read.
    """
    reader = _EquationReader(statement)
    if isinstance(answer, str):
        return reader.likely(answer, lambda each: each.document(answer))
    if isinstance(answer, Mapping):
        listed = [(f"the {coordinate_name(key, statement.names)} equation", value) for key, value in answer.items()]
    else:
        single = isinstance(answer, (*TEXTS, sympy.Basic)) and not isinstance(answer, sympy.Tuple)
        parts = None if single else entries(answer, "the equations")
        listed = [(f"equation {k}", value) for k, value in enumerate([answer] if parts is None else parts, 1)]
    if not listed:
        raise StatementError("no equation is given: give a list with one for each coordinate.")
    return [equation for index, pair in enumerate(listed) for equation in reader.read(pair[1], pair[0], index)]


def spelled(expression: Any) -> str:
    """Return the text of an expression, with multipliers as lambda_name, as equations of an answer are typed."""
    named = {symbol: constraint_of(symbol) for symbol in expression.free_symbols}
    multipliers = {symbol: sympy.Symbol(f"{MULTIPLIER}{name}") for symbol, name in named.items() if name is not None}
    return str(sympy.sstr(expression.xreplace(multipliers)))


class _EquationReader:
    """Reads the equations of students' answers on one system, which have its symbols or usual letters for them."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self.plain = dict(statement.plain)
        self.names = {symbol.name: symbol for symbol in self.plain.values()}
        self.names |= {p.name: p for p in statement.parameters}
        self.prescribed = dict(statement.prescribed)
        for leaf, value in self.prescribed.items():  # derivatives of a function of time X are X_dot and X_ddot
            order = len(leaf.variables) if isinstance(leaf, sympy.Derivative) else 0
            self.names[name_of(leaf.expr if order else leaf) + RATES[order]] = value
        self.names |= {symbol.name: symbol for symbol in abbreviations(statement)}
        multipliers = {f"{MULTIPLIER}{constraint.name}": constraint.multiplier for constraint in statement.constraints}
        self.names = multipliers | self.names
        numbered = ("lambda", *(letter for letter in USUAL if letter not in self.names))
        spellings = {f"{letter}{k}": name for k, name in enumerate(multipliers, 1) for letter in numbered}
        self.force = next(iter(multipliers)) if len(multipliers) == 1 else ""
        spellings |= dict.fromkeys(("lambda", "lam"), self.force) if self.force else {}
        known = set(map(canonical, self.names))
        self.spellings = {letter: name for letter, name in spellings.items() if letter not in known}
        # Rates of the only rotation may be spelled w1 or omega_x, unless a symbol of the system has this name.
        (rotation,) = statement.rotations if len(statement.rotations) == 1 else ("",)
        letters = [letter for letter in ("w", "omega", "Omega") if rotation and letter not in self.names]
        pairs = [*zip("123xyz", "xyzxyz", strict=True)]
        rates = {f"{letter}{k}": f"{rotation}_body_{axis}" for letter in letters for k, axis in pairs}
        self.others = self.spellings | {key: name for key, name in rates.items() if key not in self.names}

    def reader(self, text: str, what: str = "") -> tuple[TypedReader, dict[Any, Any]]:
        """Return a reader for a text, and {multiplier: symbol of the letter that the text uses for it}.

        For a system with one constraint, the text may use a letter such as T, for a force, for the multiplier. The
        letter is recognised if only one of the unknown names in the text can mean it. `what` is the label of the text
        in messages.
        """
        words = {canonical(word) for word in WORD.findall(text)}
        reader, letters = TypedReader(self.names, self.others), [letter for letter in self.spellings if letter in words]
        if self.force and not letters:
            # Preferred are letters that are unknown words. Next are letters that begin or end an unknown word, as in
            # 2T, and last the other usual letters.
            unknown, free = reader.unknown(text, what), [x for x in FORCES if x not in map(canonical, self.names)]
            whole = [letter for letter in free if letter in unknown]
            parts = [x for x in free if any(word.startswith(x) or word.endswith(x) for word in unknown)]
            letters = whole or parts or [letter for letter in USUAL if letter in words and letter in free]
            letters = letters if len(letters) == 1 else []
            reader = TypedReader(self.names, self.others | dict.fromkeys(letters, self.force))
        return reader, {self.names[self.spellings.get(letter, self.force)]: sympy.Symbol(letter) for letter in letters}

    def likely(self, answer: str, read: Callable[[_EquationReader], list[StudentEquation]]) -> list[StudentEquation]:
        """Return the equations in an answer, in which letters such as a may stand for derivatives of coordinates.

        The function `read` returns the equations that a reader finds. It is called with this reader. If it fails, or
        finds no acceleration, it is called with readers that know such letters. If these find none either, the first
        equations are kept. Raises StatementError if all readers fail.
        """
        equations, refusal = list[StudentEquation](), None
        try:
            equations = read(self)
        except StatementError as error:
            refusal = error
        if not self._moves(equations):
            for other in self._with_usual_rates(answer):
                with suppress(StatementError):
                    changed = read(other)
                    if refusal or self._moves(changed):
                        return changed
        if refusal:
            raise refusal
        return equations

    def _moves(self, equations: Sequence[StudentEquation]) -> bool:
        """Return True if an equation has an acceleration, after symbols that the answer defines are replaced."""
        accelerations = list(self.plain.values())[2::3]
        return any(equation.zero.xreplace(dict(equation.meanings)).has(*accelerations) for equation in equations)

    def document(self, answer: str) -> list[StudentEquation]:
        """Return the equations of a text, or else of its formulas or its section "Equations of motion"."""
        try:
            return self._all(answer)
        except StatementError:
            for part in parts_of_document(answer):
                with suppress(StatementError):
                    return self._all(part)
            raise

    def _with_usual_rates(self, answer: str) -> Iterator[_EquationReader]:
        """Yield readers that accept usual letters for derivatives of coordinates in an answer.

        If there is only one length, v and a are its derivatives, as in m a = -k x - c v. If there is only one angle,
        alpha is its acceleration. v1 and a1 are derivatives of x1. The first reader accepts velocities only, the second
        accelerations, too, unless such a letter is in an equation with another acceleration, as in x'' = -a x.
        """
        meanings: dict[str, list[str]] = {}  # by letter with index, such as v1
        for name in (name for name in self.names if f"{name}_ddot" in self.names):
            stem = name.rstrip("_0123456789")
            for letter, ending in RATE_LETTERS.get(stem, {}).items():
                meanings.setdefault(canonical(letter + name[len(stem) :]), []).append(name + ending)
        known = set(map(canonical, self.names))
        rates = {letter: names[0] for letter, names in meanings.items() if len(names) == 1 and letter not in known}
        velocities = {letter: name for letter, name in rates.items() if name.endswith("_dot")}
        reader = copy(self)
        reader.others = self.others | velocities
        if velocities:
            yield reader
        with suppress(StatementError):
            if rates != velocities and not rates.keys() & TypedReader(self.names, reader.others).unknown(answer):
                reader.others |= rates
                yield reader

    def _all(self, answer: str) -> list[StudentEquation]:
        """Return the equations of a text. Raises StatementError if there are none, or if the text cannot be read."""
        reader, letters = self.reader(answer)
        kinetic = self.statement.kinetic.xreplace(self.plain)
        equations = [
            typed
            for typed in reader.equations(answer)  # without T = ..., where T may be the kinetic energy
            if not (typed.read.startswith(MULTIPLIER) and sympy.expand(typed.right - kinetic) == 0)
        ]
        if not equations:
            raise StatementError(f"there is no equation: write one equation per line, {reader.example()}")
        indices = list(accumulate((not typed.link for typed in equations), initial=-1))[1:]
        return [
            _equation(f"equation {index + 1}", typed, letters, index)
            for index, typed in zip(indices, equations, strict=True)
        ]

    def read(self, answer: Any, what: str, index: int) -> list[StudentEquation]:
        """Return the equation that one entry of an answer states, as a list; a text a = b = c states two.

        `answer` is a text, an Eq, or an expression that is zero. `what` is its label, and `index` its position.
        """
        if isinstance(answer, str):
            return self.likely(answer, lambda reader: reader._single(answer, what, index))
        if isinstance(answer, sympy.Eq):
            left, right = (self.symbols(expression(side, what), what) for side in answer.args)
            read = f"{spelled(left)} = {spelled(right)}"
            return [StudentEquation(left - right, right, read, label=what, index=index)]
        if isinstance(answer, bool) or answer is sympy.true or answer is sympy.false:
            raise StatementError(f"{what} is {answer}, the value of == in Python: write sympy.Eq(left, right).")
        stated = expression(answer, what)
        try:
            zero = self.symbols(stated, what)
            return [StudentEquation(zero, read=f"{spelled(zero)} = 0", label=what, index=index)]
        except RecursionError:
            raise StatementError(
                f"{what} is nested too deeply to be compared: multiply it out, or state it in parts."
            ) from None

    def _single(self, answer: str, what: str, index: int) -> list[StudentEquation]:
        """Return the only equation of a text, with the label `what` and the position `index` in the answer, as a list.

        Raises StatementError if there are more equations or none. A text a = b = c gives two entries.
        """
        reader, letters = self.reader(answer, what)
        equations = reader.equations(answer, what)
        count = sum(not typed.link for typed in equations)
        if count != 1:
            raise StatementError(f"{what} is a text with {count} equations: give one in each entry.")
        return [_equation(what, typed, letters, index) for typed in equations]

    def unknown(self, name: str, what: str) -> str:
        """Return the error message for an unknown name in the equation with the label `what`."""
        symbols = f"its symbols are {listing(self.names)}.{suggestion(name, list(self.names))}"
        return f"{what} contains {name[:60]!r}, which this system does not have; {symbols}"

    def symbols(self, stated: Any, what: str) -> Any:
        """Return a user's SymPy expression with the symbols of the system in place of functions of time.

        Parameters are identified by their names. Raises StatementError, with the label `what`, for unknown symbols,
        functions and multipliers, and for exponents above LARGEST_EXPONENT, since SymPy would compute 2**(10**9).
        """
        for power in stated.atoms(sympy.Pow):
            if power.exp.is_Rational and abs(power.exp) > LARGEST_EXPONENT:
                raise StatementError(
                    f"{what} contains the exponent {formula(power.exp, 20)}, which is out of bounds: at most "
                    f"{LARGEST_EXPONENT} in size."
                )
        survey = Survey()
        survey.add(stated, what, accelerations=True, multipliers=True)
        table: dict[Any, Any] = {}
        for q in survey.coordinates:
            if q not in self.plain:
                coordinate_name(name_of(q), self.statement.names)
        for symbol in survey.parameters:
            if symbol.name not in self.names:
                raise StatementError(self.unknown(symbol.name, what))
            table[symbol] = self.names[symbol.name]
        known = [constraint.name for constraint in self.statement.constraints]
        for name in survey.multipliers:
            if name not in known:
                raise StatementError(
                    f"{what} contains the multiplier of {name!r}, which is not a constraint here; the constraints are "
                    f"{listing(known)}."
                )
        for function in survey.given:
            if function not in self.prescribed:
                raise StatementError(self.unknown(name_of(function), what))
        return stated.xreplace(self.prescribed).xreplace(self.plain | table)


def _equation(label: str, typed: Reading, letters: Mapping[Any, Any], index: int) -> StudentEquation:
    """Return the equation of an answer for `typed`, the result of reading its text, with the other readings.

    `label` names the equation in messages, and `index` is its position in the answer. `letters` maps multipliers to the
    letters that were typed for them.
    """
    if typed.link:
        label = f"the {ORDINALS[min(typed.link, len(ORDINALS) - 1)]} equality of {label}"
    stated = {"label": label, "letters": letters, "index": index, "aside": typed.aside}
    others = tuple(StudentEquation(**vars(reading) | stated) for reading in typed.others)
    return StudentEquation(**vars(typed) | stated | {"others": others})


@lru_cache(maxsize=16)
def abbreviations(statement: Statement) -> dict[Any, Any]:
    """Return {symbol: expression in quaternions} for matrix entries and rates of rotations, and their derivatives.

    Equations have symbols such as R_body_x and R_body_x_dot, so that their terms remain as typed.
    """
    return {symbol: in_full(f).xreplace(statement.plain) for f, symbol in rate_symbols(statement).items()}


def rate_symbols(statement: Statement) -> dict[Any, Any]:
    """Return {function of time: symbol such as R_body_x} for entries and rates of rotations and their derivatives."""
    rates = {f: sympy.Symbol(name, real=True) for name, f in shorthands(statement.rotations).items()}
    return rates | {f.diff(t): sympy.Symbol(f"{symbol}_dot", real=True) for f, symbol in rates.items()}


DIGITS = 40  # Decimal digits of evaluations; the accelerations are accurate to about 30 digits
ZERO = 1e-12  # Rounding error of accelerations, relative to 1 plus the largest of them

LARGEST_RESIDUAL = 1e-14
"""Largest difference of the two sides of an equation that holds, relative to its terms. Its numbers may have rounding
errors of about 50 operations on doubles. A wrong term passes only if it is smaller than this at every state."""


@dataclass(frozen=True, eq=False)
class EquationRow:
    """A typed equation split into coefficients: left minus right side = `rest` + sum of `slopes`[z] * z.

    The unknowns z are accelerations and multipliers. `zero` is left minus right side, in which symbols that the answer
    defines, and rates of rotations, are replaced by their values. `equation` is the equation as typed.
    """

    statement: Statement
    equation: StudentEquation
    zero: Any
    slopes: Mapping[Any, Any]
    rest: Any

    @cached_property
    def sides(self) -> tuple[Any, Any]:
        """The left and the right side as typed: symbols that the answer defines, and rates of rotations, are kept."""
        return self.equation.zero + self.equation.right, self.equation.right

    def with_zero(self, zero: Any, right: Any = sympy.S.Zero) -> EquationRow:
        """Return an `EquationRow` for another equation, `zero` = 0, with the label of this row.

        Its right side is `right`, and its left side zero + right. Raises StatementError if it is not linear in
        accelerations and multipliers.
        """
        equation = StudentEquation(zero, right, label=self.equation.label, meanings=self.equation.meanings)
        return row_of(equation, self.statement)

    def in_full(self, expression: Any) -> Any:
        """Return an expression with values in place of symbols that the answer defines, and of rates of rotations."""
        return expression.xreplace(dict(self.equation.meanings)).xreplace(abbreviations(self.statement))

    @cached_property
    def _tape(self) -> Precise:
        # Rounding in an equation without unknowns, such as a constraint, is relative to its terms.
        parts = () if any(self.slopes.values()) else sympy.Add.make_args(self.rest)
        return tape([*self.slopes.values(), self.rest, *parts], self.statement)

    @property
    def switches(self) -> tuple[Any, ...]:
        """The switches in the equation, which are its conditions, Abs, sign, Min and Max, in functions of time."""
        return self._tape.switches

    def ways(self, point: SamplePoint) -> tuple[int | None, ...]:
        """Return the outcome of each of `switches` at a state, such as 1 for a true condition; None without a value.

        Raises OutsideDomain if the equation has no value at the state.
        """
        outcomes, _ = self._tape.inspect(point.q, point.v, point.t, point.parameters)
        return outcomes

    def numbers(self, sample: MotionSample) -> list[Any]:
        """Return the coefficients of accelerations and multipliers in numbers. Raises OutsideDomain without a value."""
        return values_at(self._tape, sample)[: len(self.slopes)]

    def leading(self, sample: MotionSample) -> list[Any]:
        """Return the coefficients of accelerations and multipliers at a sample, or those of the equation's derivative.

        An equation without these unknowns is first differentiated in time once or twice, until it has accelerations.
        Raises OutsideDomain if a coefficient has no value.
        """
        if any(self.slopes.values()):
            return self.numbers(sample)
        plain = list(self.statement.plain.values())
        symbols = plain[1::3] if self.zero.has(*plain[1::3]) else plain[::3]
        slopes = values_at(tape([sympy.diff(self.zero, symbol) for symbol in symbols], self.statement), sample)
        return [*slopes, *[0] * len(sample.multipliers)]

    def residual(self, sample: MotionSample) -> tuple[Any, Any]:
        """Return (left minus right side, magnitude of the terms in it) at a sample, with the true accelerations."""
        values, count = values_at(self._tape, sample), len(self.slopes)
        slopes, rest, parts = values[:count], values[count], values[count + 1 :]
        solved = [*sample.accelerations, *sample.multipliers]
        terms = [slope * x for slope, x in zip(slopes, solved, strict=True)]
        # An acceleration that is zero has a rounding error, too.
        rounding = ZERO * (1 + max(map(abs, solved))) * sum(map(abs, slopes))
        return sum(terms) + rest, sum(map(abs, terms)) + max(abs(rest), sum(map(abs, parts))) + rounding

    def holds(self, samples: Sequence[MotionSample]) -> bool:
        """Return True if the true accelerations satisfy the equation at every sample at which it has a value.

        The result is False if there is no such sample.
        """
        tried = False
        for sample in samples:
            with suppress(OutsideDomain):
                left, size = self.residual(sample)
                if abs(left) > LARGEST_RESIDUAL * size:
                    return False
                tried = True
        return tried


def unknowns_of(statement: Statement) -> list[Any]:
    """Return the symbols of the unknowns in the equations of motion: the accelerations, then the multipliers."""
    return [*list(statement.plain.values())[2::3], *(constraint.multiplier for constraint in statement.constraints)]


# Functions in the derivative of an equation by an acceleration, if the equation is not smooth in it
_JUMPS = (sympy.Heaviside, sympy.DiracDelta, sympy.sign, sympy.Abs, sympy.Max, sympy.Min, sympy.Piecewise)


def row_of(equation: StudentEquation, statement: Statement) -> EquationRow:
    """Return an equation of an answer, split into its coefficients of accelerations and multipliers.

    Raises StatementError if it is not linear in them.
    """
    zero = equation.zero.xreplace(dict(equation.meanings)).xreplace(abbreviations(statement))
    if zero.has(sympy.DiracDelta):
        raise StatementError(
            f"{equation.label} has the derivative of a jump, such as heaviside, which is not a function: write the "
            "equation without it."
        )
    unknowns = unknowns_of(statement)
    present = [symbol for symbol in unknowns if zero.has(symbol)]
    slopes = {symbol: sympy.diff(zero, symbol) if symbol in present else sympy.S.Zero for symbol in unknowns}
    bent = [
        symbol
        for symbol in present
        if any(jump.has(*present) for jump in slopes[symbol].atoms(*_JUMPS))
        or any(not vanishes(sympy.diff(slopes[symbol], x)) for x in present)
    ]
    if bent:
        raise StatementError(
            f"{equation.label} is not linear in {listing(map(str, bent))}: equations of motion are compared as linear "
            "equations for the accelerations. Solve it for them, outside of functions and powers."
        )
    zeros = dict.fromkeys(present, sympy.S.Zero)
    slopes = {symbol: slope.xreplace(zeros) for symbol, slope in slopes.items()}
    rest = zero.xreplace(zeros)
    return EquationRow(statement, equation, zero, slopes, rest)


def tape(expressions: Sequence[Any], statement: Statement) -> Precise:
    """Return a program that computes expressions in the symbols of a statement with `DIGITS` decimal digits.

    The derivative of a jump, such as of sign(x) at zero, is taken as zero. Raises OutsideDomain if a constant has no
    value.
    """
    stated = {symbol: leaf for leaf, symbol in statement.plain.items()}
    smooth = (expression.replace(sympy.DiracDelta, lambda *_: sympy.S.Zero) for expression in expressions)
    return Precise([expression.xreplace(stated) for expression in smooth], statement, DIGITS)


def values_at(expressions: Precise, sample: MotionSample) -> list[Any]:
    """Return the values of all expressions of a program at a sample. Raises OutsideDomain if one has no value."""
    point, number = sample.point, expressions.context.mpf
    return expressions(point.q, point.v, point.t, {p: number(x) for p, x in point.parameters.items()})
