"""The equations that the package prints, in text, Unicode and LaTeX, are read back as what they were."""

from __future__ import annotations

import random

import pytest
import sympy as sp

import lagrange as lg
from lagrange.mechanics.student_equations import equations_of_text
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.latex import LatexNotation
from lagrange.show.notation.text import AsciiNotation, UnicodeNotation
from tests.models import shared_scene


@pytest.mark.parametrize("notation", [AsciiNotation, UnicodeNotation, LatexNotation])
@pytest.mark.parametrize("name", lg.scenes())
def test_printed_equations_are_read_back(name: str, notation: type) -> None:
    system = shared_scene(name)
    names = [*system.statement.names, *(p.name for p in system.statement.parameters)]
    typeset = Typesetter(
        system.statement, notation([*names, *(one.multiplier.name for one in system.statement.constraints)])
    )
    laws = system.equations()
    text = "\n".join(f"{typeset.write(law.lhs)} = {typeset.write(law.rhs)}" for law in laws)
    dice = random.Random(name)
    for law, read in zip(laws, equations_of_text(text, system.statement), strict=True):
        zero = (law.lhs - law.rhs).xreplace(system.statement.plain)
        values = {
            symbol: dice.uniform(0.5, 1.5) for symbol in sorted(zero.free_symbols | read.zero.free_symbols, key=str)
        }
        expected, found = (float(sp.N(one.xreplace(values))) for one in (zero, read.zero))
        # Both are sums of the same terms, of order one to a hundred, added in another order.
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
