"""Readers of printed formulas, in every notation: what a page shows is read back and compared by number."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from fractions import Fraction
from typing import Any
from unicodedata import normalize

import sympy

from lagrange.show.notation.formula import Typesetter

FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(sympy, name)
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
} | {"exp": sympy.exp, "log": sympy.log, "ln": sympy.log, "sqrt": sympy.sqrt, "abs": sympy.Abs, "sign": sympy.sign}
FUNCTIONS |= {"min": sympy.Min, "max": sympy.Max}
VULGAR = {mark: Fraction(int(a), int(b)) for mark in "½⅓⅔¼¾⅕⅙⅚⅛⅜⅝⅞" for a, b in [normalize("NFKD", mark).split("⁄")]}
TOKEN = re.compile(r"\s*(§\d+§|\d+\.?\d*(?:e-?\d+)?|[^\W\d]\w*|\*\*|[-+*/(),|^√])")


class Reader:
    """Reads formulas of one typesetter: products stand side by side or with stars, quotients with strokes."""

    def __init__(self, setter: Typesetter) -> None:
        self.symbols = list(setter.letters)
        ordered = sorted(enumerate(setter.letters.values()), key=lambda pair: -len(pair[1]))
        self.letters = [(text, f"§{place}§") for place, text in ordered]
        self.tokens: list[str] = []

    def marked(self, text: str) -> str:
        """Return the text with every symbol of the statement as a mark."""
        for letter, mark in self.letters:
            text = re.sub(rf"(?<![§\w\\]){re.escape(letter)}(?![§\w\u0300-\u036f])", f" {mark} ", text)
        return text

    def parse(self, text: str) -> Any:
        """Return the expression of a text in which symbols are marks."""
        self.tokens, place = [], 0
        text = text.strip()
        while place < len(text):
            found = TOKEN.match(text, place)
            assert found, (text, text[place:])
            self.tokens.append(found.group(1))
            place = found.end()
        value = self.sum()
        assert not self.tokens, (text, self.tokens)
        return value

    def take(self, *tokens: str) -> str:
        if self.tokens and self.tokens[0] in tokens:
            return self.tokens.pop(0)
        return ""

    def sum(self) -> Any:
        total = -self.product() if self.take("-") else self.product()
        while sign := self.take("+", "-"):
            total = total + self.product() if sign == "+" else total - self.product()
        return total

    def product(self) -> Any:
        value = self.power()
        while self.tokens and self.tokens[0] not in ("+", "-", ")", ",", "|end"):
            if self.take("/"):
                value = value / self.power()
            else:
                self.take("*")
                value = value * self.power()
        return value

    def power(self) -> Any:
        if self.take("-"):
            return -self.power()
        base = self.atom()
        return base ** self.power() if self.take("**", "^") else base

    def atom(self) -> Any:
        token = self.tokens.pop(0)
        if token == "(":
            value = self.sum()
            assert self.take(")")
            return value
        if token == "√":
            return sympy.sqrt(self.atom())
        if token.startswith("§"):
            return self.symbols[int(token.strip("§"))]
        if token[0].isdigit():
            return sympy.Float(token) if {".", "e"} & set(token) else sympy.Integer(token)
        if token in ("pi", "π"):
            return sympy.pi
        return self.call(FUNCTIONS[token])

    def call(self, function: Any) -> Any:
        exponent = self.atom() if self.take("^") else None
        if self.take("("):
            arguments = [self.sum()]
            while self.take(","):
                arguments.append(self.sum())
            assert self.take(")")
        else:
            arguments = [self.atom() * self.atom() if self.tokens[0][0].isdigit() else self.atom()]
        value = function(*arguments)
        return value if exponent is None else value**exponent


def ascii_text(setter: Typesetter, text: str) -> Any:
    """Return the expression of plain text."""
    reader = Reader(setter)
    return reader.parse(reader.marked(text))


def unicode_text(setter: Typesetter, text: str) -> Any:
    """Return the expression of a line in Unicode."""
    reader = Reader(setter)
    text = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: f"^({normalize('NFKC', found.group())})", text)
    text = text.replace("\N{MINUS SIGN}", "-").replace("·10^", "*10^")
    text = re.sub("[½⅓⅔¼¾⅕⅙⅚⅛⅜⅝⅞]", lambda found: f"({VULGAR[found.group()]})", text)
    return reader.parse(_bars(reader.marked(text).replace("e^(", "exp(").replace("√", " sqrt ")))


def latex_text(setter: Typesetter, text: str) -> Any:
    """Return the expression of LaTeX."""
    reader = Reader(setter)
    for letter, mark in reader.letters:
        text = re.sub(rf"(?<![A-Za-z\\]){re.escape(letter)}(?![A-Za-z])", f" {mark} ", text)
    text = (
        re.sub(r"\\(left|right|bigl|bigr)", "", text)
        .replace("{}", "")
        .replace("\\cdot", "*")
        .replace("\\times", "*")
        .replace("e^", r"\exp^")
    )
    before = ""
    while before != text:
        before = text
        text = re.sub(r"\\frac\{([^{}]*)\}\{([^{}]*)\}", r"((\1)/(\2))", text)
        text = re.sub(r"\\sqrt\{([^{}]*)\}", r"sqrt(\1)", text)
        text = re.sub(r"\^\{([^{}]*)\}", r"^(\1)", text)
        text = re.sub(r"\\mathrm\{([^{}]*)\}", r"\1", text)
    text = re.sub(r"\^(\d)(\d)", r"^\1 \2", text)
    return reader.parse(_bars(text.replace(r"\exp^", "exp").replace("\\", " ")))


def mathml_text(setter: Typesetter, text: str) -> Any:
    """Return the expression of MathML."""
    reader = Reader(setter)
    for letter, mark in reader.letters:
        text = text.replace(letter, f"<s>{mark}</s>")
    return reader.parse(_bars(_plain(ElementTree.fromstring(f"<mrow>{text}</mrow>"))))


def _plain(node: ElementTree.Element) -> str:
    parts = [_plain(child) for child in node]
    match node.tag:
        case "mfrac":
            return f"(({parts[0]})/({parts[1]}))"
        case "msup":
            return f"exp({parts[1]})" if parts[0].strip() == "e" else f"{parts[0]}^({parts[1]})"
        case "msqrt":
            return f"sqrt({''.join(parts)})"
        case "mrow":
            return "".join(parts)
        case "mspace":
            return " "
    signs = {"\N{MINUS SIGN}": "-", "·": "*", "×": "*", "\N{FUNCTION APPLICATION}": " "}
    return f" {signs.get(node.text or '', node.text)} "


def _bars(text: str) -> str:
    """Return the text with |x| as abs(x); bars inside one another do not occur in what is read."""
    return re.sub(r"\|([^|]*)\|", r" abs(\1) ", text)
