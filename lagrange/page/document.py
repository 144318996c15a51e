"""The page as one HTML document, in which nothing else can run."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from lagrange.show.files.template import filled

TEMPLATE = Path(__file__).resolve().parent / "template"

SCRIPTS = ("numbers", "motion", "view", "picture", "plots", "sliders", "controls", "page")
"""The scripts of every page, in the order in which they use one another."""

ENDS = re.compile(r"<(?=/script|script|!--)", re.IGNORECASE)
"""What would end a script element early, or begin another inside it."""


@dataclass(frozen=True)
class Document:
    """What is put into the template: texts and parts that are HTML already, the module, the data and the colours."""

    parts: Mapping[str, str]
    module: str
    data: str
    colours: str

    def html(self) -> str:
        """Return the page. Its policy allows its own two scripts and its own style by their hashes, and no request."""
        style = self.colours + template("page.css")
        scripts = [shared_scripts(), in_script(self.module)]
        allowed = {"script": " ".join(map(_hash, scripts)), "style": _hash(style)}
        policy = (
            f"default-src 'none'; script-src {allowed['script']}; style-src {allowed['style']}; base-uri 'none'; "
            "form-action 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
        )
        fields = {
            **self.parts,
            "policy": policy,
            "style": style,
            "data": self.data,
            "shared": scripts[0],
            "module": scripts[1],
        }
        return filled(template("page.html"), fields)


@cache
def template(name: str) -> str:
    """Return a file of the template."""
    return (TEMPLATE / name).read_text("utf-8")


@cache
def shared_scripts() -> str:
    """Return the scripts that every page has, as one."""
    return '"use strict";\n' + "\n".join(template(f"{name}.js") for name in SCRIPTS)


def in_script(text: str) -> str:
    """Return a script as it may stand in a script element.

    Only names and comments of a user can contain what ends the element, and JavaScript reads a backslash before a mark
    in a text, or in a comment, as nothing.
    """
    return ENDS.sub("<\\\\", text)


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
