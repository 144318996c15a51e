"""User-defined methods: a step as a plain Python function, tested before it is compiled.

The function first runs on trial vectors with numeric coefficients, which report any operation other than a linear
combination. They also give the tableau of a Runge-Kutta step, whose order conditions are then checked.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from numbers import Rational, Real
from typing import Any, NoReturn, Self

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.machine.drivers import numbers_of
from lagrange.program.step import StepProgram, TracedVector, trace
from lagrange.statement.expression import text, whole_number
from lagrange.trajectory.dense_output import hermite_path
from lagrange.trajectory.integrator import Claims, Problem, method_repr
from lagrange.trajectory.methods.splitting import check_separable
from lagrange.trajectory.methods.tolerances import check_options, fixed_settings
from lagrange.trajectory.plan import StepPlan
from lagrange.trajectory.run_loop import drive_by
from lagrange.trajectory.tableaux.butcher import CONDITION_TOLERANCE, ButcherTableau, Coefficient

TRIAL_POINTS = ((Fraction(0), Fraction(1)), (Fraction(2), Fraction(2)))
"""Times t and step sizes h of the trial calls of a user's step function. Two of them distinguish h**2 from h."""

SHORT_STEP = Fraction(1, 4096)
"""Step size h for the test of a step function that is not a Runge-Kutta step. If the function is consistent, the
coefficients of its slopes add up to h for short steps, up to an error that is small relative to h."""

SHORT_STEP_TOLERANCE = 1 / 16
"""Tolerance of the test of a step function with a short step h. It bounds the error of the sum of the slopes'
coefficients, as a fraction of h, and the distance of the slopes' times from the start of the step."""

FORMS = "step(f, t, y, h), or step(a, t, q, v, h) to move coordinates and velocities in turn"


@dataclass(frozen=True)
class StepMethod:
    """An integrator with fixed steps by a step function of the user, made by `step_method`."""

    name: str
    order: int
    function: Callable[..., Any]
    step: float | None = None

    def __repr__(self) -> str:
        return method_repr(self, step=self.step)

    def __post_init__(self) -> None:
        text(self.name, "name")
        object.__setattr__(self, "order", whole_number(self.order, "order", 1))
        _arguments(self.name, self.function)
        check_options(self.step)

    @cached_property
    def claims(self) -> Claims:
        """The claimed properties: the order that the user stated, and the order of the dense output."""
        return Claims(order=self.order, dense=max(3, self.order - 1))

    @property
    def program(self) -> StepProgram:
        """The program that computes one step of the method."""
        return _program(self.name, self.function)

    def plan(self, problem: Problem) -> StepPlan:
        """Return the plan of a run: the step program, the step size, and the dense output."""
        tolerances = fixed_settings(self.name, problem, self.step, None, None)
        if self.program.states == 2:
            check_separable(self.name, problem.model)
        return StepPlan(self.program, tolerances, hermite_path(self.order))

    integrate = drive_by


def step_method(function: Callable[..., Any], *, order: int, name: str = "", step: float | None = None) -> StepMethod:
    """Return a method with fixed steps from a step function, compiled for every system on which it runs.

    `function` is `step(f, t, y, h)`, which returns the state at t + h; f(t, y) is the slope of the state y = [q, v]. Or
    it is `step(a, t, q, v, h)`, which returns (q, v); the accelerations a(t, q) do not depend on velocities. The
    function may only add and subtract vectors, and multiply them by numbers made of t and h. The function is called to
    record these operations, and must do the same at every call.

    A step of the first form is checked for its order, like a tableau; or for consistency if its coefficients are not
    proportional to h. A step of the second form is checked under a constant force. Raises StatementError.
    """
    if isinstance(order, bool) or not isinstance(order, int) or order < 1:
        raise StatementError(f"order = {shown(order)}: give the order of the method, a whole number of at least 1.")
    called = text(name, "name") or getattr(function, "__name__", "") or "step"
    _check_recorded(called, function, _check_consistent(called, function, order))
    return StepMethod(called, order, function, step)


