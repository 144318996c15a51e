"""Find the equations in a typed text: blank out all other text, join continued lines, and divide lines into equations.

The text keeps its length, so that offsets refer to the typed text. If a document cannot be read as a whole, only its
formulas are read, or only the section with the equations of motion.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from lagrange.errors import StatementError
from lagrange.statement.typed.respelling import MATRIX, MATRIX_END, blanks, respelled
from lagrange.statement.typed.tokens import OPERATOR

# Matches marks around formulas: environments, labels, dollar signs, and an empty group before a sign
_FRAME = re.compile(
    r"\\(?:begin|end)\*?\{[^{}\n]*\}(?:\{[^{}\n]*\})?|\\(?:label|tag|[hv]space|[hv]?phantom|color)\*?\{[^{}\n]*\}"
    r"|\\[\[\]()]|\\item\b|\$+"
    r"|(?<=[\s&])\{\s*\}|\\left\s*\\\{(?=\s*\\begin)|\\right\s*\.|\\(?:left|right)(?![A-Za-z])"
)
# Matches the beginning of a frame around an equation, up to its bracket
_FRAMED = re.compile(r"\\(?:boxed|fbox|underline|textcolor\{[^{}\n]*\})[ \t]*\{|(?<![A-Za-z0-9_])Eq\(")
_LABEL = re.compile(
    r"\s*(?:\(\s*[0-9]{1,2}[a-z]?\s*\)|\(\s*(?:[ivx]{1,4}|[a-h])\s*\)(?=\s)|[0-9]{1,2}\.?\s*\)|[0-9]{1,2}\.(?=\s)"
    r"|(?:i{1,3}|i?v|vi{1,3}|[a-h])\)(?=\s)|•(?=\s))"
)
_BULLET = re.compile(r"\s*[-*](?=\s+[-(A-Za-z\\])")
_COORDINATE = re.compile(r"\s*\(\s*([^\W\d_]\w*)\s*\)(?=\s+[^\s=+*/^-])")
_HEADING = re.compile(r"[^=\n]*:")
_TRAILING_LABEL = re.compile(
    r"(?:(?<=\s)\(\s?(?:[0-9]{1,2}[a-z]?|i{1,3}|iv|\*{1,3})\s?\)|\.{2,}\s*\(?[0-9a-zA-Z*]{1,4}\))$"
)
_END = " \t\r\f\v\u00a0;,.!?✓✔☑∎□■"
_GOES_ON = re.compile(rf"(?:[-+*/=({{\[,\u2212·⋅×]|{OPERATOR})[&\s]*$")
_CONTINUES = re.compile(rf"[\s&]*(?:[+*/=^\u2212·⋅×)\]}}-]|{OPERATOR}|\\(?:right|quad|qquad)\b)")
_CHAINED = re.compile(r"[\s&]*={1,2}(?!=)")  # Matches the second line of a = b, which continues on it with = c
_MATRIX = re.compile(r"\\begin\{[pbBvV]?(?:small)?matrix\}|\bMatrix\(")
_EQUALITY = re.compile(r"(?<![<>=!:])={1,2}(?!=)")
# The space \, is part of an equation. The space \; divides two equations if no other mark does.
_SEPARATOR = re.compile(
    r"(?<!\\)[;&\v]|\.(?=\s)|(?<![0-9\\]),|(?<!\\),(?![0-9])|\band\b|\bund\b|\\q?quad\b"
    r"|\\;(?=(?:(?!\\q?quad)[^=,;])*=)"
)
OPEN, CLOSE = f"([{{{MATRIX}", f")]}}{MATRIX_END}"


def equation_spans(text: str, is_coordinate: Callable[[str], bool]) -> tuple[str, list[tuple[int, int]]]:
    """Return a text of the same length with blanks for all but formulas, and the spans (begin, end) of its equations.

    `is_coordinate` returns True for the name of a coordinate, which may be a label, as in (r) m*r'' = 0.

    Comments, labels, LaTeX environments and punctuation at the ends of lines are blanked out. A line continues if it
    ends with an operator, if the next line begins with one, or if a bracket is open. A line that begins with an
    operator continues the equation before it, unless both contain "=". After an equation with "=", three such lines
    begin a new equation: at the start of an environment, after a label, and at the indentation of an equation whose
    further lines are indented more. Raises StatementError for a matrix in a notation that is not supported.
    """
    framed = _unframed(respelled(text))
    if _MATRIX.search(framed):
        raise StatementError(
            r"an answer has a matrix in an unknown notation: write \begin{pmatrix}, or one equation a line."
        )
    spans: list[tuple[int, int]] = []
    offset = 0
    lines: list[str] = []
    plain = _FRAME.sub(lambda match: blanks(match.group()), framed)
    unlabelled = _without_labels(plain.split("\n"), is_coordinate)
    for line, frame in zip(unlabelled, framed.split("\n"), strict=True):
        before = "" if not spans else "\n".join(lines)[spans[-1][0] : spans[-1][1]]
        lines.append(line if depth_of(before) > 0 else _without_label(line))
        begin, end = offset, offset + len(line)
        offset = end + 1
        if not lines[-1].strip():
            continue
        labelled = len(line) - len(line.lstrip()) < len(lines[-1]) - len(lines[-1].lstrip())
        if spans and _continues(before, lines[-1], anew=labelled or frame.lstrip().startswith(r"\begin")):
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return "\n".join(lines), spans


def _unframed(text: str) -> str:
    r"""Return a text with blanks for \boxed{...} around an equation and for brackets around all equations.

    Eq(a, b) becomes a = b. In a list of expressions that are zero, [a, b], a vertical tab replaces each comma.
    """
    frames = {match.end() - 1: match.start() for match in _FRAMED.finditer(text)}
    first, last = len(text) - len(text.lstrip()), len(text.rstrip()) - 1
    frames |= {first: first} if text[first : first + 1] in ("{", "[") else {}
    marks, opened, commas = list(text), list[int](), list[int]()
    for i, mark in enumerate(text if frames else ""):
        if mark in OPEN:
            opened.append(i)
        elif mark == "," and opened and text.startswith("Eq", frames.get(opened[-1], i)):
            marks[i] = "="
        elif mark == "," and opened == [first] and not text[i - 1 : i + 2 : 2].isdigit():
            commas.append(i)
        elif mark in CLOSE and opened:
            begin = opened.pop()
            start = frames.get(begin, i)
            listed = start == first and i == last
            if start < begin or (listed and (commas or "=" in marks)):
                marks[start : begin + 1], marks[i] = blanks(text[start : begin + 1]), " "
            for comma in commas if listed and "=" not in marks else ():
                marks[comma] = "\v"
    return "".join(marks)


def _without_labels(lines: Sequence[str], is_coordinate: Callable[[str], bool]) -> list[str]:
    """Return lines with blanks for bullets, - or *, if every equation has one, and for coordinates such as (r).

    If only some lines begin with bullets, these are operators. A minus sign on the only line is an operator too. A
    single coordinate in brackets may be a factor, so it stays.
    """
    stated = [line for line in lines if line.strip() and not line.rstrip().endswith(":")]
    certain = len(stated) > 1 or (stated and stated[0].lstrip().startswith("*"))
    listed = certain and all(_BULLET.match(line) and _EQUALITY.search(line) for line in stated)
    lines = [_BULLET.sub(lambda match: blanks(match.group()), line, count=1) if listed else line for line in lines]
    matches = ((line, _COORDINATE.match(line)) for line in lines)
    labels = [(line, label if label and is_coordinate(label.group(1)) else None) for line, label in matches]
    several = len({label.group(1) for _, label in labels if label}) > 1
    return [" " * label.end() + line[label.end() :] if label and several else line for line, label in labels]


def _continues(before: str, line: str, *, anew: bool) -> bool:
    """Return True if `line` continues the equation `before` it.

    `anew` is true if a label or the begin of a LaTeX environment precedes the line. Then a line after an equation with
    a sign = only continues it if the equation is incomplete, or if the line begins with =.
    """
    if _GOES_ON.search(before) or depth_of(before) > 0 or _CHAINED.match(line):
        return True
    if not _CONTINUES.match(line):
        return False
    first, *more = (len(part) - len(part.lstrip()) for part in before.split("\n"))
    back = len(line) - len(line.lstrip()) <= first < min(more, default=first)
    return not (_EQUALITY.search(before) and (anew or back or _EQUALITY.search(line)))


def depth_of(text: str) -> int:
    """Return the number of opening brackets minus the number of closing brackets."""
    return sum((mark in OPEN) - (mark in CLOSE) for mark in text)


def _without_label(line: str) -> str:
    """Return a line with blanks for its label, such as (1), 2. or "eq1:", and for punctuation at its end."""
    for pattern in (_HEADING, _LABEL):
        match = pattern.match(line)
        rest = line[match.end() :] if match else ""
        if match and (rest.strip() or pattern is _HEADING):
            line = " " * match.end() + rest
    stripped = line.rstrip(_END)
    label = _TRAILING_LABEL.search(line.rstrip())
    if label and line[: label.start()].strip():
        stripped = line[: label.start()].rstrip(_END)
    return stripped.ljust(len(line)) if stripped else line


def separated(text: str, begin: int, end: int) -> list[tuple[int, int]]:
    """Return the spans (begin, end) of the equations in text[begin:end], which are separated by ; or ,.

    A decimal comma does not separate equations.
    """
    spans, start = [], begin
    for match in _SEPARATOR.finditer(text, begin, end):
        left, right = text[start : match.start()], text[match.end() : end]
        equations = _EQUALITY.search(left) and _EQUALITY.search(right) and not _CHAINED.match(right)
        if match.group() == "\v" or (equations and depth_of(left) == 0):
            spans.append((start, match.start()))
            start = match.end()
    return [*spans, (start, end)]


_BODY = re.compile(r"\\begin\{document\}(.*?)\\end\{document\}", re.DOTALL)
_MARK = r"[ \t]*(?:\\(?:sub)*section\*?\{|#+|\*\*)"
# Matches a heading line and the text up to the next heading, a line after a blank line, not indented, without = and $
_SECTION = re.compile(
    rf"^(?:{_MARK})?[ \t]*(?:equations?[ ]of[ ]motion|bewegungsgleichung(?:en)?)[ \t]*(?:\}}|\*\*|:)*[ \t]*$"
    rf"(.*?)(?=^{_MARK}|\n[ \t]*\n[^\s=\\$][^=\n\\$]*$|\Z)",
    re.DOTALL | re.IGNORECASE | re.MULTILINE,
)
_FORMULA = re.compile(
    r"\$\$.*?\$\$|\$[^$]*\$|\\\[.*?\\\]|\\\(.*?\\\)"
    r"|\\begin\{((?:equation|align|gather|multline|eqnarray|displaymath)\*?)\}.*?\\end\{\1\}",
    re.DOTALL,
)


def parts_of_document(text: str) -> Iterator[str]:
    """Yield versions of a document in which blanks replace all but some formulas. Texts keep their length.

    The first version keeps all marked formulas, and is left out if there are none. The second version keeps the section
    with the equations of motion.
    """
    body, section = _BODY.search(text), _SECTION.search(text)
    for match in (body, section):
        begin, end = match.span(1) if match else (0, len(text))
        spans = [formula.span() for formula in _FORMULA.finditer(text, begin, end) if "=" in formula.group()]
        if not (spans or match is section):
            continue
        kept, offset, blank = list[str](), 0, blanks(text)
        for first, last in spans or [(begin, end)]:
            kept += [re.sub("^ ", ";", blank[offset:first]), text[first:last]]
            offset = last
        yield "".join([*kept, blank[offset:]])
