"""Formulas in MathML, which browsers render without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from lagrange.show.notation.symbols import UNICODE_GREEK, index_parts, latin
from lagrange.show.notation.text import ATOM, CIRCULAR, POWER, SUM, FormulaPiece, Notation, UnicodeNotation

DOTS = ("", "\N{DOT ABOVE}", "\N{DIAERESIS}")
APPLY = "<mo>\N{FUNCTION APPLICATION}</mo>"
SPACE = '<mspace width="0.17em"/>'
"""Thin space around the name of a function; browsers add none."""
TALL = ("<mfrac", "<mtable", "<msqrt")
"""Elements that are taller than a line of text."""
CALLS = tuple(f"<mrow>{power}<mi>{name}</mi>" for name in sorted(CIRCULAR) for power in ("", "<msup>"))
"""Beginnings of the MathML of a function with a name."""


def row(*parts: str) -> str:
    """Return elements as one mrow element."""
    return f"<mrow>{''.join(parts)}</mrow>"


def operator(sign: str) -> str:
    """Return a sign as an operator element."""
    return f"<mo>{escape(sign)}</mo>"


class MathmlNotation(Notation):
    """MathML; every text is one element, except that a sum may be several elements."""

    in_one_line, fractions_in_front = False, True

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return a name as a letter, with dots above it for time derivatives and with indices below the line."""
        head, parts = index_parts(name) if name not in self.literal else (latin(name), [])
        spelled = f"<mi>{escape(head if name in self.literal else UNICODE_GREEK.get(head, head))}</mi>"
        if dots:
            spelled = f'<mover accent="true">{spelled}<mo>{DOTS[dots]}</mo></mover>'
        elements = [f"<{_kind(part)}>{escape(UNICODE_GREEK.get(part, part))}</{_kind(part)}>" for part in parts]
        return self.below(spelled, [*elements, *map(self.letter, indices)])

    def below(self, head: str, parts: Sequence[str]) -> str:
        """Return the element `head` with the elements `parts` as indices below the line."""
        return f"<msub>{head}{parts[0] if len(parts) == 1 else row(*parts)}</msub>" if parts else head

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return a calligraphic letter if there is one, else the word; with indices.

        It replaces a letter that looks like a symbol of the user.
        """
        shown = (
            chr(0x1D49C + ord(letter) - ord("A"))
            if letter in "DQTV"
            else {"L": "ℒ", "E": "ℰ"}.get(letter, word.replace("_", " "))
        )
        return self.below(f"<mi>{shown}</mi>", list(map(self.letter, indices)))

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        """Return a number, with a power of ten if `exponent` is given: 6.674·10⁻¹¹."""
        if exponent is None:
            return FormulaPiece(f"<mn>{digits}</mn>", simple=True)
        power = f"<msup><mn>10</mn><mn>{exponent}</mn></msup>"
        return FormulaPiece(row(f"<mn>{digits}</mn>", operator("·"), power), POWER)

    def constant(self, name: str) -> str:
        """Return the sign of a constant: π, e or ∞."""
        return f"<mi>{({'pi': 'π', 'infinity': '∞'}).get(name, name)}</mi>"

    def brackets(self, inside: str) -> str:
        """Return elements in parentheses. Around a single line they do not stretch, which would add wide gaps."""
        if any(tall in inside for tall in TALL):
            return row(operator("("), inside, operator(")"))
        return row('<mo stretchy="false">(</mo>', inside, '<mo stretchy="false">)</mo>')

    def joined(self, texts: Sequence[str]) -> str:
        """Return a product: factors side by side, with a space before a function."""
        return row(*(SPACE + text if k and text.startswith(CALLS) else text for k, text in enumerate(texts)))

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        """Return a fraction: `above` over `below`."""
        return FormulaPiece(f"<mfrac>{_one(above)}{_one(below)}</mfrac>", POWER)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return a power as one element: `base` with the raised `exponent`."""
        shown = f"<mn>{exponent}</mn>" if exponent.lstrip("-").isdigit() else row(exponent)
        return FormulaPiece(f"<msup>{base}{shown}</msup>", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        """Return the square root of `inside`."""
        return FormulaPiece(f"<msqrt>{inside.text}</msqrt>")

    def function(self, name: str, arguments: Sequence[FormulaPiece], exponent: str = "") -> FormulaPiece:
        """Return a function of its arguments, raised to an exponent if given."""
        inside = operator(",").join(argument.text for argument in arguments)
        if name == "abs":
            return self.power_of(row(operator("|"), inside, operator("|")), exponent)
        if name == "exp":
            shown = row("<mi>exp</mi>", self.brackets(inside))
            return self.raised(shown, exponent) if exponent else self.raised("<mi>e</mi>", inside)
        if name in CIRCULAR and len(arguments) == 1:
            head = f"<mi>{name}</mi>" if not exponent else f"<msup><mi>{name}</mi><mn>{exponent}</mn></msup>"
            closed = row(head, APPLY, self.brackets(inside))
            if arguments[0].simple:
                return FormulaPiece(row(head, APPLY, SPACE, inside), closed=closed, call=True)
            return FormulaPiece(closed, call=True)
        shown = f"<mi>{({'log': 'ln'}).get(name, name)}</mi>"
        return self.power_of(row(shown, APPLY, self.brackets(inside)), exponent)

    def cases(self, rows: Sequence[tuple[str, str]]) -> FormulaPiece:
        """Return pairs of value and condition as a table after a brace; the last condition may be empty."""
        lines = [
            f"<mtr><mtd>{row(value)}</mtd><mtd>{row(condition or '<mtext>otherwise</mtext>')}</mtd></mtr>"
            for value, condition in rows
        ]
        return FormulaPiece(row(operator("{"), f"<mtable>{''.join(lines)}</mtable>"), ATOM)

    def comparison(self, left: str, relation: str, right: str) -> str:
        """Return a condition, such as left ≤ right."""
        return left + operator(UnicodeNotation.relations.get(relation, relation)) + right

    def text(self, words: str) -> str:
        """Return words inside a formula."""
        return f"<mtext>{words}</mtext>"

    def in_line(self, above: str, below: str) -> str:
        """Return a fraction with a slash: above/below."""
        return row(above, operator("/"), below)

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix: a table in parentheses."""
        lines = ("".join(f"<mtd>{row(entry)}</mtd>" for entry in line) for line in rows)
        return self.brackets("<mtable>" + "".join(f"<mtr>{line}</mtr>" for line in lines) + "</mtable>")

    def transposed(self, matrix: str) -> str:
        """Return the transpose of a matrix that is named by a letter: the letter with a raised T."""
        return f"<msup>{matrix}<mi>T</mi></msup>"

    def vector(self, entries: Sequence[str]) -> str:
        """Return a vector: entries in parentheses, separated by commas."""
        return self.brackets(operator(",").join(entries))

    def equal(self, sides: Sequence[str]) -> str:
        """Return sides of an equation, with signs of equality between them."""
        return operator("=").join(sides)

    def partial(self, above: str, below: str) -> str:
        """Return a partial derivative as a fraction."""
        return f"<mfrac>{row('<mo>∂</mo>', above)}{row('<mo>∂</mo>', below)}</mfrac>"

    def rate(self, inside: str) -> str:
        """Return the time derivative d/dt of `inside`."""
        return f"<mfrac><mi>d</mi>{row('<mi>d</mi>', '<mi>t</mi>')}</mfrac>" + inside

    opening, closing = operator("("), operator(")")
    times = operator("\N{MULTIPLICATION SIGN}")

    def signs(self, terms: Sequence[tuple[bool, str]], *, leading: bool = True) -> str:
        """Return a sum such as a + b - c; each term has True if it is subtracted.

        With `leading` the first term has no plus sign; without it the sum continues the line above.
        """
        (negative, first), *rest = terms
        start = operator("\N{MINUS SIGN}") if negative else "" if leading else operator("+")
        return start + first + "".join(operator("\N{MINUS SIGN}" if sign else "+") + term for sign, term in rest)


def _one(piece: FormulaPiece) -> str:
    """Return a piece of a formula as a single element."""
    return row(piece.text) if piece.level == SUM else piece.text


def _kind(part: str) -> str:
    return "mn" if part.isdigit() else "mi"