@lru_cache(maxsize=64)
def _program(name: str, function: Callable[..., Any]) -> StepProgram:
    """Return the step function of a user as a program, recorded from one call.

    The call has symbolic vectors as arguments. `name` is the name of the method in messages.
    """

    def guarded(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except TypeError as error:
            raise refusal(
                name, f"of t and h it takes more than sums, products, quotients and powers ({error})"
            ) from error

    law = "accelerations" if _arguments(name, function) == 5 else "rhs"
    program = trace(name, guarded, law=law)
    return replace(program, function=function)


def _arguments(name: str, function: Callable[..., Any]) -> int:
    """Return the number of arguments of a step function. Raises StatementError if it is neither 4 nor 5."""
    if not callable(function) or not isinstance(function, Hashable):
        what = f"{_kind_of(function)} without a hash" if callable(function) else _kind_of(function)
        raise StatementError(f"the step function {name} is {what}: give a function, {FORMS}.")
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError) as error:
        raise StatementError(f"Python cannot tell the arguments of the step function {name}: write {FORMS}.") from error
    plain = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty]
    if len(plain) not in (4, 5):
        raise StatementError(
            f"the step function {name} takes {len(plain)} arguments ({', '.join(p.name for p in plain)}): "
            f"write {FORMS}."
        )
    return len(plain)


class _OtherOperationError(Exception):
    """Error in a trial call of a step function: its text names the operation that a step may not use."""


def refusal(name: str, what: str) -> StatementError:
    """Return the error for the step function `name`: it says `what` is wrong, and what a step may do."""
    return StatementError(
        f"the step function {name} cannot be used: {what}. A step adds vectors and multiplies them by numbers made of "
        "t and h."
    )


def _kind_of(value: object) -> str:
    """Return a description of a value by its type, for messages, such as "the number 2" or "a list"."""
    if isinstance(value, Fraction) and value.denominator == 1:
        value = value.numerator
    return f"the number {shown(value)}" if isinstance(value, Real) else f"a {type(value).__name__}"


def _number(value: Real) -> Coefficient:
    """Return a coefficient of a step function as an exact fraction if it is rational, else as a float."""
    return Fraction(value) if isinstance(value, Rational) else float(value)


def _refusing(what: str) -> Callable[..., Any]:
    """Return a method of `TrialVector` for an operation that a step may not use: it raises an error.

    The text of the error is `what`, with {0}, {1}, ... replaced by the method's arguments.
    """

    def refuse(*arguments: object, **_: object) -> NoReturn:
        raise _OtherOperationError(what.format(*arguments[1:]))

    return refuse


NUMPY_OPERATIONS = {"add": operator.add, "subtract": operator.sub, "multiply": operator.mul, "divide": operator.truediv}
"""Operations that a step may apply to a NumPy number and a vector, by their NumPy names."""


class TrialVector(TracedVector):
    """A linear combination of the state and the slopes with numbers as coefficients, in a trial call of a step.

    Any operation that is not linear raises an error that names the operation.
    """

    __slots__ = ()

    def made(self, terms: Mapping[int, Coefficient]) -> Self:
        """Return the linear combination with the coefficients `terms`. They are stored without zeros.

        The keys of `terms` are the indices of the combined vectors: the state, then the slopes.
        """
        return type(self)({i: c for i, c in terms.items() if c})

    def __add__(self, other: Any) -> Self:
        if not isinstance(other, TrialVector) and not (isinstance(other, Real) and other == 0):
            raise _OtherOperationError(f"it adds {_kind_of(other)} to a vector")
        return super().__add__(other)

    __radd__ = __add__

    def __mul__(self, factor: Any) -> Self:
        if not isinstance(factor, Real):
            two = isinstance(factor, TrialVector)
            raise _OtherOperationError(f"it multiplies {'two vectors' if two else f'a vector by {_kind_of(factor)}'}")
        return super().__mul__(_number(factor))

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> Self:
        if not isinstance(divisor, Real) or divisor == 0:
            by = "zero" if isinstance(divisor, Real) else _kind_of(divisor)
            raise _OtherOperationError(f"it divides a vector by {by}")
        return super().__truediv__(_number(divisor))

    __hash__ = object.__hash__
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

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        operation = NUMPY_OPERATIONS.get(ufunc.__name__)
        numbers = all(isinstance(x, (TrialVector, np.generic)) for x in inputs)
        if operation is None or method != "__call__" or not numbers or options:
            raise _OtherOperationError(f"it takes numpy's {ufunc.__name__} of a vector")
        return operation(*(x if isinstance(x, TrialVector) else x.item() for x in inputs))

    def __getattr__(self, attribute: str) -> NoReturn:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        raise _OtherOperationError(f"it uses .{attribute} of a vector")


