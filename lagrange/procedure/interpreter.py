"""Run a procedure statement by statement in Python: the reference with which every printer is compared.

Reals are Python floats, wholes and flags are Python ints and bools. An array is any indexable object, used from an
offset on; a record is an object with its fields as attributes, such as its `Record.structure`. A function parameter is
called with `Span`s for arrays; it returns None, a value or a tuple of values.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, PARTIAL, REAL, SUMS, Array, Fold, Procedure, Statement
from lagrange.statement.vocabulary.functions import ELEMENTARY

Results = tuple[Any, ...]
Environment = dict[int, Any]


@dataclass(frozen=True)
class Span:
    """The part of an array from index `start` on."""

    memory: Any
    start: int = 0

    def __getitem__(self, index: int) -> Any:
        return self.memory[self.start + index]

    def __setitem__(self, index: int, value: Any) -> None:
        self.memory[self.start + index] = value

    def part(self, start: int) -> Span:
        """Return the part of this span from index `start` on."""
        return Span(self.memory, self.start + start)


def run(procedure: Procedure, *args: Any) -> Results:
    """Run a procedure and return its results. `args` are in the order of its parameters."""
    environment: Environment = {}
    for parameter, arg in zip(procedure.parameters, args, strict=True):
        plain = not isinstance(parameter.type, Array) or isinstance(arg, Span)
        environment[parameter.ref] = arg if plain else Span(arg)
    return _block(procedure.body, environment) or ()


def _block(block: Sequence[Any], contents: Environment) -> Results | None:
    """Run statements. Return the results of the procedure if a statement ends it, else None.

    `contents` maps the ids of values, variables and memory to their present contents.
    """
    for statement in block:
        value = _VALUES.get(type(statement))
        if value is not None:
            contents[statement.ref] = value(statement, contents)
        elif (results := _effect(statement, contents)) is not None:
            return results
    return None


def _effect(statement: Statement, contents: Environment) -> Results | None:
    """Run a statement that changes memory or variables, or directs control.

    Return the results of the procedure if the statement ends it, else None. `contents` maps the ids of
    values, variables and memory to their present contents.
    """
    match statement:
        case form.Store(array=array, place=index, value=value):
            contents[array][contents[index]] = contents[value]
        case form.Write(record=record, field=field, value=value):
            setattr(contents[record], field, contents[value])
        case form.Set(variable=variable, value=value):
            contents[variable] = contents[value]
        case form.SineCosine(sine=sine, cosine=cosine, angle=angle):
            for op, ref in (("sin", sine), ("cos", cosine)):
                x, take = contents[angle], OPERATIONS[op]
                contents[ref] = tuple(map(take, x)) if isinstance(x, tuple) else take(x)
        case form.VectorStore(array=array, place=first, value=value, mask=mask):
            adjacent = range(contents[first], contents[first] + len(contents[value]))
            _scatter(contents[array], adjacent, contents[value], None if mask is None else contents[mask])
        case form.Scatter(array=array, places=indices, value=value, mask=mask):
            _scatter(contents[array], contents[indices], contents[value], contents[mask])
        case form.When(condition=condition, then=then, otherwise=otherwise):
            return _block(then if contents[condition] else otherwise, contents)
        case form.Loop() | form.Repeat():
            for _ in _iterations(statement, contents):
                results = _block(statement.body, contents)
                if results is not None:
                    return results
        case form.Each():
            _each(statement, contents)
        case form.Call(refs=refs, callee=callee, args=args):
            arguments = [contents[arg] for arg in args]
            if isinstance(callee, Procedure):
                results = run(callee, *arguments)
            else:
                returned = contents[callee](*arguments)
                results = returned if len(refs) > 1 else (returned,)[: len(refs)]
            contents.update(zip(refs, results, strict=True))
        case form.Leave(values=values):
            return tuple(contents[value] for value in values)
    return None


def _iterations(loop: form.Loop | form.Repeat, contents: Environment) -> Iterator[None]:
    """Yield once for each iteration of a loop, after setting its index or computing its condition."""
    if isinstance(loop, form.Loop):
        for index in range(contents[loop.start], contents[loop.stop], loop.step):
            contents[loop.place] = index
            yield
        return
    _block(loop.test, contents)
    while contents[loop.condition]:
        yield
        _block(loop.test, contents)


def _vector(let: form.VectorLet, contents: Environment) -> tuple[Any, ...]:
    args = [contents[arg] for arg in let.args]
    if let.op != "permute":
        return tuple(OPERATIONS[let.op](*entries) for entries in zip(*args, strict=True))
    entries = [entry for arg in args for entry in (arg if isinstance(arg, tuple) else (arg,))]
    return tuple(entries[index] for index in let.places)


def _reduced(reduce: form.Reduce, contents: Environment) -> Any:
    return any(contents[reduce.vector]) if reduce.op == "any" else contents[reduce.vector][reduce.place]


def _loaded(load: form.VectorLoad, contents: Environment) -> tuple[Any, ...]:
    array, number = contents[load.array], float if load.vector.kind is REAL else int
    return tuple(number(array[contents[load.place] + k]) for k in range(load.vector.width))


def _gathered(load: form.Gather, contents: Environment) -> tuple[Any, ...]:
    array, number = contents[load.array], float if load.vector.kind is REAL else int
    pairs = zip(contents[load.places], contents[load.mask], strict=True)
    return tuple(number(array[index] if read else 0) for index, read in pairs)


def _scatter(array: Any, indices: Sequence[int], entries: Sequence[Any], mask: Sequence[bool] | None) -> None:
    for index, value, written in zip(indices, entries, mask or (True,) * len(entries), strict=True):
        if written:
            array[index] = value


_VALUES: Mapping[type, Callable[[Any, Environment], Any]] = {
    form.Let: lambda s, contents: s.data if s.op == CONSTANT else OPERATIONS[s.op](*[contents[arg] for arg in s.args]),
    form.VectorLet: _vector,
    form.Reduce: _reduced,
    form.VectorLoad: _loaded,
    form.Gather: _gathered,
    form.Reserve: lambda s, contents: Span([math.nan if s.array.kind is REAL else 0] * (s.array.size + s.array.room)),
    form.ReserveRecord: lambda s, contents: s.record.structure(),
    form.Part: lambda s, contents: contents[s.array].part(contents[s.start]),
    form.Load: lambda s, contents: (float if s.kind is REAL else int)(contents[s.array][contents[s.place]]),
    form.Read: lambda s, contents: _field(getattr(contents[s.record], s.field)),
    form.Declare: lambda s, contents: contents[s.value],
    form.Get: lambda s, contents: contents[s.variable],
}
"""Functions that compute the value of a statement's id `ref`, by class of the statement."""


