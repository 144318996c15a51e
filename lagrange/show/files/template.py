"""Templates of pages: texts with fields such as {{title}}, each of which is filled once."""

from __future__ import annotations

import re
from collections.abc import Mapping

FIELD = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its fields filled; what looks like a field in a part stays text."""
    return FIELD.sub(lambda match: parts[match[1]], template)
