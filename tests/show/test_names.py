from __future__ import annotations

import re

import pytest

from lagrange.page.document import filled
from lagrange.show.notation.text import GREEK, latex_text, letters, markdown_text, plain_text
from lagrange.show.terminal import text_table


@pytest.mark.parametrize(
    ("name", "spelled"),
    [
        ("x", "x"),
        ("theta", r"\theta"),
        ("Omega", r"\Omega"),
        ("theta1", r"\theta_{1}"),
        ("m_1", "m_{1}"),
        ("m_bob", r"m_{\mathrm{bob}}"),
        ("omega_x_2", r"\omega_{x, 2}"),
        ("x_theta1", r"x_{\theta1}"),
        ("length", r"\mathrm{length}"),
        ("left", r"\mathrm{left}"),
        ("input", r"\mathrm{input}"),
        ("hbar", r"\mathrm{hbar}"),
        ("xdot", r"\mathrm{xdot}"),
        ("pi", r"\mathrm{pi}"),
        ("Alpha", r"\mathrm{Alpha}"),
        ("a__b", "a_{b}"),
        ("a_", "a"),
        ("θ1", r"\theta_{1}"),
        ("x_Ω", r"x_{\Omega}"),
        ("θx", r"\mathrm{thetax}"),
    ],
)
def test_letters(name: str, spelled: str) -> None:
    assert str(letters([name])[name]) == spelled


def test_two_names_never_look_the_same() -> None:
    names = ["x1", "x_1", "x__1", "theta", "theta_"]
    spelled = [str(letter) for letter in letters(names).values()]
    assert spelled == ["x_{1}", r"\mathrm{x\_1}", r"\mathrm{x\_\_1}", r"\theta", r"\mathrm{theta\_}"]


def test_dots_stand_above_the_letter_alone() -> None:
    letter = letters(["theta_1"])["theta_1"]
    assert (letter.dotted(1), letter.dotted(2)) == (r"\dot{\theta}_{1}", r"\ddot{\theta}_{1}")


def test_greek_letters_are_commands_that_latex_has() -> None:
    assert len(GREEK) == 33
    assert {"pi", "omicron", "Alpha"}.isdisjoint(GREEK)


HOSTILE = "\\input{/etc/passwd} $x$ _a_ #1 & 50% ~^{}<b>|\"'`*[a](b)!\x1b[31m\nnew  line"


def test_latex_text_has_no_command_of_the_author() -> None:
    spelled = latex_text(HOSTILE)
    assert spelled.startswith(
        r"\textbackslash{}input\{/etc/passwd\} \$x\$ \_a\_ \#1 \& 50\% \textasciitilde{}\textasciicircum{}\{\}"
    )
    assert "\x1b" not in spelled and "\n" not in spelled
    assert r"\textless{}b\textgreater{}\textbar{}\textquotedbl{}" in spelled


def test_markdown_text_has_no_mark_of_the_author() -> None:
    spelled = markdown_text(HOSTILE)
    assert not set("\\`*_{}[]<>()#!|$~&") & set(re.sub(r"\\.", "", spelled))


def test_plain_text_is_one_line_without_controls() -> None:
    assert plain_text(" a\tb\n c\x1b[2J\u202e ") == "a b c[2J"


# --- Tables in plain text ---


def test_text_is_aligned_and_numbers_are_flush_right() -> None:
    table = text_table(("name", "n"), [("a", 1), ("long one", 200)])
    assert table.splitlines() == ["name        n", "--------  ---", "a           1", "long one  200"]


def test_without_headings_there_is_no_rule() -> None:
    assert text_table(("", ""), [("a", "b"), ("cc", "d")]).splitlines() == ["a   b", "cc  d"]


def test_a_table_without_rows() -> None:
    assert text_table(("name", "n"), []).splitlines() == ["name  n", "----  -"]


# --- Templates of pages are filled once: nothing that is put in is read as a field ---


def test_parts_stay_text() -> None:
    assert filled("<{{a}}|{{b}}>{ {{{a}}}", {"a": "{{b}}", "b": r"\1 {{a}}"}) == r"<{{b}}|\1 {{a}}>{ {{{b}}}"


def test_a_field_without_a_part_is_a_fault() -> None:
    with pytest.raises(KeyError):
        filled("{{a}}", {})
