"""Data as JSON that stands in a script element of a page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

_ESCAPED = str.maketrans({mark: f"\\u{ord(mark):04x}" for mark in "<>&"})
"""Marks that a parser of HTML looks for, as JSON spells them in any text; all beyond ASCII is spelled so anyway."""


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON: no text in it can end the element or begin a comment. Raises ValueError for NaN."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).translate(_ESCAPED)
