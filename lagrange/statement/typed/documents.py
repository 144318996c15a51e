"""Documents as answers: their formulas without the prose, and the section of the equations of motion."""

from __future__ import annotations

import re
from collections.abc import Iterator

_BODY = re.compile(r"\\begin\{document\}(.*?)\\end\{document\}", re.DOTALL)
_MARK = r"[ \t]*(?:\\(?:sub)*section\*?\{|#+|\*\*)"
_SECTION = re.compile(
    rf"^(?:{_MARK})?[ \t]*(?:equations?[ ]of[ ]motion|bewegungsgleichung(?:en)?)[ \t]*(?:\}}|\*\*|:)*[ \t]*$"
    rf"(.*?)(?=^{_MARK}|\n[ \t]*\n[^\s=\\$][^=\n\\$]*$|\Z)",
    re.DOTALL | re.IGNORECASE | re.MULTILINE,
)
"""A heading on a line of its own, and the text up to the next one: after a blank line, not indented, without = or $."""

_FORMULA = re.compile(
    r"\$\$.*?\$\$|\$[^$]*\$|\\\[.*?\\\]|\\\(.*?\\\)"
    r"|\\begin\{((?:equation|align|gather|multline|eqnarray|displaymath)\*?)\}.*?\\end\{\1\}",
    re.DOTALL,
)


def parts_of_document(text: str) -> Iterator[str]:
    """Yield versions of a document in which all but some formulas are blank: first all formulas, then its main section.

    Texts keep their length. The main section has the equations of motion. If no formulas are marked, the first version
    is left out.
    """
    body, section = _BODY.search(text), _SECTION.search(text)
    for match in (body, section):
        begin, end = match.span(1) if match else (0, len(text))
        spans = [formula.span() for formula in _FORMULA.finditer(text, begin, end) if "=" in formula.group()]
        if spans or match is section:
            yield _only(text, spans or [(begin, end)])


def _only(text: str, spans: list[tuple[int, int]]) -> str:
    """Return a text with blanks outside of `spans`, and a semicolon after each span; line breaks are kept."""
    blank = re.sub(r"[^\n]", " ", text)
    kept, place = [], 0
    for begin, end in spans:
        kept += [re.sub("^ ", ";", blank[place:begin]), text[begin:end]]
        place = end
    return "".join([*kept, blank[place:]])
