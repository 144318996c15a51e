"""The sine and cosine of an angle as one operation: the same in every life of a procedure."""

from __future__ import annotations

import math
from functools import partial

import pytest

from lagrange.machine.llvm.called import CompiledProcedure
from lagrange.machine.llvm.procedures import INLINE_ANGLES
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Procedure
from lagrange.procedure.interpreter import run
from lagrange.procedure.rewrite import Pruner

ANGLES = (0.0, -0.0, 0.7, -2.5, 1e5, 3e7, -1e300, math.inf, math.nan)
"""Beyond 2**20 the machine takes the C library's functions."""


def pairs(count: int) -> Procedure:
    """Return a procedure that computes the pair of an angle, and count - 1 others that nothing but a sum reads."""
    p = Builder("pairs", "Return the sine and the cosine of x.")
    x = p.given("x", REAL)
    sine, cosine = p.sine_cosine(x)
    total = p.real(0.0)
    for k in range(1, count):
        other = p.sine_cosine(x * float(k))
        total = p.fnma(*other, total)
    p.leave(sine, cosine, total)
    return p.finish(REAL, REAL, REAL)


@pytest.mark.parametrize("count", [1, INLINE_ANGLES + 1], ids=["written out", "of a function"])
def test_every_life_has_the_sine_and_the_cosine(count: int) -> None:
    procedure = pairs(count)
    lives = partial(run, procedure), loaded(procedure), CompiledProcedure(procedure)
    for x in ANGLES:
        finite = math.isfinite(x)
        expected = (math.sin(x), math.cos(x)) if finite else (math.nan, math.nan)
        for life in lives:
            found = life(x)
            # The machine's own sine and the C library's are each right to less than a unit in the last place.
            assert found[:2] == pytest.approx(expected, rel=2.0**-51, abs=0.0, nan_ok=True)
            assert math.copysign(1.0, found[0]) == math.copysign(1.0, expected[0]) or not finite


def test_what_nobody_reads_of_a_pair_is_not_printed() -> None:
    p = Builder("half", "Return a cosine.")
    x = p.given("x", REAL)
    _, cosine = p.sine_cosine(x)
    p.sine_cosine(x * 2.0)
    p.leave(cosine)
    procedure = Pruner().pruned(p.finish(REAL))
    assert source(procedure).splitlines()[2:] == ["    return _cos(x)"]
