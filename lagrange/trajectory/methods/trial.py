"""Trial vectors: a user's step function is called with them to determine what it computes.

Trial vectors represent the state and the slopes, and allow only linear combinations. Any other operation raises an
error with a message.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from numbers import Rational, Real
from typing import Any, NoReturn

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.trajectory.tableaux.butcher import Coefficient

ARITHMETIC = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "true_divide": operator.truediv,
}
"""Operations of a NumPy number with a vector, by their NumPy names."""


def refusal(name: str, what: str) -> StatementError:
    """Return the error for the step function `name`: it says `what` is wrong, and what a step may do."""
    return StatementError(
        f"the step function {name} cannot be used: {what}. A step adds vectors and multiplies them by numbers made of "
        "t and h."
    )


def kind_of(value: object) -> str:
    """Return a description of a value by its type, for messages, such as "the number 2" or "a list"."""
    if isinstance(value, Fraction) and value.denominator == 1:
        value = value.numerator
    return f"the number {shown(value)}" if isinstance(value, Real) else f"a {type(value).__name__}"


def number(value: Real) -> Coefficient:
    """Return a number as a fraction if it is exact, that is an integer or rational, else as a float."""
    return Fraction(value) if isinstance(value, Rational) else float(value)


def _refusing(what: str) -> Callable[..., Any]:
    """Return a method of `TrialVector` that raises an error, for an operation that a step function may not use.

    `what` is the text of the error, with places for the arguments.
    """

    def refuse(self: TrialVector, *arguments: object, **_: object) -> NoReturn:
        raise self._refused(what.format(*arguments))

    return refuse


class TrialVector:
    """A linear combination of the state and the slopes with numeric coefficients, from a trial call of a step."""

    def __init__(self, name: str, terms: Mapping[int, Coefficient]) -> None:
        self._name = name
        self._terms = dict(terms)

    @property
    def terms(self) -> dict[int, Coefficient]:
        """The nonzero coefficients of the combination, by index of the vector: state vectors first, then slopes."""
        return {i: c for i, c in self._terms.items() if c}

    def __add__(self, other: Any) -> TrialVector:
        if isinstance(other, TrialVector):
            both = self._terms | other._terms
            return self._made({i: self._terms.get(i, 0) + other._terms.get(i, 0) for i in both})
        if isinstance(other, Real) and other == 0:
            return self
        raise self._refused(f"it adds {kind_of(other)} to a vector")

    __radd__ = __add__

    def __sub__(self, other: Any) -> TrialVector:
        return self.__add__(other * -1)

    def __rsub__(self, other: Any) -> TrialVector:
        return self.__neg__().__add__(other)

    def __neg__(self) -> TrialVector:
        return self * -1

    def __pos__(self) -> TrialVector:
        return self

    def __mul__(self, factor: Any) -> TrialVector:
        if isinstance(factor, TrialVector):
            raise self._refused("it multiplies two vectors")
        if not isinstance(factor, Real):
            raise self._refused(f"it multiplies a vector by {kind_of(factor)}")
        return self._made({i: c * number(factor) for i, c in self._terms.items()})

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> TrialVector:
        if not isinstance(divisor, Real) or divisor == 0:
            raise self._refused(f"it divides a vector by {'zero' if isinstance(divisor, Real) else kind_of(divisor)}")
        return self._made({i: c / number(divisor) for i, c in self._terms.items()})

    def _made(self, terms: Mapping[int, Coefficient]) -> TrialVector:
        return TrialVector(self._name, terms)

    def _refused(self, what: str) -> StatementError:
        return refusal(self._name, what)

    def __hash__(self) -> int:
        return id(self)

    __eq__ = __lt__ = __le__ = __gt__ = __ge__ = _refusing("it compares a vector: a step cannot branch on the state")
    __bool__ = _refusing("it asks whether a vector is true: a step cannot branch on the state")
    __getitem__ = _refusing("it takes entry {0!r} of a vector: a step treats all coordinates alike")
    __setitem__ = _refusing("it sets entry {0!r} of a vector: a step treats all coordinates alike")
    __iter__ = _refusing("it goes through the entries of a vector: a step treats all coordinates alike")
    __len__ = _refusing("it asks for the length of a vector: a step is the same for every system")
    __abs__ = _refusing("it takes the absolute value of a vector")
    __pow__ = _refusing("it raises a vector to a power")
    __rtruediv__ = _refusing("it divides by a vector")
    __float__ = _refusing("it takes a vector for a number")
    __array__ = _refusing("it makes an array of a vector")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> TrialVector:
        numbers = all(isinstance(x, (TrialVector, np.generic)) for x in inputs)
        if ufunc.__name__ in ARITHMETIC and method == "__call__" and numbers and not options:
            plain = [x if isinstance(x, TrialVector) else x.item() for x in inputs]
            result: TrialVector = ARITHMETIC[ufunc.__name__](*plain)
            return result
        raise self._refused(f"it takes numpy's {ufunc.__name__} of a vector")

    def __getattr__(self, attribute: str) -> NoReturn:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        raise self._refused(f"it uses .{attribute} of a vector")
