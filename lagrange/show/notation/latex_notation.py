"""Formulas in LaTeX, which need only the packages of the AMS."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import ClassVar

from lagrange.show.notation.symbols import letter_of, upright
from lagrange.show.notation.text import CIRCULAR, POWER, BookNotation, FormulaPiece

COMMANDS = CIRCULAR - frozenset(("sech", "csch"))
"""Functions with a LaTeX command of the same name, besides ln, min and max."""


class LatexNotation(BookNotation):
    """LaTeX, in math mode."""

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
        letter = letter_of(name, literal=name in self.literal)
        parts = [part for part in (letter.index, " ".join(map(self.letter, indices))) if part]
        head = f"\\{'d' * dots}ot{_argument(letter.head, alone=False)}" if dots else letter.head
        return head + (f"_{_argument(', '.join(parts))}" if parts else "")

    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        r"""Return a calligraphic letter such as \mathcal{L}, or for a small letter the word, upright; with indices.

        It replaces a letter that looks like a symbol of the user.
        """
        spelled = f"\\mathcal{{{letter}}}" if letter.isupper() else upright(word).replace("\\_", "\\ ")
        return spelled + (f"_{_argument(' '.join(map(self.letter, indices)))}" if indices else "")

    def number(self, digits: str, exponent: int | None = None) -> FormulaPiece:
        r"""Return a number, with a power of ten if `exponent` is given: 6.674 \cdot 10^{-11}."""
        if exponent is None:
            return FormulaPiece(digits, simple=True)
        return FormulaPiece(f"{digits} \\cdot 10^{{{exponent}}}", POWER)

    def brackets(self, inside: str) -> str:
        r"""Return a text in parentheses; they grow with a fraction inside: \left(inside\right)."""
        return f"\\left({inside}\\right)" if "\\frac" in inside or "\\begin" in inside else f"({inside})"

    def fraction(self, above: FormulaPiece, below: FormulaPiece) -> FormulaPiece:
        r"""Return a fraction: \frac{above}{below}."""
        return FormulaPiece(f"\\frac{{{above.text}}}{{{below.text}}}", POWER)

    def raised(self, base: str, exponent: str) -> FormulaPiece:
        """Return a power: base^{exponent}. Dots and indices of the base are kept."""
        return FormulaPiece(f"{base}^{_argument(exponent)}", POWER)

    def root(self, inside: FormulaPiece) -> FormulaPiece:
        r"""Return a square root: \sqrt{inside}."""
        return FormulaPiece(f"\\sqrt{{{inside.text}}}")

    def function_name(self, name: str) -> str:
        """Return the command of a function, or its name in upright letters; primes follow the name."""
        if name in CIRCULAR:
            return f"\\{name}" if name in COMMANDS else upright(name)
        return self.function_names.get(name) or self.letter(name.rstrip("'")) + "'" * name.count("'")

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix in parentheses."""
        return "\\begin{pmatrix} " + " \\\\ ".join(" & ".join(row) for row in rows) + " \\end{pmatrix}"


def _argument(text: str, *, alone: bool = True) -> str:
    """Return a text as the argument of a LaTeX command: in braces, except for a command or a single letter.

    With `alone` false a single letter has braces too, because it follows the name of a command.
    """
    return text if (alone and len(text) == 1) or re.fullmatch(r"\\[A-Za-z]+", text) else f"{{{text}}}"