@dataclass(frozen=True)
class _Tried:
    """The operations of a trial call of a step function, as linear combinations of the state and the slopes.

    The step evaluates slopes at the `times` and the vectors `arguments`, and returns the vectors `results`. Each vector
    is a dict from index to coefficient. Index 0 is the state y, or indices 0 and 1 are q and v; then come the slopes.
    """

    times: tuple[Coefficient, ...]
    arguments: tuple[dict[int, Coefficient], ...]
    results: tuple[dict[int, Coefficient], ...]

    @property
    def combinations(self) -> tuple[dict[int, Coefficient], ...]:
        """All vectors of the trial call: the arguments at which slopes are evaluated, then the results of the step."""
        return self.arguments + self.results


def _agree(pairs: Iterable[tuple[Coefficient, Coefficient]]) -> bool:
    """Return True if the numbers of each pair are equal up to rounding."""
    return all(abs(float(a) - float(b)) <= CONDITION_TOLERANCE * max(1.0, abs(float(a))) for a, b in pairs)


def _tried(name: str, function: Callable[..., Any], states: int, t: Fraction, h: Fraction) -> _Tried:
    """Return the operations and results of a trial call of the step function `name` at time t with step h.

    `states` is 1 for a step of the state y, 2 for a step of q and v. Raises StatementError for anything but linear
    combinations of vectors.
    """
    times: list[Coefficient] = []
    points: list[dict[int, Coefficient]] = []
    what = "f(t, y)" if states == 1 else "a(t, q)"

    def f(*arguments: Any) -> TrialVector:
        if len(arguments) != 2:
            raise refusal(name, f"it calls {what} with {len(arguments)} arguments")
        at, y = arguments
        if not isinstance(at, Real):
            raise refusal(name, f"it calls {what} at a time that is {_kind_of(at)}")
        if not isinstance(y, TrialVector):
            raise refusal(name, f"it calls {what} for {_kind_of(y)} in place of a vector")
        times.append(_number(at))
        points.append(y.terms)
        return TrialVector({states + len(times) - 1: Fraction(1)})

    vectors = [TrialVector({i: Fraction(1)}) for i in range(states)]
    try:
        returned = function(f, t, *vectors, h)
    except StatementError:
        raise
    except _OtherOperationError as error:
        raise refusal(name, str(error)) from None
    except (TypeError, ValueError, ArithmeticError, LookupError, AttributeError, NameError) as error:
        raise refusal(name, f"it fails with {type(error).__name__}: {error}") from error
    results = returned if isinstance(returned, (tuple, list)) and len(returned) != 1 else (returned,)
    expected = "the new state" if states == 1 else "the new coordinates and velocities, q, v"
    if len(results) != states or not all(isinstance(vector, TrialVector) for vector in results):
        shown = ", ".join("a vector" if isinstance(vector, TrialVector) else _kind_of(vector) for vector in results)
        raise refusal(name, f"it returns {shown or 'nothing'} in place of {expected}")
    if not times:
        raise refusal(name, f"it never calls {what}")
    return _Tried(tuple(times), tuple(points), tuple(vector.terms for vector in results))


def _check_consistent(name: str, function: Callable[..., Any], order: int) -> Sequence[_Tried]:
    """Return two trial calls of a step function. Raises StatementError if it is inconsistent, or not of the `order`.

    `name` is the name of the method in messages.
    """
    states = 2 if _arguments(name, function) == 5 else 1
    tried, doubled = both = tuple(_tried(name, function, states, *point) for point in TRIAL_POINTS)
    if states == 2:
        for trial, (t, h) in zip(both, TRIAL_POINTS, strict=True):
            _check_partitioned(name, order, trial, t, h)
        return both
    for argument in tried.arguments:
        _check_whole(name, "a slope is taken at", argument)
    _check_whole(name, "the new state holds", tried.results[0])
    # In a Runge-Kutta step coefficients are proportional to h, and times are t + c h. The second call has twice h.
    pairs = [(2 + 2 * at, later) for at, later in zip(tried.times, doubled.times, strict=False)]
    for terms, others in zip(tried.combinations, doubled.combinations, strict=False):
        pairs += [(2 * terms.get(i, 0), others.get(i, 0)) for i in sorted(terms | others) if i]
    if len(tried.times) != len(doubled.times) or not _agree(pairs):
        for t, _ in TRIAL_POINTS:
            _check_short(name, _tried(name, function, 1, t, SHORT_STEP), t)
        return both
    slopes = range(1, len(tried.times) + 1)
    ButcherTableau(
        name=name,
        order=order,
        A=tuple(tuple(terms.get(j, Fraction(0)) for j in slopes[:i]) for i, terms in enumerate(tried.arguments)),
        b=tuple(tried.results[0].get(j, Fraction(0)) for j in slopes),
        c=tried.times,
    )
    return both


