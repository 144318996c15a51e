"""Results that a notebook shows as a page.

The class of a result stands in its stage. Its page needs the notation of formulas, which stands in a later one, and is
entered here by `lagrange/show/notebook`.
"""

from __future__ import annotations

from functools import singledispatch
from typing import Any


@singledispatch
def notebook_page(result: Any) -> str | None:
    """Return the page of a result in Markdown, None where none is entered for its class: its repr is shown then."""
    del result
    return None


class ShownAsPage:
    """Base of the results that a notebook shows as a page."""

    def _repr_markdown_(self) -> str | None:
        return notebook_page(self)
