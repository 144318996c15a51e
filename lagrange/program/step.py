"""A step of an integrator as a program, traced from plain Python: explicit or implicit, with error vectors.

A step function `step(f, t, y, h)` uses only f, sums, differences and multiples by numbers made of t and h. With arrays
as arguments it computes. With the `TracedVector`s of this module its operations are recorded, for a machine to compile:
every argument and result is a linear combination of the state and of earlier slopes. The function f is one of `LAWS`.

An implicit step has one more argument, `solve`, which introduces unknown vectors. Backward Euler is

    k = solve(lambda k: f(t + h, y + k * h) - k, lambda: f(t, y))
    return y + k * h

and a machine finds k by Newton's method, whose matrix follows from the recorded operations: a residual is a combination
of unknowns and of calls at combinations of unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, Self

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Exact, Graph, Kind, Node
from lagrange.program.lower import lower
from lagrange.program.program import Program
from lagrange.program.step_size_control import Control

Combination = tuple[tuple[int, Node], ...]
"""A linear combination of vectors: pairs (number of the vector, coefficient). State vectors come first, then results of
calls and solves, in order.
"""


def parts(combination: Combination, h: Node) -> tuple[Combination, tuple[tuple[int, Exact], ...]]:
    """Return the terms of a linear combination in two groups: terms without the factor h, and terms with it.

    A term is (index of a vector, coefficient). In the second group a coefficient c h is given as the exact number
    c: the sum of this group is multiplied by the step size h.
    """
    plain, scaled = [], []
    for vector, node in combination:
        if node is h:
            scaled.append((vector, 1))
        elif node.kind is Kind.SUM and node.args == (h,) and not node.data[0]:
            scaled.append((vector, node.data[1][0]))
        else:
            plain.append((vector, node))
    return tuple(plain), tuple(scaled)


def in_doubles(number: Exact) -> tuple[float, float]:
    """Return an exact number as a pair of doubles whose sum has about 32 digits."""
    return float(number), float(number - Fraction(float(number)))


@dataclass(frozen=True)
class Law:
    """The function of the model that a step evaluates, such as the right-hand side.

    `states`, `arguments` and `results` count the vectors of the state, of the arguments of a call, and of its
    results. `quantity` is the name of the model's quantity that a call evaluates, and `derivative` the name of its
    derivative by the arguments. `inputs` is the number of vectors of n entries that both quantities read.
    """

    states: int
    arguments: int
    results: int
    quantity: str
    derivative: str = ""
    inputs: int = 2

    def dimension(self, numbers: int) -> int:
        """Return the length 2n of a system's state, if the law reads `numbers` entries in total."""
        return 2 * numbers // self.inputs


LAWS = {
    "rhs": Law(1, 1, 1, "rhs", "jacobian"),
    "accelerations": Law(2, 1, 1, "rhs"),
    "momentum": Law(2, 2, 2, "momentum", "momentum_jacobian"),
    "constrained": Law(2, 3, 5, "constrained", "constrained_jacobian", 3),
    "local": Law(2, 3, 4, "local", "", 3),
}
"""The laws by name.

`rhs`: y' = f(t, y) with y = [q, v].

`accelerations`: a(t, q), independent of velocities, for methods that advance coordinates and velocities in turn.

`momentum`: p, f = g(t, q, v), with momenta p = dL/dv and forces f, so that dp/dt = f.

`constrained`: p, f, c, phi, psi = g(t, q, v, lambda), with constraint forces c = G^T lambda, the constraints phi and
their rates psi, all padded to n entries (`lagrange.program.catalogue`).

`local`: dQ/dt, dV/dt, q, v = g(t, Q, V, start), with a local state (Q, V) about the coordinates `start`
(`lagrange.program.catalogue`).
"""


@dataclass(frozen=True, eq=False)
class LawCall:
    """One evaluation of the model's function (the law) at a time and arguments.

    Its result vectors have the indices from `first` on.
    """

    time: Node
    arguments: tuple[Combination, ...]
    first: int

    @property
    def argument(self) -> Combination:
        """The first argument of the call. Laws with two state vectors may have more arguments."""
        return self.arguments[0]


