"""One step of an integrator as a program: written once in plain Python, traced to calls and combinations.

A step function `step(f, t, y, h)` uses only f, sums, differences and multiples by numbers made of t and h. Given
arrays it computes; given the `Vector`s of this module it leaves a record that a machine compiles, with every
argument and result a linear combination of the state and the slopes found so far.

A partitioned step function `step(a, t, q, v, h)` is the same for methods that move coordinates and velocities in
turn; a(t, q) are the accelerations, which must not depend on velocities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Exact, Graph, Node

Combination = tuple[tuple[int, Node], ...]
"""Sum of coefficient * vector, by number: the states come first, then the result of each call, in order."""


@dataclass(frozen=True, eq=False)
class Call:
    """One evaluation of the right-hand side (or of the accelerations) at a time and a state (or coordinates)."""

    time: Node
    argument: Combination


@dataclass(frozen=True)
class Control:
    """How the step follows the error: h grows by safety * norm**(-1/exponent) * previous norm**memory, within bounds.

    `exponent` is the power of h with which the error norm shrinks. With `damped`, the step has two error vectors,
    and the norm is that of DOP853: e5 / sqrt((e5 + 0.01 e3) dim), of sums of squares.
    """

    exponent: int
    damped: bool = False
    memory: float = 0.0
    safety: float = 0.9
    least: float = 0.2
    most: float = 10.0


@dataclass(frozen=True, eq=False)
class StepProgram:
    """A step as a program in t and h: `calls` in order, then the new state(s) and the error vectors.

    `partitioned` steps have two state vectors, q and v, each (n,); others have one, y = [q, v].
    """

    name: str
    graph: Graph
    time: Node
    h: Node
    partitioned: bool
    calls: tuple[Call, ...]
    results: tuple[Combination, ...]
    errors: tuple[Combination, ...]
    control: Control | None
    function: Callable[..., Any]

    @property
    def states(self) -> int:
        """How many state vectors there are."""
        return 2 if self.partitioned else 1

    @property
    def starts_with_slope(self) -> bool:
        """Whether the first call is at the state that the step starts from."""
        return self.calls[0].time is self.time and self.calls[0].argument == ((0, self.graph.one),)

    @property
    def ends_with_slope(self) -> bool:
        """Whether the last call is at the state that the step ends with, so that the next step has it already."""
        last = self.calls[-1]
        return self.starts_with_slope and last.time is self.time + self.h and last.argument == self.results[0]

    def __str__(self) -> str:
        first = self.states
        lines = [f"{self.name}: " + ("q, v" if self.partitioned else "y") + ", t, h"]
        for i, call in enumerate(self.calls):
            lines.append(f"  k{i} = f({call.time!r}, {_shown(call.argument, first)})")
        lines += [f"  new = {_shown(result, first)}" for result in self.results]
        lines += [f"  error = {_shown(error, first)}" for error in self.errors]
        return "\n".join(lines)


class Vector:
    """A linear combination of a step's vectors, to trace with in place of an array."""

    __slots__ = ("terms",)
    __array_ufunc__ = None

    def __init__(self, terms: Mapping[int, Node]) -> None:
        self.terms = dict(terms)

    def __add__(self, other: Vector | float) -> Vector:
        if not isinstance(other, Vector):
            if other == 0:
                return self
            raise StatementError("a step function adds a number to a vector: a step is a combination of vectors.")
        total = dict(self.terms)
        for i, coefficient in other.terms.items():
            total[i] = total[i] + coefficient if i in total else coefficient
        return Vector({i: c for i, c in total.items() if c is not c.graph.zero})

    __radd__ = __add__

    def __mul__(self, factor: Node | Exact | float) -> Vector:
        if isinstance(factor, Vector):
            raise StatementError("a step function multiplies two vectors: a step is a combination of vectors.")
        scaled = {i: coefficient * factor for i, coefficient in self.terms.items()}
        return Vector({i: c for i, c in scaled.items() if c is not c.graph.zero})

    __rmul__ = __mul__

    def __truediv__(self, divisor: Node | Exact | float) -> Vector:
        return Vector({i: coefficient / divisor for i, coefficient in self.terms.items()})

    def __neg__(self) -> Vector:
        return self * -1

    def __sub__(self, other: Vector | float) -> Vector:
        return self + -other

    def __rsub__(self, other: Vector | float) -> Vector:
        return -self + other

    def combination(self) -> Combination:
        """Return the terms in the order of the vectors."""
        return tuple(sorted(self.terms.items()))


def trace(
    name: str, function: Callable[..., Any], *, partitioned: bool = False, control: Control | None = None
) -> StepProgram:
    """Run a step function on vectors and return what it did.

    The function returns the new state, or (new state, error, ...) where a `control` is given; a partitioned one
    returns (q, v). Raises StatementError if it does anything but combine vectors.
    """
    graph = Graph()
    time, h = graph.symbol("t", Binding.TIME), graph.symbol("h", Binding.TIME)
    states = [Vector({i: graph.one}) for i in range(2 if partitioned else 1)]
    calls: list[Call] = []

    def f(at: Any, y: Any) -> Vector:
        if not isinstance(y, Vector):
            raise StatementError(f"step function {name} calls f with {type(y).__name__}, not with a state.")
        calls.append(Call(graph.node(at), y.combination()))
        return Vector({len(states) + len(calls) - 1: graph.one})

    try:
        returned = function(f, time, *states, h)
    except TypeError as error:
        raise StatementError(
            f"step function {name} cannot be compiled: {error}. A step adds vectors and multiplies them by numbers "
            "made "
            "of t and h."
        ) from error
    found = list(returned) if isinstance(returned, (tuple, list)) else [returned]
    _check_results(name, found, len(states), control)
    combinations = [vector.combination() for vector in found]
    return StepProgram(
        name=name,
        graph=graph,
        time=time,
        h=h,
        partitioned=partitioned,
        calls=tuple(calls),
        results=tuple(combinations[: len(states)]),
        errors=tuple(combinations[len(states) :]),
        control=control,
        function=function,
    )


def _check_results(name: str, found: Sequence[Any], states: int, control: Control | None) -> None:
    errors = 0 if control is None else 2 if control.damped else 1
    if len(found) != states + errors or not all(isinstance(vector, Vector) for vector in found):
        raise StatementError(
            f"step function {name} returns {len(found)} values; it must return {states} new state vector(s)"
            + (f" and {errors} error vector(s)." if errors else ".")
        )


def _shown(combination: Combination, states: int) -> str:
    names = ("q", "v") if states == 2 else ("y",)
    return " + ".join(f"{c!r} {names[i] if i < states else f'k{i - states}'}" for i, c in combination) or "0"
