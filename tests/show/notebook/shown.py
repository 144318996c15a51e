"""What is common to the tests of notebooks: hostile names, and the size of what is shown."""

import base64
import re
from typing import Any

HOSTILE = "</td><script>alert('x')</script> $\\frac{1}{2}$ | **b** `c` &amp;"
"""A name that would run, and turn into a formula, a table or letters of another kind, where it is not made a text."""

TAG = re.compile(r"(?<!\\)<(\w+)")
OURS = frozenset(
    ("iframe", "details", "summary", "table", "caption", "tr", "th", "td", "b", "img", "p", "pre", "progress")
)
FRAMED = re.compile(r'<iframe [^>]*sandbox="allow-scripts"[^>]*srcdoc="[^"]*"></iframe>')
"""A page in a frame of its own, which the notebook is closed to."""

PICTURE = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=]+)")

TEXT, IMAGE = 20_000, 300_000
"""Characters and bytes that one result may take in a notebook, pictures apart."""


def rich(result: Any) -> dict[str, str]:
    """Return the texts and pictures that a notebook takes of a result, by their method."""
    actual = {}
    for kind in ("html", "markdown", "latex", "png"):
        method = getattr(result, f"_repr_{kind}_", None)
        shown = None if method is None else method()
        if shown is not None:
            actual[kind] = shown
    return actual


def held(kind: str, shown: Any) -> None:
    """Hold what is shown to its bounds, and to have no tags but our own."""
    if kind == "png":
        data = shown[0] if isinstance(shown, tuple) else base64.b64decode(shown)
        assert len(data) <= IMAGE
        return
    for picture in PICTURE.findall(shown):
        assert len(base64.b64decode(picture)) <= IMAGE
    text = FRAMED.sub("<iframe>", PICTURE.sub("", shown))
    assert 0 < len(text) <= TEXT
    assert set(TAG.findall(text)) <= OURS
    assert text.count("<details>") == text.count("</details>")
    if kind == "markdown":
        assert len(re.findall(r"(?<!\\)\$\$", text)) % 2 == 0
        assert len(re.findall(r"(?<!\\)\$", text)) % 2 == 0
