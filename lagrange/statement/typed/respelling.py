r"""Respell typed text before it is divided into tokens: matrices, \over and \overset of LaTeX, Markdown, words for "=".

Fractions such as \dfrac, Greek letters and other LaTeX commands are in `tokens`. Text around formulas becomes blanks.
The text keeps its length, so that offsets refer to the typed text.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from functools import partial

MATRIX_MARKS = MATRIX, CELL, ROW, MATRIX_END = "⟦╎╱⟧"  # Beginning of a matrix, new column, new row, end of the matrix
AND, OR, NOT = "∧∨¬"
CONSEQUENCE = "⇒"  # Mark between an equation and its consequence
# Plain letters and brackets in place of those of formula editors, and a blank for the mark at the start of some files
PLAIN_LETTERS = {code: unicodedata.normalize("NFKC", chr(code)) for code in range(0x1D400, 0x1D800)}
PLAIN_LETTERS |= {0x210E: "h", 0xFEFF: " ", ord("〖"): "(", ord("〗"): ")"}
_ROW_BREAK = re.compile(r"\\\\(?:\[[^\]\n]*\])?")
_OVER = r"\\over(?![A-Za-z])"
_IN_BRACES = r"(?:[^{}]|\{[^{}]*\})"  # Matches a character of a group in braces, or a group inside it
_ELSE = r"(?:otherwise|elsewhere|else|sonst)"
_UNEQUAL = r"(?:[<>]=?|[^=<>])*?"  # Any text without a sign of equality
_INNER = "[^()]*+"  # A text with brackets, at most four levels deep
for _ in range(4):
    _INNER = rf"[^()]*+(?:\({_INNER}\)[^()]*+)*+"
_ABOVE_TIME = r"(?:(?!\\partial)[^=+\n]){0,24}\}\s*\{\s*\\partial\s*t(?![A-Za-z])"  # Matches the end of a quotient d/dt


def _marked(match: re.Match[str]) -> str:
    """Return the text of a LaTeX matrix on one line, in which single characters replace the commands."""
    group = 3 if match.group(2) is None else 2
    inside = _ROW_BREAK.sub(lambda row: ROW.ljust(len(row.group())), match.group(group)).rstrip(f"{ROW} \n")
    inside = inside.replace("&", CELL).replace("\n", " ").ljust(len(match.group(group)))
    before, after = match.start(group) - match.start(), match.end() - match.end(group)
    return MATRIX.ljust(before) + inside + MATRIX_END.rjust(after)


def _cases(match: re.Match[str]) -> str:
    """Return LaTeX rows of values and conditions as Piecewise((value, condition), ...)."""
    rows = match.group(1)
    for pattern, mark in (
        (rf"\\(?:text|mbox|mathrm|textrm)\s*\{{\s*{_ELSE}[\s.]*\}}|\b{_ELSE}\b", "True"),
        (r"[,;]?\s*&(?:\s*\\text\s*\{\s*(?:if|for|falls|wenn|when)\s*\})?", ","),  # The beginning of a condition
        (r"[,;.\s]*(?:\\\\\s*)?$", ""),
        (r"[,;.\s]*\\\\(?:\[[^\]\n]*\]|\s|(?![A-Za-z]))", ROW),
    ):
        rows = re.sub(pattern, partial(_written, spelling=mark), rows)
    begin, end = match.start(1) - match.start(), match.end() - match.end(1)
    return "Piecewise((".ljust(begin) + rows.replace("\n", " ") + "))".rjust(end)


def _conditions(match: re.Match[str]) -> str:
    """Return the matched Piecewise(...) with the signs AND, OR and NOT in place of words and of signs of programs."""
    text = match.group()
    for pattern, sign in (
        (r"\b(?:[Aa]nd|und)\b|&&?", AND),
        (r"\b(?:[Oo]r|oder)\b|\|\||(?<=\))\s*\|(?=\s*\()", OR),
        (r"\b(?:[Nn]ot|nicht)\b", NOT),
        ("<=", "≤"),  # A bracket with a sign of equality would be taken for a remark
        (">=", "≥"),
    ):
        text = re.sub(pattern, partial(_written, spelling=sign), text)
    return text


_RESPELLED: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    # A row of a Markdown table: a label and an equation
    (r"^([ \t]*)\|([^|=\n]*:[ \t]*)\|([^|\n]*)\|([ \t]*)$", r"\1 \2 \3 \4"),
    # Comments after # or %, the rule of a table, a fence ``` and a heading in bold type
    (r"(?<!\\)[#%][^\n]*|\|\s*:[^\n]*|^\s*```[^\n]*|^\s*\*\*[^*=\n]+\*\*:?\s*$", ""),
    # Code of Markdown: `x'' = 0`
    (r"(?<![\w)\]}'`])`([^`\n]+)`(?!`)", r" \1 "),
    # A matrix of LaTeX
    (
        r"\\begin\{([pbB]?(?:small)?matrix)\}(.*?)\\end\{\1\}"
        r"|\\left\s*[(\[]\s*\\begin\{array\}(?:\{[^{}]*\})?(.*?)\\end\{array\}\s*\\right\s*[)\]]",
        _marked,
    ),
    # Values with conditions. Equations in this frame, with a sign =, stay lines.
    (rf"\\begin\{{cases\}}({_UNEQUAL}&{_UNEQUAL})\\end\{{cases\}}", _cases),
    # A new line of LaTeX, or the end of one formula and the begin of the next
    (r"\\\\(?:\[[^\]\n]*\])?|\$\s+\$|\\\]\s*\\\[|\\\)\s*\\\(", "\n"),
    # A fraction of TeX: {g \over l}
    (rf"(?<!\\)\{{((?:(?!{_OVER}){_IN_BRACES})*+){_OVER}({_IN_BRACES}*+)\}}", r"((\1)/(\2))"),
    # Words in a group of LaTeX: \text{and}
    (r"(?<![_{])\\(?:text|mbox|textrm|textit|intertext)\s*\{([^{}\n]*)\}", r" \1"),
    # Words and signs of programs between conditions
    (rf"\bPiecewise\s*\({_INNER}\)", _conditions),
    # An equation in bold type: **x'' = 0**
    (r"^([ \t>-]*(?:[^=*\n]*:[ \t]*)?)\*\*(?=\S)([^\n]*[^\s*])\*\*(?=[ \t.,;]*$)", r"\1  \2"),
    # The mark > of a quoted mail
    (r"^[ \t]*>+(?=[ \t])", ""),
    # The name of a Python module before a function: np.sin
    (r"\b(?:np|numpy|math|sp|sympy)\.(?=[a-z])", ""),
    # Dots of a derivative after a blank, as Word exports them
    (r"(?<![ \t\u00a0])([ \t\u00a0]+)([\u0307\u0308]+)", r"\2\1"),
    # The square of a derivative: (d/dt)^2
    (r"\(\s*d\s*/\s*d\s*t\s*\)\s*(?:²|(?:\^|\*\*)\s*2)", "d²/dt²"),
    # Partial derivatives by the time, which are read as ordinary ones
    (r"∂(?=\s*t(?![A-Za-z])|[^∂=+\n]{0,12}/\s*\(?\s*∂\s*t(?![A-Za-z]))", "d"),
    (rf"\\partial(?=\s*t(?![A-Za-z])|{_ABOVE_TIME})", "d"),
    # Words for a constant, and for equality
    (
        r"\b(?:is|ist)\s+(?:a\s+)?(?:constant|conserved|const\b\.?|konstant|erhalten)|\((?:constant|conserved)\)",
        "= const",
    ),
    (r"\b(?:is\s+equal\s+to|equals|ist\s+gleich)\b", "="),
    (
        r"\b((?:where|with|here|wobei)\s+[^\W\d]\w*(?:\^2)?\s+)(?:is|ist)\s+(?=[\\(√]|sqrt|\w+\s*[/*^])",
        r"\1= ",
    ),
    # The left side of an equation in words
    (r"\b(?:[Tt]he\s)?[Aa]ngular\sacceleration(?=\s*=)", "angular_acceleration"),
    # The word "where" at the end of a line
    (r"(=[^\n]*\s)(?:where|with|wobei|mit)(?=[\s:]*$)", r"\1"),
    # A bar between two equations
    (r"^([^|\n]*=[^|\n]*\s)\|(?=\s[^|\n]*=[^|\n]*$)", r"\1;"),
    # Signs for a definition or an identity
    (r":=|=:|≔|≡|\\(?:equiv|coloneqq)(?![A-Za-z])|\\(?:stackrel|overset)\s*\{[^{}\n]*\}\s*\{\s*=\s*\}", "="),
    # A space of LaTeX at the end of a line
    (r"(?:[,;.]|(?<![ \t]))[ \t]*\\q?quad[ \t]*$", ""),
    # Abbreviations before a consequence: i.e.
    (r"\b(?:i\.\s?e|d\.\s?h|viz)\.,?", ";"),
    # A comma between two equations that is not a decimal comma: x'' = 1,2 y'' = 3
    (r"(=[^,;=\n]*[0-9]),(?=[0-9][^,;=\n]*=)", r"\1;"),
    # Arrows between an equation and its consequence
    (
        r"=>|->|//(?=[^\n]*=)|[→⟹⟶∴⇔↔⟺⟷]"
        r"|\\(?:Rightarrow|implies|Longrightarrow|rightarrow|therefore|iff|(?:L|l|Longl)eftrightarrow)(?![A-Za-z])",
        CONSEQUENCE,
    ),
)
"""Pairs of a pattern and its replacement, applied in this order.

A replacement is a template with groups of the match, or a function of the match. Blanks fill up the rest of the length.
An empty template leaves only blanks.
"""

_PATTERNS = [(re.compile(pattern, re.MULTILINE | re.DOTALL), spelling) for pattern, spelling in _RESPELLED]


def respelled(text: str) -> str:
    """Return a text of the same length in which the spellings in `_RESPELLED` are replaced."""
    for pattern, spelling in _PATTERNS:
        text = pattern.sub(partial(_written, spelling=spelling), text)
    return text


def _written(match: re.Match[str], spelling: str | Callable[[re.Match[str]], str]) -> str:
    """Return the replacement of a match: the spelling, and blanks up to the length of the match."""
    text = spelling(match) if callable(spelling) else match.expand(spelling)
    return text + blanks(match.group()[len(text) :])


def blanks(text: str) -> str:
    """Return blanks of the same length as a text. Line breaks stay."""
    return re.sub(r"[^\n]", " ", text)