@dataclass(frozen=True, eq=False)
class Solve:
    """Unknown vectors that make the `residuals` zero. The unknowns have the indices from `first` on.

    `calls` are the calls inside the residuals; they may depend on the unknowns but not on each other. `guesses` are
    the start values of Newton's method if no previous steps can be extrapolated; `preparation` are the calls that
    the guesses need. `predicted` extrapolates the unknowns of the previous step, which have the same indices.
    Without it, steps of equal size are extrapolated by a polynomial.
    """

    first: int
    preparation: tuple[LawCall, ...]
    guesses: tuple[Combination, ...]
    calls: tuple[LawCall, ...]
    residuals: tuple[Combination, ...]
    predicted: tuple[Combination, ...] = ()

    @property
    def count(self) -> int:
        """Number of unknown vectors that are solved for."""
        return len(self.residuals)

    def reach(self, unknown: int, position: int) -> list[Node]:
        """Return, for the `calls`, the coefficients of one unknown vector in the argument with index `position`.

        An argument is a linear combination of vectors. Arguments 0 and 1 are the law's state vectors.
        """
        return [
            factor
            for call in self.calls
            for vector, factor in call.arguments[position]
            if vector == self.first + unknown
        ]


@dataclass(frozen=True, eq=False)
class Damp:
    """The vector (I - factor J)^-1 x, for a linear combination x of vectors, given as `vector`.

    J is the last Jacobian of the system of equations (solve) with index `of`. `result` is the index of the new
    vector.
    """

    result: int
    of: int
    factor: Node
    vector: Combination


Action = LawCall | Solve | Damp


@dataclass(frozen=True, eq=False)
class StepProgram:
    """A step as a program in t and h: `actions` in order, then the new state vectors and the error vectors.

    With a `starter`, a step also reads the state one step before, whose vectors are numbered after the vectors of
    the state. The starter is a step program that does not read this state; it takes the first step and any step of
    another length. `ratio` is h over the length of the previous step.
    """

    name: str
    graph: Graph
    time: Node
    h: Node
    ratio: Node
    law: str
    actions: tuple[Action, ...]
    results: tuple[Combination, ...]
    errors: tuple[Combination, ...]
    control: Control | None
    function: Callable[..., Any]
    vectors: int
    starter: StepProgram | None = None

    @property
    def states(self) -> int:
        """Number of vectors of the state: 1 for [q, v], 2 for coordinates and velocities."""
        return LAWS[self.law].states

    @cached_property
    def calls(self) -> tuple[LawCall, ...]:
        """The evaluations of the law, such as the right-hand side, that are not in an implicit equation, in order."""
        return tuple(action for action in self.actions if isinstance(action, LawCall))

    @cached_property
    def solves(self) -> tuple[Solve, ...]:
        """The systems of equations that the step solves for unknown vectors, in the order of the step."""
        return tuple(action for action in self.actions if isinstance(action, Solve))

    @cached_property
    def damps(self) -> tuple[Damp, ...]:
        """The actions of the step that compute a vector (I - factor J)^-1 x, in order."""
        return tuple(action for action in self.actions if isinstance(action, Damp))

    @cached_property
    def numbers(self) -> tuple[Node, ...]:
        """The coefficients and times in the step, as nodes in t, h and the ratio of step sizes, each once."""
        combinations: list[Combination] = [*self.results, *self.errors]
        calls: list[LawCall] = []
        for action in self.actions:
            if isinstance(action, LawCall):
                calls.append(action)
            elif isinstance(action, Damp):
                combinations.append(action.vector)
            else:
                calls += [*action.preparation, *action.calls]
                combinations += [*action.guesses, *action.residuals, *action.predicted]
        combinations += [argument for call in calls for argument in call.arguments]
        factors = [*(damp.factor for damp in self.damps), *(call.time for call in calls)]
        return tuple(dict.fromkeys([*factors, *(factor for combination in combinations for _, factor in combination)]))

    def scalars(self, nodes: Sequence[Node]) -> Program:
        """Return a program that computes the coefficients `nodes` from t, h and the ratio of step sizes."""
        return lower("scalars", {"scalars": nodes}, {"h": [self.h], "ratio": [self.ratio]}, self.time, [])

    @property
    def exact(self) -> bool:
        """True for implicit steps of equal size, whose invariants must drift by random rounding only (Brouwer's law).

        A rounded coefficient, or a truncated part of an unknown, has an error of the same sign at every step. So
        coefficients of h are pairs of doubles, states are compensated sums, and unknowns are solved to the last digit.
        The energy of a pendulum drifts by 7e-21 per step with gauss3 and 6e-20 with galerkin6 (1e7 steps of 0.02 from
        16 starts). Without these measures the drifts are 4e-20 and 1.3e-18. Stages are still rounded to doubles.

        Source: E. Hairer, R. I. McLachlan, A. Razakarivony, Achieving Brouwer's law with implicit Runge-Kutta methods,
        BIT 48, 2008.
        """
        return bool(self.solves) and self.control is None

    def is_compensated(self, state: int) -> bool:
        """Return True if the rounding error of state vector number `state` is stored, and added in the next step."""
        return self.exact and (state, self.graph.one) in self.results[state]

    @property
    def starts_with_slope(self) -> bool:
        """True if the first evaluation of the model's function is at the state at which the step starts."""
        first = self.actions[0]
        known = isinstance(first, LawCall) and LAWS[self.law].results == 1 and self.starter is None
        return known and self.calls[0].time is self.time and self.calls[0].argument == ((0, self.graph.one),)

    @property
    def ends_with_slope(self) -> bool:
        """True if the last evaluation is at the state at which the step ends, so that the next step can reuse it."""
        if not self.starts_with_slope or self.solves:
            return False
        last = self.calls[-1]
        return last.time is self.time + self.h and last.argument == self.results[0]


