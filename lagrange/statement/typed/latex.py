"""LaTeX in typed answers: the meaning of each command, and the commands that divide or frame formulas."""

from __future__ import annotations

import re

from lagrange.statement.vocabulary.letters import GREEK

COMMAND_SIGNS = {
    **dict.fromkeys(("cdot", "times", "ast"), "*"),
    **dict.fromkeys(("lvert", "rvert", "vert", "mid"), "|"),
    **dict.fromkeys(("lbrace", "lparen"), "("),
    **dict.fromkeys(("rbrace", "rparen"), ")"),
    "div": "/",
    "prime": "'",
}
"""LaTeX commands that are signs, and their plain signs."""

FRACTIONS = ("frac", "dfrac", "tfrac", "cfrac", "sfrac", "nicefrac")
"""LaTeX commands with a numerator and a denominator."""

DERIVATIVES = {"dot": 1, "ddot": 2, "dv": 1, "odv": 1}
"""LaTeX commands for derivatives with respect to time, and the order of the derivative."""

WORD_GROUPS = ("mathrm", "text", "textrm", "mathit", "operatorname", "mathsf", "mathbf", "boldsymbol", "rm", "mathop")
"""LaTeX commands whose group is one word."""

SPACES = (
    *(f"{size}{side}" for size in ("big", "Big", "bigg", "Bigg") for side in ("", "l", "r")),
    *("quad", "qquad", "left", "right", "displaystyle", "textstyle", "limits", "nonumber", "notag"),
    *("thinspace", "space", "hfill", "blacksquare"),
)
"""LaTeX commands that change only the appearance of a formula."""

LETTER_COMMANDS = {name: name for name in (*GREEK.values(), "pi", "ell")}
LETTER_COMMANDS |= {f"var{name}": name for name in ("phi", "theta", "epsilon", "rho", "sigma", "pi")}
"""LaTeX commands that are letters, and their spelling in names."""

FUNCTION_COMMANDS = {
    **{name: name for name in ("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh", "exp", "log", "ln")},
    **{f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan")},
    **{name: name for name in ("min", "max", "sqrt")},
    "sgn": "sign",
}
"""LaTeX commands that are functions, and the name of each in the strict notation."""

LINE_BREAK = re.compile(r"\\\\(?:\[[^\]\n]*\])?|\$\s+\$|\\\]\s*\\\[|\\\)\s*\\\(")
"""A new line of LaTeX, or the end of one formula and the beginning of the next."""

FRAME = re.compile(
    r"\\(?:begin|end|label|tag|[hv]space|[hv]?phantom|color)\*?\{[^{}\n]*\}(?:\{[^{}\n]*\})?|\\[\[\]()]|\\item\b|\$+"
    r"|(?<=[\s&])\{\s*\}|\\left\s*\\\{(?=\s*\\begin)|\\right\s*\."
)
"""Marks around formulas: environments, labels, dollar signs, and an empty group before a sign."""

FRAMED = re.compile(r"\\(?:boxed|fbox|underline|textcolor\{[^{}\n]*\})[ \t]*\{|(?<![A-Za-z0-9_])Eq\(")
"""The begin of a frame around an equation, up to its bracket."""

PROSE = re.compile(r"(?<![_{])\\(?:text|mbox|textrm|textit|intertext)\s*\{([^{}\n]*)\}")
"""A group of words outside of subscripts."""

OPERATOR = rf"\\(?:{'|'.join(name for name, sign in COMMAND_SIGNS.items() if sign in '*/')})(?![A-Za-z])"
"""A command that is an operator between two values."""

ARROW = r"\\(?:Rightarrow|implies|Longrightarrow|rightarrow|therefore|iff)(?![A-Za-z])"
"""A command between an equation and its consequence."""

MATRIX_MARKS = MATRIX, CELL, ROW, MATRIX_END = "⟦╎╱⟧"
"""Marks of a matrix: its begin, a new column, a new row, and its end."""

_MATRIX = re.compile(
    r"\\begin\{([pbB]?(?:small)?matrix)\}(.*?)\\end\{\1\}"
    r"|\\left\s*[(\[]\s*\\begin\{array\}(?:\{[^{}]*\})?(.*?)\\end\{array\}\s*\\right\s*[)\]]",
    re.DOTALL,
)
_ROW_BREAK = re.compile(r"\\\\(?:\[[^\]\n]*\])?")


def with_marks(text: str) -> str:
    """Return a text of the same length in which single characters replace the commands of LaTeX matrices."""
    return _MATRIX.sub(_marked, text)


def _marked(match: re.Match[str]) -> str:
    """Return the text of one matrix, on one line and with single characters for its commands."""
    place = 3 if match.group(2) is None else 2
    inside = _ROW_BREAK.sub(lambda found: ROW.ljust(len(found.group())), match.group(place)).rstrip(f"{ROW} \n")
    inside = inside.replace("&", CELL).replace("\n", " ").ljust(len(match.group(place)))
    before, after = match.start(place) - match.start(), match.end() - match.end(place)
    return MATRIX.ljust(before) + inside + MATRIX_END.rjust(after)
