"""Evaluate SymPy expressions with many digits (mpmath), independent of graphs and compiled code.

The switches of an expression are its conditions, Abs, sign, Min and Max: they select between formulas.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache, reduce
from typing import Any, NamedTuple

import sympy
from mpmath import MPContext, libmp

from lagrange.statement.coordinate import t as time
from lagrange.statement.expression import parts_first
from lagrange.statement.random_states import RELATIONS, children
from lagrange.statement.run_settings import check_time
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.functions import ELEMENTARY

Operation = Callable[..., Any]

_LIMITS = {
    "growing": (40, "a number beyond any range"),
    "periodic": (1024, "an angle beyond the range of double precision"),
    "": (10**9, ""),
}
"""Largest binary exponent of an argument, by the kind of function, and the message beyond it.

Beyond 40 mpmath's exp does not return. For an angle above all doubles, mpmath would compute as many digits of pi as the
integer part has.
"""


class OutsideDomain(Exception):
    """Raised if an expression has no real, finite value at the point."""


class BeyondDoubles(OutsideDomain):
    """Raised if a value exists, but an intermediate result exceeds the range of doubles."""


def _multiply(prec: int) -> Operation:
    def product(first: Any, *rest: Any) -> Any:
        for factor in rest:
            first = libmp.mpf_mul(first, factor, prec, "n")
        return first

    return product


def _power(exponent: Any, prec: int) -> Operation:
    if isinstance(exponent, sympy.Integer):
        n = int(exponent)
        return lambda base, _: libmp.mpf_pow_int(base, n, prec, "n")
    if exponent == sympy.S.Half:
        return lambda base, _: libmp.mpf_sqrt(base, prec, "n")

    def power(base: Any, power: Any) -> Any:
        if base == libmp.fzero and libmp.mpf_sign(power) <= 0:
            raise ZeroDivisionError("zero to a power that is not positive")
        return libmp.mpf_pow(base, _bounded(power, "growing"), prec, "n")

    return power


def _unary(function: Callable[[Any, int, str], Any], kind: str) -> Callable[[int], Operation]:
    # Cached, since differences move one coordinate at a time, so that the same few arguments recur.
    return lambda prec: lru_cache(maxsize=1024)(lambda x: function(_bounded(x, kind), prec, "n"))


def _bounded(x: Any, kind: str) -> Any:
    limit, message = _LIMITS[kind]
    if x[2] + x[3] > limit:
        raise OverflowError(message)
    return x


def _reciprocal(function: Callable[[Any, int, str], Any]) -> Callable[[int], Operation]:
    return _unary(
        lambda x, prec, rounding: libmp.mpf_div(libmp.fone, function(x, prec + 10, rounding), prec, rounding),
        "periodic",
    )


def _log(prec: int) -> Operation:
    def log(x: Any) -> Any:
        if x == libmp.fzero:
            raise ZeroDivisionError("logarithm of zero")
        return libmp.mpf_log(x, prec, "n")

    return log


def _atan2(prec: int) -> Operation:
    def atan2(y: Any, x: Any) -> Any:
        if x == libmp.fzero and y == libmp.fzero:
            raise ZeroDivisionError("atan2(0, 0)")
        return libmp.mpf_atan2(y, x, prec, "n")

    return atan2


def _sinc(x: Any, prec: int, rounding: str) -> Any:
    if x == libmp.fzero:
        return libmp.fone
    return libmp.mpf_div(libmp.mpf_sin(x, prec + 10, rounding), x, prec, rounding)


def _heaviside(x: Any, middle: Any) -> Any:
    side = libmp.mpf_sign(x)
    return middle if side == 0 else libmp.fone if side > 0 else libmp.fzero


def _piecewise(_: int) -> Operation:
    def select(*parts: Any) -> Any:
        for value, condition in zip(parts[::2], parts[1::2], strict=True):
            if condition is not False:
                return value if condition is True else condition
        raise ValueError("no branch of the Piecewise applies")

    return select


@cache
def _numeric() -> Mapping[Any, Callable[[int], Operation]]:
    """Return the operation of each SymPy class, as a function of the precision in bits."""
    return {
        sympy.Add: lambda prec: lambda *terms: libmp.mpf_sum(terms, prec, "n"),
        sympy.Mul: _multiply,
        **{elementary.symbolic: _unary(elementary.precise, elementary.spread) for elementary in ELEMENTARY.values()},
        sympy.cot: _reciprocal(libmp.mpf_tan),
        sympy.sec: _reciprocal(libmp.mpf_cos),
        sympy.csc: _reciprocal(libmp.mpf_sin),
        sympy.atan2: _atan2,
        sympy.log: _log,
        sympy.sinc: _unary(_sinc, "periodic"),
        sympy.Heaviside: lambda _: _heaviside,
        sympy.Abs: lambda _: libmp.mpf_abs,
        sympy.sign: lambda _: lambda x: libmp.from_int(libmp.mpf_sign(x)),
        sympy.Min: lambda _: lambda *xs: reduce(lambda a, b: a if libmp.mpf_lt(a, b) else b, xs),
        sympy.Max: lambda _: lambda *xs: reduce(lambda a, b: a if libmp.mpf_gt(a, b) else b, xs),
        sympy.Piecewise: _piecewise,
    }


def _decided(parts: Sequence[Any], *, verdict: bool) -> Any:
    """Return the truth value of Or (if `verdict` is True) or And (if it is False), from the values of its parts.

    The result is `verdict` if a part has this value. Otherwise it is a part without a value, if there is one.
    """
    if any(part is verdict for part in parts):
        return verdict
    return next((part for part in parts if not isinstance(part, bool)), not verdict)


BOOLEAN: dict[Any, Operation] = {
    sympy.StrictLessThan: libmp.mpf_lt,
    sympy.LessThan: libmp.mpf_le,
    sympy.StrictGreaterThan: libmp.mpf_gt,
    sympy.GreaterThan: libmp.mpf_ge,
    sympy.Equality: lambda a, b: bool(libmp.mpf_eq(_number(a), _number(b))),
    sympy.Unequality: lambda a, b: not libmp.mpf_eq(_number(a), _number(b)),
    sympy.And: lambda *parts: _decided(parts, verdict=False),
    sympy.Or: lambda *parts: _decided(parts, verdict=True),
    sympy.Not: lambda part: not part if isinstance(part, bool) else part,
    # SymPy creates an ITE for a Max inside a Max. A condition without a value is itself the result.
    sympy.ITE: lambda condition, a, b: condition if not isinstance(condition, bool) else a if condition else b,
}


def _number(value: Any) -> Any:
    if not isinstance(value, tuple):
        raise TypeError("not a number")
    return value


Inputs = Sequence[Any]


@cache
def _context(digits: int) -> Any:
    """Return the mpmath context with a number of digits. It is cached, because its creation is slow."""
    context = MPContext()
    context.dps = digits
    return context


class _Instruction(NamedTuple):
    """One instruction of a program: it writes to slot `out` and reads the slots `arguments`.

    `numeric` is true if the result is a number. `needs` has a bit for each input of the program on which the result
    depends.
    """

    out: int
    operation: Operation
    arguments: tuple[int, ...]
    numeric: bool
    needs: int


class Precise:
    """A program that evaluates expressions of a statement with `digits` significant digits.

    A call with q and v (n numbers each), t and a value for every parameter returns one mpmath number per expression.
    Python floats and SymPy Floats are converted exactly; fractions and constants such as pi have all digits. Only the
    selected branch of a Piecewise needs a value. A call raises OutsideDomain if an expression has no real, finite
    value. `entries` are the indices in (q, v) of the coordinates and velocities that occur. Values of the symbols in
    `further` are passed among the parameters.

    A call repeats only instructions whose inputs have changed since the previous call, since differences move one
    coordinate at a time. An instance therefore must not be used by several threads.
    """

    def __init__(
        self, expressions: Iterable[Any], statement: Statement, digits: int = 50, further: Iterable[Any] = ()
    ) -> None:
        self.context = _context(digits)
        tape = _Recorder(statement, self.context.prec, further)
        self._outputs = tuple(tape.record(e) for e in expressions)
        self._template = tape.constants
        self._values: list[Any] | None = None
        self._bases: dict[int, Any] = {}
        self._code = tuple(tape.code)
        self._load = tuple(tape.inputs.items())
        n = self._dimension = len(statement.coordinates)
        self.entries = frozenset(key + n * (kind == "v") for kind, key in tape.inputs.values() if kind in "qv")
        self.uses_time = any(kind == "t" for kind, _ in tape.inputs.values())
        self.switches = tuple(tape.switches)
        self._switch_code = tuple(tape.switches.values())

    def __call__(self, q: Inputs, v: Inputs, t: Any, parameters: Mapping[Any, Any]) -> list[Any]:
        """Return one value per expression. Raises OutsideDomain if one has no real, finite value."""
        values = self._run(q, v, t, parameters)
        make = self.context.make_mpf
        return [make(values[slot]) for slot in self._outputs]

    def work(self, entry: int | None = None) -> int:
        """Return the estimated time of a call, in units of 0.2 us.

        `entry` is the only entry of (q, v) that has changed since the last call; None means that all have changed.
        """
        changed = -1
        if entry is not None:
            kind, key = ("q", entry) if entry < self._dimension else ("v", entry - self._dimension)
            changed = sum(1 << bit for bit, (_, leaf) in enumerate(self._load) if leaf == (kind, key))
        # Units: 20 for an operation (its perturbed copies take three times as long), 1 for each argument, 1/3 for a
        # skipped operation, 3 for the comparison of an input with its last value. In chains a unit took about 0.2 us.
        idle = len(self._code) // 3 + 3 * len(self._load)
        return idle + sum(20 + len(step.arguments) for step in self._code if step.needs & changed)

    def inspect(
        self, q: Inputs, v: Inputs, t: Any, parameters: Mapping[Any, Any]
    ) -> tuple[tuple[int | None, ...], int]:
        """Return the outcome of each switch (None without a value), and the largest binary exponent of all numbers.

        A switch is a condition, Abs, sign, Min or Max; `all_ways` lists its outcomes. Raises OutsideDomain if an
        expression has no real, finite value.
        """
        values = self._run(q, v, t, parameters)

        def outcome(node: Any, out: int, arguments: tuple[int, ...]) -> int | None:
            if isinstance(values[out], OutsideDomain):
                return None
            if isinstance(values[out], bool):
                return int(values[out])
            if isinstance(node, (sympy.Min, sympy.Max)):
                return [values[i] for i in arguments].index(values[out])
            return int(libmp.mpf_sign(values[arguments[0]]))

        outcomes = tuple(outcome(node, *code) for node, code in zip(self.switches, self._switch_code, strict=True))
        exponents = [value[2] + value[3] for value in values if isinstance(value, tuple) and value[1]]
        return outcomes, max(exponents, default=0)

    def perturbed(self, size: float, seed: int) -> Precise:
        """Return a copy in which every computed number and its slope have fixed random factors 1 + O(size).

        These factors model rounding errors, large enough to be measured and smooth enough to be differentiated. The
        change of a derivative then measures its rounding error, cancellation included. Slopes need separate factors,
        because the terms of x/(1 + x), for example, cancel only in its slope. The factor of a slope applies to changes
        since the last call of `about`, or since the first evaluation.
        """
        draw = random.Random(seed)
        copy = object.__new__(Precise)
        copy.__dict__.update(self.__dict__)
        copy._bases = {}
        code = []
        for step in self._code:
            delta, slope = (
                libmp.from_float(size * draw.uniform(0.5, 1.0) * draw.choice((-1, 1)), self.context.prec, "n")
                for _ in range(2)
            )
            operation = _scaled(step, delta, slope, copy._bases, self.context.prec) if step.numeric else step.operation
            code.append(step._replace(operation=operation))
        copy._code = tuple(code)
        copy._values = None
        return copy

    def about(self, q: Inputs, v: Inputs, t: Any, parameters: Mapping[Any, Any]) -> list[Any]:
        """Return the values at a point, and make it the base point for the slope factors of a perturbed copy."""
        self._bases.clear()
        self._values = None
        return self(q, v, t, parameters)

    def _run(self, q: Inputs, v: Inputs, t: Any, parameters: Mapping[Any, Any]) -> list[Any]:
        check_time()
        values, changed = self._values, 0
        if values is None:
            values, changed = self._template.copy(), -1
        self._values = None  # until all values are consistent again
        number = self.context.mpf
        for bit, (slot, (kind, key)) in enumerate(self._load):
            value = q[key] if kind == "q" else v[key] if kind == "v" else t if kind == "t" else parameters[key]
            raw = value._mpf_ if isinstance(value, number) else number(value)._mpf_
            if values[slot] != raw:
                values[slot] = raw
                changed |= 1 << bit
        fetch = values.__getitem__
        for out, operation, arguments, _, needs in self._code:
            if needs & changed:
                try:
                    values[out] = operation(*map(fetch, arguments))
                except (ArithmeticError, ValueError, TypeError) as error:
                    values[out] = _no_value(error, list(map(fetch, arguments)))
        self._values = values
        for slot in self._outputs:
            if isinstance(values[slot], OutsideDomain):
                raise type(values[slot])(*values[slot].args)
        return values


def _no_value(error: Exception, arguments: Sequence[Any]) -> OutsideDomain:
    """Return the exception object that is stored as the result of an operation without a value.

    Operations on this object fail, so results that depend on it have no value either. A Piecewise ignores it in a
    branch that is not selected.
    """
    if isinstance(error, TypeError):
        broken = [argument for argument in arguments if isinstance(argument, OutsideDomain)]
        if not broken:
            raise error
        return broken[0]
    if isinstance(error, OverflowError):
        return BeyondDoubles(str(error))
    return OutsideDomain(str(error) or "division by zero")


def _scaled(step: _Instruction, delta: Any, slope: Any, first_results: dict[int, Any], prec: int) -> Operation:
    """Return the operation of an instruction, with random factors on its results that model rounding errors.

    The first result is multiplied by 1 + `delta`, and later changes of the result by 1 + `slope`. `first_results`
    keeps the first results, and `prec` is the precision in bits.
    """
    multiply, add = libmp.mpf_mul, libmp.mpf_add
    operation, out = step.operation, step.out
    factor, rest = add(libmp.fone, slope, prec, "n"), libmp.mpf_sub(delta, slope, prec, "n")

    def scaled(*arguments: Any) -> Any:
        value = operation(*arguments)
        if out not in first_results:
            first_results[out] = multiply(value, rest, prec, "n")
        return add(multiply(value, factor, prec, "n"), first_results[out], prec, "n")

    return scaled


@lru_cache(maxsize=1)
def _inputs(statement: Statement) -> Mapping[Any, tuple[str, Any]]:
    """Return {symbol: (kind, key)} for t, the parameters, and the entries of q and v, whose key is the index."""
    leaves: dict[Any, tuple[str, Any]] = {time: ("t", None)}
    leaves.update((p, ("p", p)) for p in statement.parameters)
    leaves.update((q, ("q", i)) for i, q in enumerate(statement.coordinates))
    leaves.update((v, ("v", i)) for i, v in enumerate(statement.velocities))
    return leaves


class _Recorder:
    """Translates expressions into instructions, children first; equal subexpressions share a slot."""

    def __init__(self, statement: Statement, prec: int, further: Iterable[Any]) -> None:
        self.prec = prec
        self.code: list[_Instruction] = []
        self.constants: list[Any] = []
        self.inputs: dict[int, tuple[str, Any]] = {}
        self.switches: dict[Any, tuple[int, tuple[int, ...]]] = {}
        self._slots: dict[Any, int] = {}
        self._needs: list[int] = []
        self._leaves = {**_inputs(statement), **{symbol: ("p", symbol) for symbol in further}}

    def record(self, expression: Any) -> int:
        """Translate an expression into instructions, and return the slot that will hold its value."""
        for node in parts_first(expression, self._slots, children):
            self._slots[node] = self._add(node)
        return self._slots[expression]

    def _add(self, node: Any) -> int:
        slot = len(self.constants)
        self.constants.append(None)
        self._needs.append(0)
        if node in self._leaves:
            self._needs[slot] = 1 << len(self.inputs)
            self.inputs[slot] = self._leaves[node]
        elif not children(node):
            self.constants[slot] = _constant(node, self.prec)
        else:
            self._compute(node, slot)
        return slot

    def _compute(self, node: Any, slot: int) -> None:
        arguments = tuple(self._slots[child] for child in children(node))
        operation = BOOLEAN.get(type(node))
        numeric = operation is None
        if operation is None and isinstance(node, sympy.Pow):
            operation = _power(node.exp, self.prec)
        elif operation is None and type(node) in _numeric():
            operation = _numeric()[type(node)](self.prec)
        elif operation is None:
            raise OutsideDomain(f"{type(node).__name__} cannot be evaluated here")
        for argument in arguments:
            self._needs[slot] |= self._needs[argument]
        # A constant is computed once, in the first evaluation.
        self.code.append(_Instruction(slot, operation, arguments, numeric, self._needs[slot] or _ALWAYS))
        if isinstance(node, _SWITCHES):
            self.switches[node] = (slot, arguments)


_ALWAYS = 1 << 100_000
"""Bit of instructions without inputs, above the bits of all inputs. It is set in the first evaluation only."""

_SWITCHES = (*RELATIONS, sympy.Abs, sympy.sign, sympy.Heaviside, sympy.Min, sympy.Max)


_NAMED: dict[Any, Callable[[int], Any]] = {
    sympy.pi: lambda prec: libmp.mpf_pi(prec, "n"),
    sympy.E: lambda prec: libmp.mpf_e(prec, "n"),
    sympy.GoldenRatio: lambda prec: libmp.mpf_phi(prec, "n"),
    sympy.EulerGamma: lambda prec: libmp.mpf_euler(prec, "n"),
    sympy.Catalan: lambda prec: libmp.mpf_catalan(prec, "n"),
}


def _constant(node: Any, prec: int) -> Any:
    if node in (sympy.true, sympy.false):
        return bool(node)
    if isinstance(node, sympy.Rational):
        return libmp.from_rational(int(node.p), int(node.q), prec, "n")
    if isinstance(node, sympy.Float):
        return tuple(node._mpf_)
    if node in _NAMED:
        return _NAMED[node](prec)
    if node.is_number:
        # The exception is returned, not raised: a Piecewise ignores it in a branch that is not selected.
        return OutsideDomain(f"{node} is not a finite real number")
    raise OutsideDomain(
        f"{node} has no value here: it is not a coordinate, velocity, parameter or number of this system"
    )


def all_ways(switch: Any) -> tuple[int, ...]:
    """Return all possible outcomes of a switch, which is a condition, Abs, sign, Min or Max.

    The outcomes are 0 and 1 for a condition, -1 and 1 for the sign of an argument, and the indices of arguments for Min
    and Max.
    """
    if isinstance(switch, (sympy.Min, sympy.Max)):
        return tuple(range(len(switch.args)))
    return (-1, 1) if isinstance(switch, (sympy.Abs, sympy.sign, sympy.Heaviside)) else (0, 1)


def describe_way(switch: Any, way: int, statement: Statement) -> str:
    """Return a clause in the user's symbols for the outcome `way` of a switch, such as ``x > 1 does not hold``."""
    if isinstance(switch, (sympy.Min, sympy.Max)):
        return f"{_text(switch.args[way], statement)} is the one that {_text(switch, statement)} takes"
    if isinstance(switch, (sympy.Abs, sympy.sign, sympy.Heaviside)):
        return f"{_text(switch.args[0], statement)} is {'positive' if way > 0 else 'negative'}"
    return f"{_text(switch, statement)} {'holds' if way else 'does not hold'}"


def _text(expression: Any, statement: Statement) -> str:
    text = str(expression.xreplace(dict(statement.plain)))
    return text if len(text) <= 80 else f"{text[:77]}..."