def trace(
    name: str,
    function: Callable[..., Any],
    *,
    law: str = "rhs",
    implicit: bool = False,
    control: Control | None = None,
    starter: StepProgram | None = None,
) -> StepProgram:
    """Run a step function on symbolic vectors and return its operations as a step program.

    The function returns the new state, or (new state, error, ...) with a `control`. With a law of two state vectors
    ("accelerations", "momentum", "constrained") it returns (q, v) and errors of both. An `implicit` function gets
    `solve` as its last argument. A function with a `starter` gets the state one step before after the state. Raises
    StatementError if the function does anything other than combine vectors.
    """
    graph = Graph()
    states = LAWS[law].states
    time, h = graph.symbol("t", Binding.TIME), graph.symbol("h", Binding.TIME)
    arguments = [TracedVector({i: graph.one}) for i in range(states if starter is None else 2 * states)]
    recorder = Recorder(name, law, graph, len(arguments))
    try:
        returned = function(recorder.call, time, *arguments, h, *([recorder] if implicit else []))
    except TypeError as error:
        raise StatementError(
            f"step function {name} cannot be compiled: {error}. A step adds vectors and multiplies them by numbers "
            "made of t and h."
        ) from error
    vectors = list(returned) if isinstance(returned, (tuple, list)) else [returned]
    _check_results(name, vectors, states, control)
    combinations = [vector.combination() for vector in vectors]
    step = StepProgram(
        name=name,
        graph=graph,
        time=time,
        h=h,
        ratio=recorder.ratio,
        law=law,
        actions=tuple(recorder.actions),
        results=tuple(combinations[:states]),
        errors=tuple(combinations[states:]),
        control=control,
        function=function,
        vectors=recorder.vectors,
        starter=starter,
    )
    _check_scopes(step, recorder.inner)
    return step


def _check_scopes(step: StepProgram, inner: Mapping[int, None]) -> None:
    """Raise StatementError if a vector that was computed inside a residual is used outside of that residual.

    `inner` has the indices of the vectors that are results of calls inside residuals.
    """
    outside = [*step.results, *step.errors]
    outside += [argument for call in step.calls for argument in call.arguments]
    outside += [damp.vector for damp in step.damps]
    if any(i in inner for combination in outside for i, _ in combination):
        raise StatementError(
            f"step function {step.name} uses the result of a call of f in a residual outside of this residual: call f "
            "again there, or make the result an unknown."
        )


def _check_results(name: str, vectors: Sequence[Any], states: int, control: Control | None) -> None:
    errors = 0 if control is None else states * (2 if control.damped else 1)
    if len(vectors) != states + errors or not all(isinstance(vector, TracedVector) for vector in vectors):
        raise StatementError(
            f"step function {name} returns {len(vectors)} values; it must return {states} new state vector(s)"
            + (f" and {errors} error vector(s)." if errors else ".")
        )