def _field(value: Any) -> Any:
    """Return the value of a record's field: a number, or the entries of a vector as a tuple."""
    return value if isinstance(value, (int, float)) else tuple(value)


def _each(each: form.Each, contents: Environment) -> None:
    values: list[list[tuple[float, ...]]] = [[] for _ in each.folds]
    for index in range(contents[each.iterations]):
        contents[each.place] = index
        _block(each.body, contents)
        for fold, collected in zip(each.folds, values, strict=True):
            collected.append(tuple(contents[ref] for ref in (fold.value, fold.factor) if ref is not None))
    for fold, collected in zip(each.folds, values, strict=True):
        contents[fold.ref] = _folded(fold, collected)


def _folded(fold: Fold, values: Sequence[tuple[float, ...]]) -> float:
    if fold.op not in SUMS:
        largest = fold.first
        for (value,) in values:
            largest = LARGER[fold.op](largest, value)
        return largest
    sums = [0.0] * PARTIAL
    for i, factors in enumerate(values):
        before = sums[i % PARTIAL]
        sums[i % PARTIAL] = before + factors[0] if fold.op == "add" else fused(factors[0], factors[1], before)
    return (sums[0] + sums[1]) + (sums[2] + sums[3])


# --- arithmetic of doubles as in processors: undefined results are NaN or infinite, and no exception is raised


