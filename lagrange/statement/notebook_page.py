"""Results that a notebook shows as a page.

The class of a result is in its stage. Its page needs the notation of formulas, which is in a later stage: that module
enters the pages here, and is loaded by name when the first page is shown.
"""

from __future__ import annotations

from functools import singledispatch
from importlib import import_module
from typing import Any

PAGES = "lagrange.show.notebook.result_pages"
"""The module that enters the pages."""


@singledispatch
def notebook_page(result: Any) -> str | None:
    """Return the page of a result in Markdown, None where none is entered for its class: its repr is shown then."""
    del result
    return None


class ShownAsPage:
    """Base of the results that a notebook shows as a page."""

    def _repr_markdown_(self) -> str | None:
        import_module(PAGES)
        return notebook_page(self)
