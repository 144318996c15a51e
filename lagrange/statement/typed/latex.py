"""LaTeX in typed answers: the meaning of each command, and the commands that divide or frame formulas."""

from __future__ import annotations

import re

from lagrange.statement.vocabulary.letters import GREEK

# LaTeX commands that are signs, and their plain signs
COMMAND_SIGNS = {
    **dict.fromkeys(("cdot", "times", "ast"), "*"),
    **dict.fromkeys(("lvert", "rvert", "vert", "mid"), "|"),
    **dict.fromkeys(("lbrace", "lparen"), "("),
    **dict.fromkeys(("rbrace", "rparen"), ")"),
    "div": "/",
    "prime": "'",
    "{": "(",
    "}": ")",
    "|": "|",
}
# LaTeX commands with a numerator and a denominator
FRACTIONS = ("frac", "dfrac", "tfrac", "cfrac", "sfrac", "nicefrac")
# LaTeX commands for derivatives with respect to time, and the order of the derivative
DERIVATIVES = {"dot": 1, "ddot": 2, "dddot": 3, "dv": 1, "odv": 1}
# LaTeX commands whose group is one word
WORD_GROUPS = (
    *("mathrm", "text", "textrm", "mathit", "operatorname", "mathsf"),
    *("mathbf", "boldsymbol", "rm", "mathop", "vec", "hat"),
)
# LaTeX commands that change only the appearance of a formula
SPACES = (
    *(f"{size}{side}" for size in ("big", "Big", "bigg", "Bigg") for side in ("", "l", "r")),
    *("quad", "qquad", "cancel", "bcancel", "displaystyle", "textstyle", "limits", "nonumber", "notag"),
    *("thinspace", "space", "hfill", "blacksquare", *",;:!>"),
)
# LaTeX commands that are letters, and their spelling in names; those that are functions, in the strict notation
WORDS = {name: name for name in (*GREEK.values(), "pi", "ell", "min", "max", "sqrt")}
WORDS |= {f"var{name}": name for name in ("phi", "theta", "epsilon", "rho", "sigma", "pi")}
WORDS |= {name: name for name in ("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh", "exp", "log", "ln")}
WORDS |= {"arcsin": "asin", "arccos": "acos", "arctan": "atan", "sgn": "sign"}
# A new line of LaTeX, or the end of one formula and the beginning of the next
LINE_BREAK = re.compile(r"\\\\(?:\[[^\]\n]*\])?|\$\s+\$|\\\]\s*\\\[|\\\)\s*\\\(")
# Marks around formulas: environments, labels, dollar signs, and an empty group before a sign
FRAME = re.compile(
    r"\\(?:begin|end)\*?\{[^{}\n]*\}(?:\{[^{}\n]*\})?|\\(?:label|tag|[hv]space|[hv]?phantom|color)\*?\{[^{}\n]*\}"
    r"|\\[\[\]()]|\\item\b|\$+"
    r"|(?<=[\s&])\{\s*\}|\\left\s*\\\{(?=\s*\\begin)|\\right\s*\.|\\(?:left|right)(?![A-Za-z])"
)
# The begin of a frame around an equation, up to its bracket
FRAMED = re.compile(r"\\(?:boxed|fbox|underline|textcolor\{[^{}\n]*\})[ \t]*\{|(?<![A-Za-z0-9_])Eq\(")
# A group of words outside of subscripts
PROSE = re.compile(r"(?<![_{])\\(?:text|mbox|textrm|textit|intertext)\s*\{([^{}\n]*)\}")
# A command that is an operator between two values
OPERATOR = rf"\\(?:{'|'.join(name for name, sign in COMMAND_SIGNS.items() if sign in '*/')})(?![A-Za-z])"
# A command between an equation and its consequence
ARROW = r"\\(?:Rightarrow|implies|Longrightarrow|rightarrow|therefore|iff|(?:L|l|Longl)eftrightarrow)(?![A-Za-z])"
# Marks of a matrix: its begin, a new column, a new row, and its end
MATRIX_MARKS = MATRIX, CELL, ROW, MATRIX_END = "⟦╎╱⟧"
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
    """Return the matched text of one matrix on one line, with single characters in place of its LaTeX commands."""
    group = 3 if match.group(2) is None else 2
    inside = _ROW_BREAK.sub(lambda row: ROW.ljust(len(row.group())), match.group(group)).rstrip(f"{ROW} \n")
    inside = inside.replace("&", CELL).replace("\n", " ").ljust(len(match.group(group)))
    before, after = match.start(group) - match.start(), match.end() - match.end(group)
    return MATRIX.ljust(before) + inside + MATRIX_END.rjust(after)
