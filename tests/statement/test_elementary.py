"""The records of elementary functions: derivatives, symmetries, exact and precise values are right."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpmath import libmp

from lagrange.statement.vocabulary.functions import ALIASES, ELEMENTARY, WORDS, Elementary

PLACES = {"acosh": (1.25, 2.5, 40.0), "log": (0.1, 2.5, 40.0)}
EVERY = pytest.mark.parametrize("function", ELEMENTARY.values(), ids=list(ELEMENTARY))


def places(function: Elementary) -> tuple[float, ...]:
    return PLACES.get(function.name, (-0.75, 0.25, 0.9))


@EVERY
def test_all_lives_of_a_function_have_its_value(function: Elementary) -> None:
    for x in places(function):
        value = function.of_float(x)
        # Libraries are right to 2 ulp.
        others = (float(function.of_array(np.array([x]))[0]), float(function.symbolic(x)))
        exact = libmp.to_float(function.precise(libmp.from_float(x), 53, "n"))
        assert (*others, exact) == pytest.approx((value,) * 3, rel=2.0**-50)


@EVERY
def test_symmetries_exact_values_and_domains(function: Elementary) -> None:
    argument, value = function.exact
    assert function.of_float(float(argument)) == value
    x = 0.4
    if function.odd or function.even:
        assert function.of_float(-x) == (-1 if function.odd else 1) * function.of_float(x)
    outside = [x for x in (-2.0, 0.0, 2.0) if not has_value(function, x)]
    assert bool(outside) == (not function.everywhere)
    assert math.isinf(function.pole) == (function.name == "log")


def has_value(function: Elementary, x: float) -> bool:
    try:
        return math.isfinite(function.of_float(x))
    except ValueError:
        return False


# --- The functions that a statement may use ---


REQUIRED = (
    "sin cos tan asin acos atan atan2 exp log sqrt sinh cosh tanh cot sec csc sinc asinh acosh atanh erf heaviside abs "
    "sign min max mod"
)


def test_the_words_are_complete_and_named_as_they_are_listed() -> None:
    assert set(REQUIRED.split(" ")) == set(WORDS)
    assert all(word.name == name for name, word in WORDS.items())


def test_aliases_lead_to_words() -> None:
    assert set(ALIASES.values()) <= set(WORDS)
    assert not set(ALIASES) & set(WORDS)
