"""Register of the functions that write results as notebook pages.

The class of a result belongs to an early stage of the package. Its page needs the notation of formulas, which belongs
to a later stage. The later module registers the pages here, and is imported when the first page is shown.
"""

from __future__ import annotations

from functools import singledispatch
from importlib import import_module
from typing import Any

PAGES = "lagrange.show.notebook.result_pages"
"""Module that registers the pages."""


@singledispatch
def notebook_page(result: Any) -> str | None:
    """Return the page of a result in Markdown, or None if its class has none. A notebook then shows the repr."""
    del result
    return None


class ShownAsPage:
    """Base of the results that a notebook shows as a page."""

    def _repr_markdown_(self) -> str | None:
        import_module(PAGES)
        return notebook_page(self)
