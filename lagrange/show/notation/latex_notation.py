"""Formulas in LaTeX, which need only the packages of the AMS."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import ClassVar

from lagrange.show.notation.symbols import letter_of, upright
from lagrange.show.notation.text import ATOM, CIRCULAR, POWER, FormulaPiece, Notation

COMMANDS = CIRCULAR - frozenset(("sech", "csch"))
"""Functions with a LaTeX command of the same name, besides ln, min and max."""


class LatexNotation(Notation):
    """LaTeX, in math mode."""

    opening, closing = r"\bigl(", r"\bigr)"
    times, before_sign = r"{} \times ", "{} "
    in_one_line, fractions_in_front, product_sign = False, True, " "
    constants: ClassVar = {"pi": r"\pi", "infinity": r"\infty"}
    relations: ClassVar = {"<=": r"\le", ">=": r"\ge", "!=": r"\ne"}

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

    def function(self, name: str, arguments: Sequence[FormulaPiece], exponent: str = "") -> FormulaPiece:
        r"""Return a function, raised to an exponent if given: \sin^{2} \theta, \cos\left(a - b\right), or e^{-t}."""
        inside = ", ".join(argument.text for argument in arguments)
        if name == "abs":
            return self.power_of(f"\\left|{inside}\\right|", exponent)
        if name == "exp":
            return self.raised(f"\\exp{self.brackets(inside)}", exponent) if exponent else self.raised("e", inside)
        if name in CIRCULAR and len(arguments) == 1:
            head = (f"\\{name}" if name in COMMANDS else upright(name)) + (
                f"^{_argument(exponent)}" if exponent else ""
            )
            closed = head + self.brackets(inside)
            if arguments[0].simple:
                return FormulaPiece(f"{head} {inside}", closed=closed, call=True)
            return FormulaPiece(closed, call=True)
        shown = {"log": r"\ln", "min": r"\min", "max": r"\max"}.get(name)
        shown = shown or self.letter(name.rstrip("'")) + "'" * name.count("'")
        return self.power_of(shown + self.brackets(inside), exponent)

    def cases(self, rows: Sequence[tuple[str, str]]) -> FormulaPiece:
        """Return pairs of value and condition as a cases environment; the last condition may be empty."""
        lines = [f"{value} & {condition or chr(92) + 'text{otherwise}'}" for value, condition in rows]
        return FormulaPiece("\\begin{cases} " + " \\\\ ".join(lines) + " \\end{cases}", ATOM)

    def text(self, words: str) -> str:
        """Return words inside a formula, upright."""
        return f"\\text{{{words}}}"

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix in parentheses."""
        return "\\begin{pmatrix} " + " \\\\ ".join(" & ".join(row) for row in rows) + " \\end{pmatrix}"

    def transposed(self, matrix: str) -> str:
        """Return the transpose of a matrix that is named by a letter, such as G^T."""
        return f"{matrix}^T"

    def partial(self, above: str, below: str) -> str:
        r"""Return a partial derivative: \frac{\partial L}{\partial \dot{\theta}}."""
        return f"\\frac{{\\partial {above}}}{{\\partial {below}}}"

    def rate(self, inside: str) -> str:
        r"""Return the time derivative of `inside`: \frac{d}{dt} \frac{\partial L}{\partial \dot{\theta}}."""
        return f"\\frac{{d}}{{dt}} {inside}"


def _argument(text: str, *, alone: bool = True) -> str:
    """Return a text as the argument of a LaTeX command: in braces, except for a command or a single letter.

    With `alone` false a single letter has braces too, because it follows the name of a command.
    """
    return text if (alone and len(text) == 1) or re.fullmatch(r"\\[A-Za-z]+", text) else f"{{{text}}}"