class TracedVector:
    """A linear combination of a step's vectors, passed to the step function in place of an array."""

    __slots__ = ("terms",)
    __array_ufunc__: Any = None

    def __init__(self, terms: Mapping[int, Any]) -> None:
        self.terms = dict(terms)

    def made(self, terms: Mapping[int, Any]) -> Self:
        """Return a vector of this class with the coefficients `terms`, by index of the vector; zeros are dropped."""
        return type(self)({i: c for i, c in terms.items() if c is not c.graph.zero})

    def __add__(self, other: Any) -> Self:
        if not isinstance(other, TracedVector):
            if other == 0:
                return self
            raise StatementError(
                "a step function adds a number to a vector: a step may only add vectors and multiply them by numbers."
            )
        total = dict(self.terms)
        for i, coefficient in other.terms.items():
            total[i] = total[i] + coefficient if i in total else coefficient
        return self.made(total)

    __radd__ = __add__

    def __mul__(self, factor: Node | Exact | float) -> Self:
        if isinstance(factor, TracedVector):
            raise StatementError(
                "a step function multiplies two vectors: a step may only add vectors and multiply them by numbers."
            )
        return self.made({i: coefficient * factor for i, coefficient in self.terms.items()})

    __rmul__ = __mul__

    def __truediv__(self, divisor: Node | Exact | float) -> Self:
        return self.made({i: coefficient / divisor for i, coefficient in self.terms.items()})

    def __neg__(self) -> Self:
        return self * -1

    def __sub__(self, other: TracedVector | float) -> Self:
        return self + -other

    def __rsub__(self, other: TracedVector | float) -> Self:
        return -self + other

    def combination(self) -> Combination:
        """Return the linear combination as pairs (index of a vector, coefficient), sorted by index."""
        return tuple(sorted(self.terms.items()))


class Recorder:
    """Records the operations of a step function: the evaluations of the model's function (the law), and the solves.

    The method `call` is the argument f, a or g of the step function, and the recorder itself the argument `solve`.
    """

    def __init__(self, name: str, law: str, graph: Graph, states: int) -> None:
        self.name, self.law, self.graph = name, LAWS[law], graph
        self.vectors = states
        self.actions: list[Action] = []
        self.inside: list[LawCall] | None = None
        self.inner: dict[int, None] = {}
        self.solves = 0
        self.ratio = graph.symbol("ratio", Binding.TIME)

    def new(self) -> TracedVector:
        """Return a new vector of the step, with the next free index."""
        self.vectors += 1
        return TracedVector({self.vectors - 1: self.graph.one})

    def call(self, at: Any, *arguments: Any) -> Any:
        """Record an evaluation of the model's function at the time `at`, and return its results as vectors.

        The step function gets this method as its argument f, a or g.
        """
        expected = self.law.arguments
        if len(arguments) != expected:
            raise StatementError(
                f"step function {self.name} calls f with t and {len(arguments)} vectors, and f takes {expected}."
            )
        for argument in arguments:
            if not isinstance(argument, TracedVector):
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

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Callable[..., Any] | None = None) -> Any:
        """Return the unknowns at which `residual(*unknowns)` is zero: one vector, or a tuple if the guess is a tuple.

        A guess may be a function without arguments, which is called only if there are no previous steps to extrapolate
        from. `predict(ratio, *unknowns)` extrapolates the unknowns of the previous step over a step `ratio` times as
        long. Without it the unknowns of steps of equal size are extrapolated.
        """
        if not self.law.derivative:
            raise StatementError(
                f"step function {self.name} calls solve: its method must state law='rhs', 'momentum' or 'constrained'."
            )
        if self.inside is not None:
            raise StatementError(f"step function {self.name} calls solve inside a residual: call it outside.")
        preparation, guesses, several = self._within(guess if callable(guess) else lambda: guess)
        # The guess has its own scope: a call in the guess is not a call of the residual.
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

    def damp(self, factor: Any, vector: TracedVector) -> TracedVector:
        """Record and return the vector (I - factor J)^-1 `vector`, where J is the Jacobian of the last solve."""
        if not self.solves or self.law.results > 1:
            raise StatementError(
                f"step function {self.name} calls damp: call solve before it, in a method with law='rhs'."
            )
        made = self.new()
        node = self.graph.node(factor)
        self.actions.append(Damp(self.vectors - 1, self.solves - 1, node, vector.combination()))
        return made

    def _within(self, function: Callable[[], Any]) -> tuple[tuple[LawCall, ...], tuple[Combination, ...], bool]:
        """Run a function for residuals, guesses or predictions, and record its evaluations of the law.

        Return these evaluations, the results as linear combinations, and True if the function returned a tuple.
        """
        self.inside = []
        try:
            returned = function()
            made = tuple(self.inside)
        finally:
            self.inside = None
        several = isinstance(returned, (tuple, list))
        vectors = tuple(returned) if several else (returned,)
        if not all(isinstance(vector, TracedVector) for vector in vectors):
            raise StatementError(
                f"step function {self.name}: solve takes combinations of vectors alone. Guesses, residuals and "
                "predictions add vectors and multiply them by numbers made of t and h."
            )
        return made, tuple(vector.combination() for vector in vectors), several
