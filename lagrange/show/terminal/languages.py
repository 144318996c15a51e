"""Languages and levels of detail of a derivation, and the language that a terminal reads."""

from __future__ import annotations

import sys

DETAILS = ("full", "short")
FORMATS = ("text", "unicode", "latex", "markdown", "html")


def terminal_style() -> str:
    """Return "unicode" where standard output is a terminal that has Unicode, else "text", which is plain ASCII."""
    stream = sys.stdout
    if stream is None or not stream.isatty():
        return "text"
    return "unicode" if (stream.encoding or "").lower().replace("-", "").startswith("utf") else "text"