def _check_recorded(name: str, function: Callable[..., Any], trials: Sequence[_Tried]) -> None:
    """Raise StatementError if the program recorded from a step function differs from its trial calls.

    Only the program runs, so it must do what the function does. `name` is the name of the method in messages.
    """
    program = _program(name, function)
    scalars = program.scalars(program.numbers)
    recorded = [*(call.argument for call in program.calls), *program.results]
    for (t, h), tried in zip(TRIAL_POINTS, trials, strict=True):
        values = numbers_of(program, scalars, float(t), float(h), 1.0)
        pairs = [(values[call.time], at) for call, at in zip(program.calls, tried.times, strict=False)]
        for combination, terms in zip(recorded, tried.combinations, strict=False):
            coefficients = {i: values[factor] for i, factor in combination}
            pairs += [(coefficients.get(i, 0), terms.get(i, 0)) for i in sorted(coefficients | terms)]
        if len(tried.times) != len(program.calls) or not _agree(pairs):
            raise refusal(
                name, "it does not do the same at every call: it asks what t or h is, or depends on something else"
            )


def _check_short(name: str, tried: _Tried, t: Fraction) -> None:
    """Raise StatementError if a step function does not tend to y + h f(t, y) for short steps.

    `tried` is its trial call at time t with a very short step h. In the new state, and in the argument of each slope, y
    must have the coefficient 1. The coefficients of slopes in the new state must add up to h, and slopes must be taken
    near time t. This test is for functions that are not Runge-Kutta steps. `name` is the name of the method in
    messages.
    """
    _check_whole(name, "the new state holds", tried.results[0])
    slopes = sum(float(c) for i, c in tried.results[0].items() if i) / float(SHORT_STEP)
    if not abs(slopes - 1) <= SHORT_STEP_TOLERANCE:
        raise refusal(name, f"where h is small, at t = {t}, its slopes add up to {slopes:g} times h instead of 1")
    for at, argument in zip(tried.times, tried.arguments, strict=True):
        _check_whole(name, "a slope is taken at", argument)
        if not abs(float(at - t)) <= SHORT_STEP_TOLERANCE:
            raise refusal(name, f"where h is small, at t = {t}, a slope is taken at the time {float(at):g}")


def _check_whole(name: str, what: str, terms: dict[int, Coefficient]) -> None:
    if abs(float(terms.get(0, 0)) - 1) > CONDITION_TOLERANCE:
        raise refusal(name, f"{what} {float(terms.get(0, 0)):g} times the old state, which must be there once")


def _check_partitioned(name: str, order: int, tried: _Tried, t: Fraction, h: Fraction) -> None:
    """Raise StatementError if a step in q and v is wrong under a constant acceleration a.

    `tried` is its trial call at time t with step h. It must return q + h v + h^2 a/2 and v + h a; the term with h^2 is
    required from order 2 on.
    """
    q, v = tried.results
    sums = [sum(float(c) for i, c in terms.items() if i > 1) for terms in (q, v)]
    conditions: list[tuple[str, str, Coefficient, Coefficient]] = [
        ("the new q holds", "q", q.get(0, 0), 1),
        ("the new q holds", "h v", q.get(1, 0) / h, 1),
        ("the new v holds", "q", v.get(0, 0), 0),
        ("the new v holds", "v", v.get(1, 0), 1),
        ("the new v holds, of a constant acceleration,", "h a", sums[1] / h, 1),
        *([("the new q holds, of a constant acceleration,", "h^2 a", sums[0] / h**2, 0.5)] if order > 1 else []),
    ]
    for at, argument in zip(tried.times, tried.arguments, strict=True):
        part = (at - t) / h
        conditions += [
            ("an acceleration is taken at", "q", argument.get(0, 0), 1),
            (f"an acceleration is taken at t + {float(part):g} h and", "h v", argument.get(1, 0) / h, part),
        ]
    for what, of, value, expected in conditions:
        if not abs(float(value) - float(expected)) <= CONDITION_TOLERANCE:
            raise refusal(name, f"{what} {float(value):g} times {of} instead of {float(expected):g}")
