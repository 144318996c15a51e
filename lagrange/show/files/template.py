"""Templates of pages, and data for a script element."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

FIELD = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its fields filled; text in a part that has the form of a field stays."""
    return FIELD.sub(lambda match: parts[match[1]], template)


_ESCAPED = str.maketrans({mark: f"\\u{ord(mark):04x}" for mark in "<>&"})
"""Escapes in JSON of characters with a meaning in HTML. All characters beyond ASCII are escaped by json itself."""


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON that cannot end a script element or begin a comment. Raises ValueError for NaN."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).translate(_ESCAPED)
