"""Templates of pages are filled once: nothing that is put in is read as a field."""

from __future__ import annotations

import pytest

from lagrange.page.document import filled


def test_parts_stay_text() -> None:
    assert filled("<{{a}}|{{b}}>{ {{{a}}}", {"a": "{{b}}", "b": r"\1 {{a}}"}) == r"<{{b}}|\1 {{a}}>{ {{{b}}}"


def test_a_field_without_a_part_is_a_fault() -> None:
    with pytest.raises(KeyError):
        filled("{{a}}", {})
