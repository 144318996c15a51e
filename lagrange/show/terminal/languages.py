"""Markup languages and levels of detail of a derivation, and the language for a terminal."""

from __future__ import annotations

import sys

DETAILS = ("full", "short")
FORMATS = ("text", "unicode", "latex", "markdown", "html")


def terminal_style() -> str:
    """Return "unicode" if standard output is a terminal that supports Unicode, else "text", which is plain ASCII."""
    stream = sys.stdout
    if stream is None or not stream.isatty():
        return "text"
    return "unicode" if (stream.encoding or "").lower().replace("-", "").startswith("utf") else "text"
