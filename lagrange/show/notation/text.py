"""Formulas on one line: plain text as in a scene file, and Unicode with superscripts, Greek letters and dots."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

from lagrange.show.notation.pieces import ATOM, CIRCULAR, FRACTION, POWER, PRODUCT, SUM, Notation, Piece
from lagrange.show.notation.symbols import UNICODE_GREEK, index_parts, latin

SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
VULGAR = {
    (1, 2): "½",
    (1, 3): "⅓",
    (2, 3): "⅔",
    (1, 4): "¼",
    (3, 4): "¾",
    (1, 5): "⅕",
    (1, 6): "⅙",
    (5, 6): "⅚",
    (1, 8): "⅛",
    (3, 8): "⅜",
    (5, 8): "⅝",
    (7, 8): "⅞",
}
DOTS = ("", "\N{COMBINING DOT ABOVE}", "\N{COMBINING DIAERESIS}")
RATES = ("", "_dot", "_ddot")
SCRIPT = {"T": "𝒯", "V": "𝒱", "L": "ℒ", "D": "𝒟", "E": "ℰ", "J": "𝒥", "Q": "𝒬", "M": "ℳ"}


def width(text: str) -> int:
    """Return the number of columns of a text; a combining dot takes none."""
    return sum(not unicodedata.combining(mark) for mark in text)


class AsciiNotation(Notation):
    """Plain text in the spelling of scene files, which reads it back: m*l**2*theta_ddot + m*g*l*sin(theta)."""

    fractions_in_front = False
    in_one_line = True
    product_sign, minus = "*", "-"

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return theta_dot, or p_theta."""
        spelled = name if name in self.literal else latin(name)
        return "_".join([spelled + RATES[dots], *map(latin, indices)])

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return the word."""
        return "_".join([word, *indices])

    def number(self, digits: str, exponent: int | None = None) -> Piece:
        """Return 6.674e-11."""
        return Piece(digits if exponent is None else f"{digits}e{exponent}", simple=True)

    def constant(self, name: str) -> str:
        """Return pi, exp(1) or oo."""
        return {"e": "exp(1)", "infinity": "oo"}.get(name, name)

    def brackets(self, inside: str) -> str:
        """Return (inside)."""
        return f"({inside})"

    def joined(self, texts: Sequence[str]) -> str:
        """Return factors with stars between them."""
        return self.product_sign.join(texts)

    def fraction(self, above: Piece, below: Piece) -> Piece:
        """Return a*b/(c*d)."""
        return Piece(f"{self.grouped(above, PRODUCT)}/{self.grouped(below, POWER)}", PRODUCT)

    def raised(self, base: str, exponent: str) -> Piece:
        """Return base**exponent."""
        return Piece(f"{base}**{exponent if exponent.isalnum() else self.brackets(exponent)}", POWER)

    def root(self, inside: Piece) -> Piece:
        """Return sqrt(inside)."""
        return Piece(f"sqrt({inside.text})")

    def function(self, name: str, arguments: Sequence[Piece], exponent: str = "") -> Piece:
        """Return name(a, b)."""
        value = Piece(f"{name}({', '.join(argument.text for argument in arguments)})")
        return self.raised(value.text, exponent) if exponent else value

    def cases(self, rows: Sequence[tuple[str, str]]) -> Piece:
        """Return Piecewise((value, condition), ...), in SymPy's spelling."""
        return Piece(f"Piecewise({', '.join(f'({value}, {condition or True})' for value, condition in rows)})")

    def comparison(self, left: str, relation: str, right: str) -> str:
        """Return left < right."""
        return f"{left} {relation} {right}"

    def text(self, words: str) -> str:
        """Return words in a formula."""
        return words

    def in_line(self, above: str, below: str) -> str:
        """Return above/below."""
        return f"{above}/{below}"

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return rows in brackets, one per line, with aligned columns."""
        widths = [max(map(width, column)) for column in zip(*rows, strict=True)]
        lines = [[text + " " * (wide - width(text)) for text, wide in zip(row, widths, strict=True)] for row in rows]
        return "\n".join(f"[{',  '.join(line)}]" for line in lines)

    def transposed(self, matrix: str) -> str:
        """Return G.T."""
        return f"{matrix}.T"

    def vector(self, entries: Sequence[str]) -> str:
        """Return (a, b)."""
        return self.brackets(", ".join(entries))

    def partial(self, above: str, below: str) -> str:
        """Return dL/dtheta."""
        return f"d{above}/d{below}"

    def rate(self, inside: str) -> str:
        """Return d/dt(dL/dtheta_dot)."""
        return f"d/dt({inside})"

    def signs(self, terms: Sequence[tuple[bool, str]], *, leading: bool = True) -> str:
        """Return a + b - c."""
        (negative, first), *rest = terms
        minus = self.minus
        start = (minus if negative else "") if leading else (f"{minus} " if negative else "+ ")
        return start + first + "".join(f" {minus if sign else '+'} {term}" for sign, term in rest)


class UnicodeNotation(AsciiNotation):
    """One line of Unicode in the spelling of textbooks: m l² θ̈ + m g l sin θ."""

    fractions_in_front = True
    level_inside_product = POWER
    product_sign, minus = " ", "\N{MINUS SIGN}"

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return θ̈₁, or m_bob: an index that is not a number follows an underscore."""
        head, parts = index_parts(name) if name not in self.literal else (latin(name), [])
        head = UNICODE_GREEK.get(head, head) if name not in self.literal else head
        dotted = unicodedata.normalize("NFC", head[0] + DOTS[dots]) + head[1:]
        if all(part.isdigit() for part in parts):
            below = ",".join(parts).translate(SUBSCRIPT)
        else:
            below = "_" + "_".join(UNICODE_GREEK.get(part, part) for part in parts)
        return "_".join([dotted + below, *map(self.letter, indices)])

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return a calligraphic capital, or the word."""
        return "_".join([SCRIPT.get(letter, word), *map(self.letter, indices)])

    def number(self, digits: str, exponent: int | None = None) -> Piece:
        """Return 6.674·10⁻¹¹."""
        if exponent is None:
            return Piece(digits, simple=True)
        return Piece(f"{digits}·10{str(exponent).translate(SUPERSCRIPT)}", POWER)

    def constant(self, name: str) -> str:
        """Return π, e or ∞."""
        return {"pi": "π", "infinity": "∞"}.get(name, name)

    def fraction(self, above: Piece, below: Piece) -> Piece:
        """Return ½, g/l or (a + b)/(c d)."""
        if above.text.isdigit() and below.text.isdigit() and (int(above.text), int(below.text)) in VULGAR:
            return Piece(VULGAR[int(above.text), int(below.text)])
        opened = any(f"{name} " in above.text or f"{name}²" in above.text for name in CIRCULAR)
        over = above.closed or (self.brackets(above.text) if opened or above.level == SUM else above.text)
        return Piece(f"{over}/{below.closed or self.grouped(below, POWER)}", FRACTION)

    def raised(self, base: str, exponent: str) -> Piece:
        """Return base², base^n or base^(3/2)."""
        if exponent.lstrip("-").isdigit():
            return Piece(base + exponent.translate(SUPERSCRIPT), POWER)
        return Piece(f"{base}^{exponent if len(exponent) == 1 else self.brackets(exponent)}", POWER)

    def root(self, inside: Piece) -> Piece:
        """Return √x or √(a + b)."""
        return Piece("√" + (inside.text if inside.simple and len(inside.text) < 3 else self.brackets(inside.text)))

    def function(self, name: str, arguments: Sequence[Piece], exponent: str = "") -> Piece:
        """Return sin² θ, cos(a − b), |x|, or e^(−t)."""
        inside = ", ".join(argument.text for argument in arguments)
        if name == "abs":
            return self.power_of(Piece(f"|{inside}|"), exponent)
        if name == "exp":
            return (
                Piece(f"e^{self.brackets(inside)}", POWER) if not exponent else self.raised(f"exp({inside})", exponent)
            )
        shown = {"log": "ln"}.get(name, name)
        if name in CIRCULAR and len(arguments) == 1:
            head = shown + exponent.translate(SUPERSCRIPT)
            closed = f"{head}({inside})"
            if arguments[0].simple:
                return Piece(f"{head} {inside.replace(' ', '')}", closed=closed, call=True)
            return Piece(closed, call=True)
        return self.power_of(Piece(f"{shown}({inside})"), exponent)

    def power_of(self, value: Piece, exponent: str) -> Piece:
        """Return the value of a function, raised to the exponent if there is one."""
        return self.raised(value.text, exponent) if exponent else value

    def cases(self, rows: Sequence[tuple[str, str]]) -> Piece:
        """Return {a if c; b otherwise}."""
        parts = [f"{value} if {condition}" if condition else f"{value} otherwise" for value, condition in rows]
        return Piece("{" + "; ".join(parts) + "}", ATOM)

    def transposed(self, matrix: str) -> str:
        """Return Gᵀ."""
        return f"{matrix}ᵀ"

    def comparison(self, left: str, relation: str, right: str) -> str:
        """Return left ≤ right."""
        return f"{left} {({'<=': '≤', '>=': '≥', '!=': '≠'}).get(relation, relation)} {right}"

    def partial(self, above: str, below: str) -> str:
        """Return ∂L/∂θ̇."""
        return f"∂{above}/∂{below}"

    def rate(self, inside: str) -> str:
        """Return d/dt ∂L/∂θ̇."""
        return f"d/dt {inside}"
