"""Spell names and formulas on one line, in plain text or in Unicode, and escape texts for LaTeX and Markdown."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from lagrange.statement.vocabulary.letters import GREEK as LETTERS

UNICODE_GREEK = {name: letter for letter, name in LETTERS.items()} | {"Pi": "Π"}
"""Greek letters by their LaTeX names without backslash. The name "pi" is missing, because it is always printed as the
number."""

GREEK = frozenset(UNICODE_GREEK)

_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{mark: "\\" + mark for mark in "{}$&#_%"},
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    **{letter: f"\\ensuremath{{\\{name}}}" for letter, name in LETTERS.items()},
}
_BRACKETS = str.maketrans("[]", "__")
"""Translation of brackets to underscores. Brackets enclose an index, as in lambda[rod], the multiplier of the
constraint rod."""

_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>()#+\-.!|$~&@:])")


def index_parts(name: str) -> tuple[str, list[str]]:
    """Split a name into a letter or word and a list of its indices.

    theta1 has the index 1, m_bob has the index bob, and lambda[rod] has the index rod.
    """
    head, *indices = [part for part in name.translate(_BRACKETS).split("_") if part]
    letters = head.rstrip("0123456789")
    return letters, [part for part in (head[len(letters) :], *indices) if part]


def latex_text(sentence: str) -> str:
    """Return a sentence for LaTeX's text mode, with special characters escaped."""
    return "".join(_LATEX.get(mark, mark) for mark in plain_text(sentence))


def markdown_text(sentence: str) -> str:
    """Return a sentence for Markdown, with special characters escaped."""
    return _MARKDOWN.sub(r"\\\1", plain_text(sentence))


def plain_text(sentence: str) -> str:
    """Return a sentence on one line, without control characters of a terminal."""
    return "".join(mark for mark in " ".join(sentence.split()) if mark.isprintable())


def word(name: str) -> str:
    """Return the LaTeX of a name: a Latin or Greek letter, or a word in upright letters, followed by its digits."""
    letters = name.rstrip("0123456789")
    digits, letters = name[len(letters) :], LETTERS.get(letters, letters)
    if letters in GREEK:
        return f"\\{letters}{digits}"
    return (upright(letters) if len(letters) > 1 else letters) + digits


def upright(word: str) -> str:
    """Return the LaTeX of a word in upright letters."""
    word = latin(word)
    return "\\mathrm{" + word.replace("_", "\\_") + "}"


def latin(name: str) -> str:
    """Return a name with its Greek letters spelled out: θ1 becomes theta1."""
    return "".join(LETTERS.get(mark, mark) for mark in name)


SUM, PRODUCT, FRACTION, POWER, ATOM = range(5)  # Precedence of the outermost operation of a formula, lowest first

CIRCULAR = frozenset(("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh", "coth", "sech", "csch"))
"""Functions that are printed like sin² θ: no parentheses around a single symbol, and the exponent after the name."""


@dataclass(frozen=True)
class FormulaPiece:
    """A part of a formula: its text, and `level`, the precedence of its outermost operation.

    For a function whose `text` has no parentheses, such as sin θ, `closed` is the text with them: sin(θ). `call` is
    true for a function such as sin, whose name begins the text. `simple` is true for a symbol, a number, or a number
    times a symbol.
    """

    text: str
    level: int = ATOM
    closed: str = ""
    simple: bool = False
    call: bool = False


SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
VULGAR = {unicodedata.normalize("NFKC", mark).replace("⁄", "/"): mark for mark in "½⅓⅔¼¾⅕⅙⅚⅛⅜⅝⅞"}
DOTS = ("", "\N{COMBINING DOT ABOVE}", "\N{COMBINING DIAERESIS}")
RATES = ("", "_dot", "_ddot")
SCRIPT = {"T": "𝒯", "V": "𝒱", "L": "ℒ", "D": "𝒟", "E": "ℰ", "J": "𝒥", "Q": "𝒬", "M": "ℳ"}


def width(text: str) -> int:
    """Return the number of columns that a text takes in a terminal; a combining dot takes none."""
    return sum(not unicodedata.combining(mark) for mark in text)


