"""Tables in plain text."""

from __future__ import annotations

from lagrange.show.terminal import text_table


def test_text_is_aligned_and_numbers_are_flush_right() -> None:
    table = text_table(("name", "n"), [("a", 1), ("long one", 200)])
    assert table.splitlines() == ["name        n", "--------  ---", "a           1", "long one  200"]


def test_without_headings_there_is_no_rule() -> None:
    assert text_table(("", ""), [("a", "b"), ("cc", "d")]).splitlines() == ["a   b", "cc  d"]


def test_a_table_without_rows() -> None:
    assert text_table(("name", "n"), []).splitlines() == ["name  n", "----  -"]
