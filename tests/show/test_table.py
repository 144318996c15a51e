"""Tables in plain text and in Markdown."""

from __future__ import annotations

from lagrange.show.table import markdown_table, text_table


def test_text_is_aligned_and_numbers_are_flush_right() -> None:
    table = text_table(("name", "n"), [("a", 1), ("long one", 200)])
    assert table.splitlines() == ["name        n", "--------  ---", "a           1", "long one  200"]


def test_without_headings_there_is_no_rule() -> None:
    assert text_table(("", ""), [("a", "b"), ("cc", "d")]).splitlines() == ["a   b", "cc  d"]


def test_a_table_without_rows() -> None:
    assert text_table(("name", "n"), []).splitlines() == ["name  n", "----  -"]
    assert markdown_table(("name",), []).splitlines() == ["| name |", "| --- |"]


def test_markdown_is_escaped() -> None:
    table = markdown_table(("name", "n"), [("a|b\nc", 1.5), ("\\", 2)])
    assert table.splitlines() == ["| name | n |", "| --- | ---: |", r"| a\|b c | 1.5 |", r"| \\ | 2 |"]
