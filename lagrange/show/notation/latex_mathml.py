"""Spell formulas in LaTeX, for which amsmath is enough, and in MathML, which browsers render without scripts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import ClassVar

from lagrange.show.notation.text import (
    CIRCULAR,
    POWER,
    SUM,
    UNICODE_GREEK,
    BookNotation,
    FormulaPiece,
    UnicodeNotation,
    index_parts,
    latin,
    upright,
    word,
)

COMMANDS = CIRCULAR - frozenset(("sech", "csch"))
"""Functions with a LaTeX command of the same name, such as sin. Others are in `LatexNotation.function_names`."""


class LatexNotation(BookNotation):
    """Spelling of formulas in LaTeX, for its math mode."""

    opening, closing = r"\bigl(", r"\bigr)"
    times, product_sign, in_one_line = r"{} \times ", " ", False
    sign_of_line = ("{} + ", "{} - ")
    words, transpose, time_derivative = r"\text{{{0}}}", "{0}^T", r"\frac{{d}}{{dt}} {0}"
    derivative = r"\frac{{\partial {0}}}{{\partial {1}}}"
    relations: ClassVar = {"<=": r"\le", ">=": r"\ge", "!=": r"\ne"}
    constants: ClassVar = {"pi": r"\pi", "infinity": r"\infty"}
    case, otherwise, case_separator = "{0} & {1}", r"{0} & \text{{otherwise}}", r" \\ "
    case_frame = r"\begin{{cases}} {0} \end{{cases}}"
    magnitude = r"\left|{0}\right|"
    function_names: ClassVar = {"log": r"\ln", "min": r"\min", "max": r"\max", "exp": r"\exp"}

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        r"""Return a name in LaTeX with dots for time derivatives and with indices: \ddot\theta_1, or p_\theta."""
        if name in self.literal:
            head, below = upright(name), list[str]()
        else:
            letters, words = index_parts(name)
            head, below = word(letters), [", ".join(map(word, words))]
        parts = [part for part in (*below, " ".join(map(self.letter, indices))) if part]
        head = f"\\{'d' * dots}ot{_argument(head, alone=False)}" if dots else head
        return head + (f"_{_argument(', '.join(parts))}" if parts else "")

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        r"""Return the symbol of a quantity whose usual `letter`, such as L, is a name in the system.

        A capital letter becomes calligraphic, \mathcal{L}. A small letter is replaced by the upright `word`. `indices`
        are names below the symbol.
        """
        spelled = f"\\mathcal{{{letter}}}" if letter.isupper() else upright(word).replace("\\_", "\\ ")
        return spelled + (f"_{_argument(' '.join(map(self.letter, indices)))}" if indices else "")

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        r"""Return a number, `digits` times a power of ten if `exponent` is given: 6.674 \cdot 10^{-11}."""
        if exponent is None:
            return FormulaPiece(digits, simple=True)
        return FormulaPiece(f"{digits} \\cdot 10^{{{exponent}}}", POWER)

    def brackets(self, inside: str) -> str:
        r"""Return `inside` in parentheses, which grow if it has a fraction or a matrix: \left(inside\right)."""
        return f"\\left({inside}\\right)" if "\\frac" in inside or "\\begin" in inside else f"({inside})"

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        r"""Return the fraction of numerator `above` and denominator `below`: \frac{above}{below}."""
        return FormulaPiece(f"\\frac{{{above.text}}}{{{below.text}}}", POWER)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return `base`, which may have dots and indices, raised to `exponent`: base^{exponent}."""
        return FormulaPiece(f"{base}^{_argument(exponent)}", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        r"""Return the square root of `inside`: \sqrt{inside}."""
        return FormulaPiece(f"\\sqrt{{{inside.text}}}")

    def function_name(self, name: str) -> str:
        """Return the LaTeX command of the function `name`, or the name in upright letters if it has no command.

        Primes of a derivative, as in f'', follow the name.
        """
        if name in CIRCULAR:
            return f"\\{name}" if name in COMMANDS else upright(name)
        return self.function_names.get(name) or self.letter(name.rstrip("'")) + "'" * name.count("'")

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix in LaTeX, in parentheses; `rows` are the texts of its entries."""
        return "\\begin{pmatrix} " + " \\\\ ".join(" & ".join(row) for row in rows) + " \\end{pmatrix}"


def _argument(text: str, *, alone: bool = True) -> str:
    """Return a text as the argument of a LaTeX command: in braces, except for a command or a single letter.

    With `alone` false a single letter has braces too, because it follows the name of a command.
    """
    return text if (alone and len(text) == 1) or re.fullmatch(r"\\[A-Za-z]+", text) else f"{{{text}}}"


DOTS = ("", "\N{DOT ABOVE}", "\N{DIAERESIS}")
APPLY = "<mo>\N{FUNCTION APPLICATION}</mo>"
SPACE = '<mspace width="0.17em"/>'  # Thin space around the name of a function; browsers add none
TALL = ("<mfrac", "<mtable", "<msqrt")  # Elements that are taller than a line of text
CALLS = tuple(f"<mrow>{power}<mi>{name}</mi>" for name in sorted(CIRCULAR) for power in ("", "<msup>"))
"""Beginnings of the MathML of a function such as sin θ or sin² θ. A factor with such a beginning has a space before
it."""
RELATIONS = ("<", "<=", ">", ">=", "=", "!=")


def row(*parts: str) -> str:
    """Return MathML elements as one element, an mrow."""
    return f"<mrow>{''.join(parts)}</mrow>"


def operator(sign: str) -> str:
    """Return a sign, such as +, as a MathML element for an operator."""
    return f"<mo>{escape(sign)}</mo>"


SIGNS = (operator("+"), operator("\N{MINUS SIGN}"))


class MathmlNotation(BookNotation):
    """Spelling of formulas in MathML; the text of a formula is one element, and the text of a sum may be several."""

    opening, closing, times = operator("("), operator(")"), operator("\N{MULTIPLICATION SIGN}")
    in_one_line, comma, equals = False, operator(","), operator("=")
    signs_between, sign_before, sign_of_line = SIGNS, ("", SIGNS[1]), SIGNS
    words, slashed = "<mtext>{0}</mtext>", row("{0}", operator("/"), "{1}")
    transpose, time_derivative = (
        "<msup>{0}<mi>T</mi></msup>",
        "<mfrac><mi>d</mi><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>{0}",
    )
    derivative = f"<mfrac>{row('<mo>∂</mo>', '{0}')}{row('<mo>∂</mo>', '{1}')}</mfrac>"
    relation = "{0}{1}{2}"
    relations: ClassVar = {sign: operator(UnicodeNotation.relations.get(sign, sign)) for sign in RELATIONS}
    constants: ClassVar = {"pi": "<mi>π</mi>", "infinity": "<mi>∞</mi>"}
    case = "<mtr><mtd><mrow>{0}</mrow></mtd><mtd><mrow>{1}</mrow></mtd></mtr>"
    otherwise = case.format("{0}", "<mtext>otherwise</mtext>")
    case_separator, case_frame = "", row(operator("{{"), "<mtable>{0}</mtable>")
    magnitude = row(operator("|"), "{0}", operator("|"))

    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return a name in MathML: a letter, with dots above it for time derivatives and indices below the line."""
        head, parts = index_parts(name) if name not in self.literal else (latin(name), [])
        spelled = f"<mi>{escape(head if name in self.literal else UNICODE_GREEK.get(head, head))}</mi>"
        if dots:
            spelled = f'<mover accent="true">{spelled}<mo>{DOTS[dots]}</mo></mover>'
        elements = [f"<{_kind(part)}>{escape(UNICODE_GREEK.get(part, part))}</{_kind(part)}>" for part in parts]
        return self.below(spelled, [*elements, *map(self.letter, indices)])

    def below(self, head: str, parts: Sequence[str]) -> str:
        """Return the element `head` with the elements `parts` as indices below the line; without parts only `head`."""
        return f"<msub>{head}{parts[0] if len(parts) == 1 else row(*parts)}</msub>" if parts else head

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return the symbol in MathML of a quantity whose usual `letter`, such as L, is a name in the system.

        The letter becomes calligraphic. A letter without a calligraphic form is replaced by its `word`. `indices` are
        names below the symbol.
        """
        shown = (
            chr(0x1D49C + ord(letter) - ord("A"))
            if letter in "DQTV"
            else {"L": "ℒ", "E": "ℰ"}.get(letter, word.replace("_", " "))
        )
        return self.below(f"<mi>{shown}</mi>", list(map(self.letter, indices)))

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        """Return a number in MathML, `digits` times a power of ten if `exponent` is given: 6.674·10⁻¹¹."""
        if exponent is None:
            return FormulaPiece(f"<mn>{digits}</mn>", simple=True)
        power = f"<msup><mn>10</mn><mn>{exponent}</mn></msup>"
        return FormulaPiece(row(f"<mn>{digits}</mn>", operator("·"), power), POWER)

    def constant(self, name: str) -> str:
        """Return the constant `name` ("pi", "e" or "infinity") in MathML: π, e or ∞."""
        return self.constants.get(name, f"<mi>{name}</mi>")

    def brackets(self, inside: str) -> str:
        """Return the MathML `inside` in parentheses, which stretch only around a tall text such as a fraction.

        Parentheses that stretch have wide gaps beside them.
        """
        if any(tall in inside for tall in TALL):
            return row(operator("("), inside, operator(")"))
        return row('<mo stretchy="false">(</mo>', inside, '<mo stretchy="false">)</mo>')

    def joined(self, texts: Sequence[str]) -> str:
        """Return a product in MathML: its factors, `texts`, side by side, with a space before a function."""
        return row(*(SPACE + text if k and text.startswith(CALLS) else text for k, text in enumerate(texts)))

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        """Return a fraction in MathML: `above` over `below`."""
        return FormulaPiece(f"<mfrac>{_one(above)}{_one(below)}</mfrac>", POWER)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return a power as one element of MathML: `base` with the raised `exponent`."""
        shown = f"<mn>{exponent}</mn>" if exponent.lstrip("-").isdigit() else row(exponent)
        return FormulaPiece(f"<msup>{base}{shown}</msup>", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        """Return the square root of `inside` in MathML."""
        return FormulaPiece(f"<msqrt>{inside.text}</msqrt>")

    def function_name(self, name: str) -> str:
        """Return the name of a function as a MathML element."""
        return f"<mi>{self.function_names.get(name, name)}</mi>"

    def applied(self, head: str, inside: str) -> str:
        """Return MathML of the function `head` with its arguments, `inside`, in parentheses."""
        return row(head, APPLY, self.brackets(inside))

    def beside(self, head: str, inside: str) -> str:
        """Return MathML of the function `head`, followed by the single symbol `inside` without parentheses: sin θ."""
        return row(head, APPLY, SPACE, inside)

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix in MathML: a table in parentheses; `rows` are the elements of its entries."""
        lines = ("".join(f"<mtd>{row(entry)}</mtd>" for entry in line) for line in rows)
        return self.brackets("<mtable>" + "".join(f"<mtr>{line}</mtr>" for line in lines) + "</mtable>")


def _one(piece: FormulaPiece) -> str:
    """Return a piece of a formula as one MathML element, which a fraction requires; a sum is several elements."""
    return row(piece.text) if piece.level == SUM else piece.text


def _kind(part: str) -> str:
    return "mn" if part.isdigit() else "mi"