class Notation:
    """Spelling of formulas in plain text, as in scene files: m*l**2*theta_ddot + m*g*l*sin(theta).

    The classes for Unicode, LaTeX and MathML override the templates and methods whose results differ.
    """

    opening, closing = "(", ")"
    """Parentheses around a sum that takes several lines."""

    times = "* "
    """Text before the second factor of a product, if this factor begins on a new line."""

    in_one_line = True
    """True if fractions are written with a slash. The text is then as wide as the printed formula; False for LaTeX and
    MathML."""

    fractions_in_front = False
    """True if constants are a separate fraction in front, (g/l) sin(theta); False for a single fraction,
    g*sin(theta)/l."""

    level_inside_product = FRACTION
    """Least precedence of a factor that is printed without parentheses if another factor follows it in the product."""

    product_sign, comma, equals = "*", ", ", " = "
    """Text between factors, between arguments or entries of a vector, and between the sides of an equation."""

    signs_between, sign_before, sign_of_line = (" + ", " - "), ("", "-"), ("+ ", "- ")
    """Signs of added and of subtracted terms, a pair each: between two terms, before the first term of a sum, and
    before the first term on a line that continues a sum."""

    words, slashed, transpose, derivative, time_derivative = "{0}", "{0}/{1}", "{0}.T", "d{0}/d{1}", "d/dt({0})"
    """Templates for parts of a formula: words, a fraction of two numbers with a slash, a transpose, a partial
    derivative, and a time derivative."""

    relation = "{0} {1} {2}"
    relations: ClassVar[Mapping[str, str]] = {}
    """Spellings of the comparison signs <, <=, >, >=, = and != in conditions, such as "≤" for "<=". A sign without an
    entry is printed as it is. `relation` is the template of a condition: left side, sign, right side."""

    constants: ClassVar[Mapping[str, str]] = {"e": "exp(1)", "infinity": "oo"}
    """Spellings of the constants "pi", "e" and "infinity"; a constant without an entry is printed by its name."""

    case, otherwise, case_separator, case_frame = "({0}, {1})", "({0}, True)", ", ", "Piecewise({0})"
    """Templates of a piecewise expression: a value with its condition, the value that holds otherwise, the text between
    two values, and the frame around all of them."""

    def __init__(self, names: Sequence[str] = ()) -> None:
        """Store the names of all symbols. A name that would be printed like an earlier one is printed as stated."""
        self.literal: frozenset[str] = frozenset()
        seen: dict[str, str] = {}
        for name in names:
            seen.setdefault(self.letter(name), name)
        self.literal = frozenset(name for name in names if seen[self.letter(name)] != name)

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return a name with dots for time derivatives and further names as indices: theta_dot, or p_theta."""
        spelled = name if name in self.literal else latin(name)
        return "_".join([spelled + RATES[dots], *map(latin, indices)])

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return the symbol of a quantity whose usual `letter`, such as L, is a name in the system.

        In plain text the symbol is the `word`, such as Lagrangian, followed by the names `indices`.
        """
        return "_".join([word, *indices])

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        """Return a number without a sign, `digits` times a power of ten if `exponent` is given: 6.674e-11."""
        return FormulaPiece(digits if exponent is None else f"{digits}e{exponent}", simple=True)

    def constant(self, name: str) -> str:
        """Return the spelling of the constant `name`: "pi", "e" or "infinity"."""
        return self.constants.get(name, name)

    def brackets(self, inside: str) -> str:
        """Return the text `inside` in parentheses."""
        return f"({inside})"

    def joined(self, texts: Sequence[str]) -> str:
        """Return the product of factors; `texts` are the texts of the factors, with the necessary parentheses."""
        return self.product_sign.join(texts)

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        """Return the fraction of numerator `above` and denominator `below` on one line, such as a*b/(c*d)."""
        return FormulaPiece(f"{self.grouped(above, PRODUCT)}/{self.grouped(below, POWER)}", PRODUCT)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return `base` raised to `exponent`, such as x**2. The base already has the necessary parentheses."""
        return FormulaPiece(f"{base}**{exponent if exponent.isalnum() else self.brackets(exponent)}", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        """Return the square root of `inside`."""
        return FormulaPiece(f"sqrt({inside.text})")

    def function(self, name: str, arguments: Sequence[FormulaPiece], exponent: str = "") -> FormulaPiece:
        """Return the function `name` of its arguments, raised to the whole number `exponent` unless that is empty."""
        return self.power_of(f"{name}({self.listed(arguments)})", exponent)

    def listed(self, arguments: Sequence[FormulaPiece]) -> str:
        """Return the arguments of a function, separated by commas."""
        return self.comma.join(argument.text for argument in arguments)

    def power_of(self, value: str, exponent: str) -> FormulaPiece:
        """Return `value`, the text of a function with its arguments, raised to `exponent` unless that is empty."""
        return self.raised(value, exponent) if exponent else FormulaPiece(value)

    def cases(self, rows: Sequence[tuple[str, str]]) -> FormulaPiece:
        """Return a piecewise expression; `rows` are pairs of value and condition.

        The last condition may be empty: its value holds in all other cases.
        """
        parts = [(self.case if row[1] else self.otherwise).format(*row) for row in rows]
        return FormulaPiece(self.case_frame.format(self.case_separator.join(parts)))

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix from the texts of its entries: each of its `rows` in brackets on a line, columns aligned."""
        widths = [max(map(width, column)) for column in zip(*rows, strict=True)]
        lines = [[text + " " * (wide - width(text)) for text, wide in zip(row, widths, strict=True)] for row in rows]
        return "\n".join(f"[{',  '.join(line)}]" for line in lines)

    def partial(self, above: str, below: str) -> str:
        """Return the partial derivative of `above` by `below`, two letters, such as dL/dtheta."""
        return self.derivative.format(above, below)

    def signs(self, terms: Sequence[tuple[bool, str]], *, leading: bool = True) -> str:
        """Return the text of a sum; each of its terms is a pair (True if subtracted, text without sign).

        With `leading` the sum begins here, and a positive first term has no plus sign. Otherwise the text continues the
        sum of the line above, and the first term has a sign.
        """
        (negative, first), *rest = terms
        start = (self.sign_before if leading else self.sign_of_line)[negative]
        return start + first + "".join(self.signs_between[sign] + term for sign, term in rest)

    def grouped(self, piece: FormulaPiece, level: int) -> str:
        """Return the text of a piece, in parentheses if its precedence is below `level`."""
        return piece.text if piece.level >= level else self.brackets(piece.text)

    def product(self, pieces: Sequence[FormulaPiece]) -> FormulaPiece:
        """Return the text of a product from its factors `pieces`, with parentheses where they are necessary.

        A function without parentheses, such as sin θ, becomes sin(θ) unless it is the last factor or a function
        follows.
        """
        if len(pieces) == 1:
            return pieces[0]
        texts = []
        for index, piece in enumerate(pieces):
            last = index == len(pieces) - 1
            text = self.grouped(piece, FRACTION if last else self.level_inside_product)
            if piece.closed and not last and not pieces[index + 1].call:
                text = piece.closed
            texts.append(text)
        simple = len(pieces) == 2 and pieces[0].text[:1].isdigit() and pieces[1].simple
        return FormulaPiece(self.joined(texts), PRODUCT, simple=simple)


