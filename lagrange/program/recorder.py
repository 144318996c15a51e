"""Trace a step function: it runs on symbolic vectors, and its calls and solves are recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Exact, Graph, Node
from lagrange.program.actions import LAWS, Action, Combination, Damp, LawCall, Solve


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


class Recorder:
    """Recorder of a step function's calls of the law and of its solves, in place of both."""

    def __init__(self, name: str, law: str, graph: Graph, states: int) -> None:
        self.name, self.law, self.graph = name, LAWS[law], graph
        self.vectors = states
        self.actions: list[Action] = []
        self.inside: list[LawCall] | None = None
        self.inner: dict[int, None] = {}
        self.solves = 0
        self.ratio = graph.symbol("ratio", Binding.TIME)

    def new(self) -> Vector:
        """Return a vector with the next number."""
        self.vectors += 1
        return Vector({self.vectors - 1: self.graph.one})

    def call(self, at: Any, *arguments: Any) -> Any:
        """Record an evaluation of the law and return its results as vectors: the function f, a or g of a step."""
        wanted = self.law.arguments
        if len(arguments) != wanted:
            raise StatementError(
                f"step function {self.name} calls f with t and {len(arguments)} vectors: it takes {wanted}."
            )
        for argument in arguments:
            if not isinstance(argument, Vector):
                raise StatementError(
                    f"step function {self.name} calls f with {type(argument).__name__}, not with a state: give it a "
                    "combination of the state, slopes and unknowns."
                )
            if self.inside is not None and any(i in self.inner for i in argument.terms):
                raise StatementError(
                    f"step function {self.name} calls f inside a residual with the result of another such call: name "
                    "that slope as an unknown, k1, k2 = solve(lambda k1, k2: (...), (...))."
                )
        first = self.vectors
        call = LawCall(self.graph.node(at), tuple(argument.combination() for argument in arguments), first)
        results = tuple(self.new() for _ in range(self.law.results))
        if self.inside is None:
            self.actions.append(call)
        else:
            self.inside.append(call)
            self.inner.update(dict.fromkeys(range(first, self.vectors)))
        return results if len(results) > 1 else results[0]

    def solve(self, residual: Callable[..., Any], guess: Any, predict: Callable[..., Any] | None = None) -> Any:
        """Record unknowns; see `Solver`."""
        if not self.law.derivative or self.inside is not None:
            raise StatementError(
                f"step function {self.name} cannot solve here: solve is for the laws 'rhs', 'momentum' and "
                "'constrained', and is not used inside a residual."
            )
        preparation, guesses, several = self._within(guess if callable(guess) else lambda: guess)
        # The guess is its own scope: a call in it is not one of the residual.
        for call in preparation:
            for i in range(call.first, call.first + self.law.results):
                del self.inner[i]
        first = self.vectors
        unknowns = [self.new() for _ in guesses]
        calls, residuals, _ = self._within(lambda: residual(*unknowns))
        if len(residuals) != len(unknowns) or not calls:
            raise StatementError(
                f"step function {self.name} solves for {len(unknowns)} unknown(s) with {len(residuals)} residual(s) "
                f"and {len(calls)} call(s) of f in them: give one residual for each unknown, with a call of f."
            )
        predicted = () if predict is None else self._within(lambda: predict(self.ratio, *unknowns))[1]
        self.actions.append(Solve(first, preparation, guesses, calls, residuals, predicted))
        self.solves += 1
        return tuple(unknowns) if several else unknowns[0]

    def damp(self, factor: Any, vector: Vector) -> Vector:
        """Record a damped vector; see `Solver`."""
        if not self.solves or self.law.results > 1:
            raise StatementError(
                f"step function {self.name} damps before it solves: damp is for steps of the law 'rhs'."
            )
        made = self.new()
        node = self.graph.node(factor)
        self.actions.append(Damp(self.vectors - 1, self.solves - 1, node, vector.combination()))
        return made

    def _within(self, function: Callable[[], Any]) -> tuple[tuple[LawCall, ...], tuple[Combination, ...], bool]:
        """Return the calls that a function makes, the combinations that it returns, and whether they are a tuple."""
        self.inside = []
        try:
            returned = function()
            made = tuple(self.inside)
        finally:
            self.inside = None
        several = isinstance(returned, (tuple, list))
        vectors = tuple(returned) if several else (returned,)
        if not all(isinstance(vector, Vector) for vector in vectors):
            raise StatementError(
                f"step function {self.name} gives solve something that is not a combination of vectors: guesses, "
                "residuals and predictions add vectors and multiply them by numbers made of t and h."
            )
        return made, tuple(vector.combination() for vector in vectors), several


class Solver:
    """The argument `solve` of an implicit step function."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Callable[..., Any] | None = None) -> Any:
        """Return the unknowns at which `residual(*unknowns)` vanishes: one vector, or a tuple where the guess is one.

        A guess may be a function without arguments, which is called only where nothing is known to extrapolate from.
        `predict(ratio, *unknowns)` continues the unknowns of the step before over a step `ratio` times as long;
        without it those of equal steps are extrapolated.
        """
        return self._recorder.solve(residual, guess, predict)

    def damp(self, factor: Any, vector: Any) -> Any:
        """Return (I - factor J)^-1 vector, J being the Jacobian of f that the last solve has used."""
        return self._recorder.damp(factor, vector)
