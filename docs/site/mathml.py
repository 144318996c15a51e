"""A Sphinx extension that converts formulas to MathML when a page is built, so that a page needs no script or font.

All current browsers display MathML. MathJax would add a megabyte of script and fonts, or a request to another host.
Pictures of formulas do not follow the size and the colour of the text.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

from docutils import nodes
from latex2mathml.commands import MATRICES
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

TAG = re.compile(r"\\tag\{([^}]*)\}")
UNKNOWN = re.compile(r">([^<]*(?:\\|&(?!#?\w+;))[^<]*)<")
"""A command that the converter does not know stays in its output, backslash and all; so does an ampersand."""

ENVIRONMENT = re.compile(r"\\begin\{([^}]*)\}")
"""The converter leaves out environments that it does not know."""

SPELLED = {
    r"\displaystyle": "",
    r"\nonumber": "",
    r"\operatorname": r"\mathrm",
    r"\begin{aligned}": r"\begin{split}",
    r"\end{aligned}": r"\end{split}",
    r"\tfrac": r"\frac",
}
"""Commands that the converter does not know, with replacements that it knows."""

NAMESPACE = "{http://www.w3.org/1998/Math/MathML}"
TALL = ("mfrac", "mtable", "msqrt")
"""Elements that are higher than a line."""

FUNCTIONS = "sin|cos|tan|cot|sec|csc|arcsin|arccos|arctan|sinh|cosh|tanh|coth|exp|ln|log|max|min|det|sgn"
BRACKET = re.compile(r'(rspace=")[^"]*("[^<]*</mo>(?:(?:<m[ni]>[^<]*</m[ni]>)</msup>)?<mo[^>]*>\()')
COLUMN = re.compile(r'<mtd columnalign="(\w+)"')


def mathml(latex: str, display: str) -> str:
    """Return a formula as MathML. Raises ExtensionError for a formula with an unknown command."""
    plain = latex.strip()
    for command, replacement in SPELLED.items():
        plain = plain.replace(command, replacement)
    markup = convert(plain, display=display)
    unknown = [name for name in ENVIRONMENT.findall(plain) if f"\\{name}" not in MATRICES] + UNKNOWN.findall(markup)
    if unknown:
        raise ExtensionError(
            f"the formula {latex!r} contains {unknown[0]!r}, which the converter to MathML does not know"
        )
    return COLUMN.sub(r'<mtd style="text-align: \1; padding: 0.15em 0"', spaced(with_brackets(markup)))


def with_brackets(markup: str) -> str:
    """Return MathML with brackets that do not stretch around a line of letters, since browsers put gaps around them."""
    root = ET.fromstring(markup)
    for row in root.iter(f"{NAMESPACE}mrow"):
        ends = [row[0], row[-1]] if len(row) > 1 else []
        fences = [end for end in ends if end.tag == f"{NAMESPACE}mo" and (end.text or "") in "()[]|"]
        if len(fences) == 2 and not any(part.tag.removeprefix(NAMESPACE) in TALL for part in row.iter()):
            for fence in fences:
                fence.set("stretchy", "false")
    ET.register_namespace("", NAMESPACE.strip("{}"))
    return ET.tostring(root, encoding="unicode")


def spaced(markup: str) -> str:
    """Return MathML with thin spaces around the names of functions, as in TeX, and none before a bracket."""
    named = re.sub(rf"<mi>({FUNCTIONS})</mi>", r'<mo lspace="0.17em" rspace="0.17em">\1</mo>', markup)
    return BRACKET.sub(r"\g<1>0\2", named)


def inline(translator: Any, node: nodes.math) -> None:
    """Write a formula in a sentence."""
    translator.body.append(mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on separate lines, with its number at the right."""
    text = node.astext()
    tags = TAG.findall(text)
    number = f'<span class="equation-number">({tags[0]})</span>' if tags else ""
    identity = f' id="{node["ids"][0]}"' if node["ids"] else ""
    translator.body.append(f'<div class="equation"{identity}>{mathml(TAG.sub("", text), "block")}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer under the name mathml."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