class BookNotation(Notation):
    """Spelling of formulas as in textbooks: sin θ without parentheses, powers of e instead of exp, and ln for log."""

    fractions_in_front = True
    magnitude = "|{0}|"
    """Template of an absolute value."""

    function_names: ClassVar[Mapping[str, str]] = {"log": "ln"}
    """Printed names of functions by their names in expressions. A function without an entry has the same name."""

    def function(self, name: str, arguments: Sequence[FormulaPiece], exponent: str = "") -> FormulaPiece:
        """Return the function `name` of its arguments, such as cos(a - b), |x| or e^(-t), raised to any `exponent`.

        `exponent` is a text, and empty for the exponent 1. That of a circular or hyperbolic function follows its name:
        sin² θ.
        """
        inside = self.listed(arguments)
        if name == "abs":
            return self.power_of(self.magnitude.format(inside), exponent)
        head = self.function_name(name)
        if name == "exp":
            return self.raised(self.applied(head, inside), exponent) if exponent else self.power_of_e(inside)
        if name not in CIRCULAR or len(arguments) != 1:
            return self.power_of(self.applied(head, inside), exponent)
        head = self.raised(head, exponent).text if exponent else head
        closed = self.applied(head, inside)
        if arguments[0].simple:
            return FormulaPiece(self.beside(head, inside), closed=closed, call=True)
        return FormulaPiece(closed, call=True)

    def function_name(self, name: str) -> str:
        """Return the printed name of the function `name`, such as ln for log."""
        return self.function_names.get(name, name)

    def applied(self, head: str, inside: str) -> str:
        """Return the function `head` with the text of its arguments, `inside`, in parentheses: f(x, y)."""
        return head + self.brackets(inside)

    def beside(self, head: str, inside: str) -> str:
        """Return the function `head` followed by the single symbol `inside` without parentheses: sin θ."""
        return f"{head} {inside}"

    def power_of_e(self, exponent: str) -> FormulaPiece:
        """Return e raised to `exponent`, for the exponential function of textbooks."""
        return self.raised(self.constant("e"), exponent)


