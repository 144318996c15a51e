"""The functions that a statement may use."""

from __future__ import annotations

import pytest
import sympy

from lagrange.statement.vocabulary.words import ALIASES, SYMPY_CLASSES, WORDS

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


@pytest.mark.parametrize("name", WORDS)
def test_the_class_of_every_word_may_stand_in_an_energy(name: str) -> None:
    x, y = sympy.symbols("x y", real=True)
    word = WORDS[name]
    built = word.build(*(x, y)[: max(word.fewest, 2 if word.most is None else 1)])
    functions = built.atoms(sympy.Function) or {built}
    assert all(type(one) in SYMPY_CLASSES or isinstance(one, sympy.Pow) for one in functions)
