"""Templates of pages, and data in a script element."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

FIELD = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its fields filled; what looks like a field in a part stays text."""
    return FIELD.sub(lambda match: parts[match[1]], template)


_ESCAPED = str.maketrans({mark: f"\\u{ord(mark):04x}" for mark in "<>&"})
"""Marks that a parser of HTML looks for, as JSON spells them in any text; all beyond ASCII is spelled so anyway."""


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON: no text in it can end the element or begin a comment. Raises ValueError for NaN."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).translate(_ESCAPED)