class UnicodeNotation(BookNotation):
    """Formulas on one line of Unicode, as in textbooks: m l² θ̈ + m g l sin θ."""

    level_inside_product, product_sign = POWER, " "
    signs_between, sign_before, sign_of_line = (" + ", " − "), ("", "−"), ("+ ", "− ")
    transpose, derivative, time_derivative = "{0}ᵀ", "∂{0}/∂{1}", "d/dt {0}"
    relations: ClassVar = {"<=": "≤", ">=": "≥", "!=": "≠"}
    constants: ClassVar = {"pi": "π", "infinity": "∞"}
    case, otherwise, case_separator, case_frame = "{0} if {1}", "{0} otherwise", "; ", "{{{0}}}"

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return a name with dots and indices: θ̈₁, or m_bob. An index that is not a number follows an underscore."""
        head, parts = index_parts(name) if name not in self.literal else (latin(name), [])
        head = UNICODE_GREEK.get(head, head) if name not in self.literal else head
        dotted = unicodedata.normalize("NFC", head[0] + DOTS[dots]) + head[1:]
        if all(part.isdigit() for part in parts):
            below = ",".join(parts).translate(SUBSCRIPT)
        else:
            below = "_" + "_".join(UNICODE_GREEK.get(part, part) for part in parts)
        return "_".join([dotted + below, *map(self.letter, indices)])

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return the symbol of a quantity whose usual `letter`, such as L, is a name in the system.

        It is the calligraphic letter, or the `word` if Unicode lacks the letter, then _ and the names `indices`.
        """
        return "_".join([SCRIPT.get(letter, word), *map(self.letter, indices)])

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        """Return a number, `digits` times a power of ten if `exponent` is given: 6.674·10⁻¹¹."""
        if exponent is None:
            return FormulaPiece(digits, simple=True)
        return FormulaPiece(f"{digits}·10{str(exponent).translate(SUPERSCRIPT)}", POWER)

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        """Return the fraction of numerator `above` and denominator `below`, such as ½, g/l or (a + b)/(c d)."""
        if f"{above.text}/{below.text}" in VULGAR:
            return FormulaPiece(VULGAR[f"{above.text}/{below.text}"])
        opened = any(f"{name} " in above.text or f"{name}²" in above.text for name in CIRCULAR)
        over = above.closed or (self.brackets(above.text) if opened or above.level == SUM else above.text)
        return FormulaPiece(f"{over}/{below.closed or self.grouped(below, POWER)}", FRACTION)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return `base` raised to `exponent`: x², x^n or x^(3/2). The base already has the necessary parentheses."""
        if exponent.lstrip("-").isdigit():
            return FormulaPiece(base + exponent.translate(SUPERSCRIPT), POWER)
        return FormulaPiece(f"{base}^{exponent if len(exponent) == 1 else self.brackets(exponent)}", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        """Return the square root of `inside`, such as √x or √(a + b)."""
        short = inside.simple and len(inside.text) < 3
        return FormulaPiece("√" + (inside.text if short else self.brackets(inside.text)))

    def beside(self, head: str, inside: str) -> str:
        """Return the function `head` followed by the single symbol `inside` without parentheses: sin 2θ."""
        return f"{head} {inside.replace(' ', '')}"

    def power_of_e(self, exponent: str) -> FormulaPiece:
        """Return e raised to `exponent`, which is in parentheses: e^(-t)."""
        return FormulaPiece(f"e^{self.brackets(exponent)}", POWER)


class PrintedWidth(UnicodeNotation):
    """Notation that measures formulas: its text has the width of the formula on paper, and is not shown to anyone.

    A fraction is replaced by the wider one of numerator and denominator. Factors follow each other without blanks,
    except before a function.
    """

    product_sign, time_derivative = "", "dt {0}"

    def function(self, name: str, arguments: Sequence[FormulaPiece], exponent: str = "") -> FormulaPiece:
        """Return the text of a function as in Unicode, with a blank before it that is as wide as the printed gap."""
        piece = super().function(name, arguments, exponent)
        return replace(piece, text=f" {piece.text}", closed=f" {piece.closed}" if piece.closed else "")

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        """Return the numerator `above` or the denominator `below`: the wider one, which sets the printed width."""
        return FormulaPiece(max(above.text, below.text, key=width), POWER)

    def partial(self, above: str, below: str) -> str:
        """Return the wider one of numerator and denominator of the partial derivative of `above` by `below`.

        For L and q the result is ∂L.
        """
        return "∂" + max(above, below, key=width)
