"""Formulas of the documentation site become MathML at build time, and one that cannot is an error."""

from __future__ import annotations

import re
from collections.abc import Callable
from types import ModuleType

import pytest

pytest.importorskip("sphinx")
pytest.importorskip("latex2mathml")

Module = Callable[[str], ModuleType]


def test_equations_in_lines_are_a_table(module: Module) -> None:
    made = module("mathml").mathml(r"\begin{aligned} a &= b \\ &\quad {} + c \end{aligned}", "block")
    assert made.startswith("<math") and made.count("<mtr>") == 2 and "columnalign" not in made


def test_functions_have_thin_spaces_and_none_before_a_bracket(module: Module) -> None:
    made = module("mathml").mathml(r"l \sin\theta + \cos(\phi) + \tan^2(\phi)", "inline")
    spaces = re.findall(r'rspace="([^"]*)">(\w+)<', made)
    assert spaces == [("0.17em", "sin"), ("0", "cos"), ("0", "tan")]


@pytest.mark.parametrize("latex", [r"a + \unheardof{b}", r"\begin{nonsense} a \end{nonsense}"])
def test_a_formula_with_an_unknown_command_is_refused(module: Module, latex: str) -> None:
    mathml = module("mathml")
    with pytest.raises(mathml.ExtensionError, match="what MathML is not made of here"):
        mathml.mathml(latex, "block")


def test_brackets_about_a_line_do_not_stretch_and_those_about_a_fraction_do(module: Module) -> None:
    made = module("mathml").mathml(r"\theta{\left(t \right)} + \left(\frac{a}{b}\right)", "inline")
    assert re.findall(r'stretchy="(\w+)"[^>]*>[()]<', made) == ["false", "false", "true", "true"]