def _divide(a: float, b: float) -> float:
    if b:
        return a / b
    return math.nan if a == 0 or math.isnan(a) or math.isnan(b) else math.copysign(math.inf, a) * math.copysign(1.0, b)


def _max(a: Any, b: Any) -> Any:
    """Return the larger number, NaN if either is NaN. The larger of 0.0 and -0.0 is 0.0."""
    if a == b:
        return b if math.copysign(1.0, a) < 0 else a
    return a if a != a or a > b else b


def _magnitude(a: float, b: float) -> float:
    return float(_max(abs(a), abs(b)))


LARGER: Mapping[str, Callable[[float, float], float]] = {
    "max": _max,
    "most": lambda a, b: b if b > a else a,
    "magnitude": _magnitude,
}
"""The function that returns the larger of two values, for each reduction that is a maximum."""


def _min(a: Any, b: Any) -> Any:
    if a == b:
        return a if math.copysign(1.0, a) < 0 else b
    return a if a != a or a < b else b


def fused(a: float, b: float, c: float) -> float:
    """Return a*b + c, rounded once."""
    if not (math.isfinite(a) and math.isfinite(b)):
        return a * b + c
    if not math.isfinite(c):
        return c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        return float(exact) if exact else a * b + c
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def _power(a: float, b: float) -> float:
    try:
        power = math.pow(a, b)
    except OverflowError:
        odd = b == math.floor(b) and math.fmod(b, 2.0) != 0.0
        return -math.inf if a < 0 and odd else math.inf
    except ValueError:
        if a == 0:
            odd = math.fmod(b, 2.0) in (1.0, -1.0)
            return math.copysign(math.inf, a) if odd else math.inf
        return math.nan
    return power


def _total(function: Callable[[float], float], *, pole: float = math.nan) -> Callable[[float], float]:
    """Return `function` with results instead of exceptions.

    The results are NaN outside the domain, infinite on overflow, and `pole` at zero if the function is undefined
    there.
    """

    def value(x: float) -> float:
        try:
            return function(x)
        except OverflowError:
            return math.inf if x > 0 or function is math.cosh else -math.inf
        except ValueError:
            return pole if x == 0 else math.nan

    return value


def _bits(x: float) -> int:
    return int(struct.unpack("<Q", struct.pack("<d", x))[0])


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _divide,
    "min": _min,
    "max": _max,
    "magnitude": _magnitude,
    "neg": lambda a: -a,
    "quotient": lambda a, b: abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1),
    "abs": abs,
    "sqrt": _total(math.sqrt),
    "sign": lambda a: 1.0 if a > 0 else -1.0 if a < 0 else a,
    **{function.name: _total(function.of_float, pole=function.pole) for function in ELEMENTARY.values()},
    "atan2": math.atan2,
    "copysign": math.copysign,
    "atanh": lambda x: math.copysign(math.inf, x) if abs(x) == 1 else _total(math.atanh)(x),
    "power": _power,
    "round": lambda x: math.copysign(float(round(x)), x) if math.isfinite(x) else x,
    "fma": fused,
    "fnma": lambda a, b, c: fused(-a, b, c),
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "equal": lambda a, b: a == b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "select": lambda c, a, b: a if c else b,
    "real": float,
    "whole": int,
    "two_to": lambda k: math.ldexp(1.0, k),
    "exponent": lambda x: (_bits(x) >> 52 & 2047) - 1023,
    "mantissa": lambda x: struct.unpack("<d", struct.pack("<Q", _bits(x) & 2**52 - 1 | 1023 << 52))[0],
}
"""Functions that compute every operation of procedures on Python's numbers."""
