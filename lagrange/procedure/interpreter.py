"""Run a procedure statement by statement: the reference for every printer.

Reals are Python floats, wholes and flags are Python ints and bools. An array is any indexable object, used from an
offset on; a record is an object with its fields as attributes, such as its `Record.structure`. A function parameter is
called with `Span`s for arrays; it returns None, a value or a tuple of values.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from lagrange.procedure.form import (
    CONSTANT,
    PARTIAL,
    REAL,
    SUMS,
    Array,
    Block,
    Call,
    Declare,
    Each,
    Fold,
    Gather,
    Get,
    Leave,
    Let,
    Load,
    Loop,
    Note,
    Part,
    Procedure,
    Read,
    Reduce,
    Repeat,
    Reserve,
    ReserveRecord,
    Scatter,
    Set,
    SineCosine,
    Store,
    VectorLet,
    VectorLoad,
    VectorStore,
    When,
    Write,
)
from lagrange.statement.vocabulary.elementary import ELEMENTARY

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
    found = _block(procedure.body, environment)
    return () if found is None else found


def _block(block: Block, known: Environment) -> Results | None:
    """Run statements; return the results if a statement ends the procedure, else None. `known` maps ids to values."""
    for statement in block:
        found = _STATEMENTS[type(statement)](statement, known)
        if found is not None:
            return found
    return None


def _let(let: Let, known: Environment) -> None:
    known[let.ref] = let.data if let.op == CONSTANT else OPERATIONS[let.op](*[known[arg] for arg in let.args])


def _sine_cosine(pair: SineCosine, known: Environment) -> None:
    for op, ref in (("sin", pair.sine), ("cos", pair.cosine)):
        angle, take = known[pair.angle], OPERATIONS[op]
        known[ref] = tuple(map(take, angle)) if isinstance(angle, tuple) else take(angle)


def _vector_let(let: VectorLet, known: Environment) -> None:
    args = [known[arg] for arg in let.args]
    if let.op == "permute":
        entries = [entry for arg in args for entry in (arg if isinstance(arg, tuple) else (arg,))]
        known[let.ref] = tuple(entries[place] for place in let.places)
    else:
        known[let.ref] = tuple(OPERATIONS[let.op](*entries) for entries in zip(*args, strict=True))


def _reduce(reduce: Reduce, known: Environment) -> None:
    entries = known[reduce.vector]
    if reduce.op == "entry":
        known[reduce.ref] = entries[reduce.place]
        return
    if reduce.op == "any":
        known[reduce.ref] = any(entries)
        return
    while len(entries) > 1:
        half = len(entries) // 2
        entries = tuple(a + b for a, b in zip(entries[:half], entries[half:], strict=True))
    known[reduce.ref] = entries[0]


def _vector_load(load: VectorLoad | Gather, known: Environment) -> None:
    array, number = known[load.array], float if load.vector.kind is REAL else int
    mask: Sequence[bool] = (True,) * load.vector.width if load.mask is None else known[load.mask]
    if isinstance(load, Gather):
        places = known[load.places]
    else:
        places = range(known[load.place], known[load.place] + load.vector.width)
    known[load.ref] = tuple(number(array[place] if read else 0) for place, read in zip(places, mask, strict=True))


def _vector_store(store: VectorStore, known: Environment) -> None:
    for k, value in enumerate(known[store.value]):
        if store.mask is None or known[store.mask][k]:
            known[store.array][known[store.place] + k] = value


def _scatter(scatter: Scatter, known: Environment) -> None:
    for place, value, written in zip(known[scatter.places], known[scatter.value], known[scatter.mask], strict=True):
        if written:
            known[scatter.array][place] = value


def _reserve(reserve: Reserve, known: Environment) -> None:
    size = (reserve.array.size or 0) + reserve.array.room
    known[reserve.ref] = Span([math.nan if reserve.array.kind is REAL else 0] * size)


def _reserve_record(reserve: ReserveRecord, known: Environment) -> None:
    known[reserve.ref] = reserve.record.structure()


def _part(part: Part, known: Environment) -> None:
    known[part.ref] = known[part.array].part(known[part.start])


def _load(load: Load, known: Environment) -> None:
    value = known[load.array][known[load.place]]
    known[load.ref] = float(value) if load.kind is REAL else int(value)


def _store(store: Store, known: Environment) -> None:
    known[store.array][known[store.place]] = known[store.value]


def _read(read: Read, known: Environment) -> None:
    value = getattr(known[read.record], read.field)
    known[read.ref] = value if isinstance(value, (int, float)) else tuple(value)


def _write(write: Write, known: Environment) -> None:
    setattr(known[write.record], write.field, known[write.value])


def _declare(declare: Declare, known: Environment) -> None:
    known[declare.ref] = known[declare.value]


def _get(get: Get, known: Environment) -> None:
    known[get.ref] = known[get.variable]


def _set(one: Set, known: Environment) -> None:
    known[one.variable] = known[one.value]


def _when(when: When, known: Environment) -> Results | None:
    return _block(when.then if known[when.condition] else when.otherwise, known)


def _loop(loop: Loop, known: Environment) -> Results | None:
    for index in range(known[loop.start], known[loop.stop], loop.step):
        known[loop.place] = index
        found = _block(loop.body, known)
        if found is not None:
            return found
    return None


def _repeat(repeat: Repeat, known: Environment) -> Results | None:
    while True:
        _block(repeat.test, known)
        if not known[repeat.condition]:
            return None
        found = _block(repeat.body, known)
        if found is not None:
            return found


def _each(each: Each, known: Environment) -> None:
    values: list[list[tuple[float, ...]]] = [[] for _ in each.folds]
    for index in range(known[each.iterations]):
        known[each.place] = index
        _block(each.body, known)
        for fold, collected in zip(each.folds, values, strict=True):
            collected.append(tuple(known[ref] for ref in (fold.value, fold.factor) if ref is not None))
    for fold, collected in zip(each.folds, values, strict=True):
        known[fold.ref] = _folded(fold, collected)


def _folded(fold: Fold, values: Sequence[tuple[float, ...]]) -> float:
    if fold.op not in SUMS:
        largest = fold.first
        for (value,) in values:
            largest = LARGER[fold.op](largest, value)
        return largest
    sums = [0.0] * PARTIAL
    for i, given in enumerate(values):
        before = sums[i % PARTIAL]
        sums[i % PARTIAL] = before + given[0] if fold.op == "add" else fused(given[0], given[1], before)
    return (sums[0] + sums[1]) + (sums[2] + sums[3])


def _call(call: Call, known: Environment) -> None:
    args = [known[arg] for arg in call.args]
    callee = call.callee
    if isinstance(callee, Procedure):
        results = run(callee, *args)
    else:
        found = known[callee](*args)
        results = found if len(call.refs) > 1 else (found,)[: len(call.refs)]
    known.update(zip(call.refs, results, strict=True))


def _leave(leave: Leave, known: Environment) -> Results:
    return tuple(known[value] for value in leave.values)


_STATEMENTS: Mapping[type, Callable[[Any, Environment], Results | None]] = {
    Let: _let,
    SineCosine: _sine_cosine,
    VectorLet: _vector_let,
    Reduce: _reduce,
    VectorLoad: _vector_load,
    Gather: _vector_load,
    VectorStore: _vector_store,
    Scatter: _scatter,
    Reserve: _reserve,
    ReserveRecord: _reserve_record,
    Part: _part,
    Load: _load,
    Store: _store,
    Read: _read,
    Write: _write,
    Declare: _declare,
    Get: _get,
    Set: _set,
    When: _when,
    Loop: _loop,
    Repeat: _repeat,
    Each: _each,
    Call: _call,
    Leave: _leave,
    Note: lambda note, known: None,
}


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
"""The function that returns the larger of two values, for each fold that is a maximum."""


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
        found = math.pow(a, b)
    except OverflowError:
        odd = b == math.floor(b) and math.fmod(b, 2.0) != 0.0
        return -math.inf if a < 0 and odd else math.inf
    except ValueError:
        if a == 0:
            odd = math.fmod(b, 2.0) in (1.0, -1.0)
            return math.copysign(math.inf, a) if odd else math.inf
        return math.nan
    return found


def _total(function: Callable[[float], float], *, pole: float = math.nan) -> Callable[[float], float]:
    """Return a function that never raises: NaN outside the domain, infinite on overflow, and `pole` at zero."""

    def value(x: float) -> float:
        try:
            return function(x)
        except OverflowError:
            return math.inf if x > 0 or function is math.cosh else -math.inf
        except ValueError:
            return pole if x == 0 else math.nan

    return value


def _round(x: float) -> float:
    return math.copysign(float(round(x)), x) if math.isfinite(x) else x


def _bits(x: float) -> int:
    return int(struct.unpack("<Q", struct.pack("<d", x))[0])


def _exponent(x: float) -> int:
    return (_bits(x) >> 52 & 2047) - 1023


def _mantissa(x: float) -> float:
    return float(struct.unpack("<d", struct.pack("<Q", _bits(x) & 2**52 - 1 | 1023 << 52))[0])


def _quotient(a: int, b: int) -> int:
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _atanh(x: float) -> float:
    """Return atanh(x), infinite at 1 and -1."""
    return math.copysign(math.inf, x) if abs(x) == 1 else _total(math.atanh)(x)


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _divide,
    "min": _min,
    "max": _max,
    "magnitude": _magnitude,
    "neg": lambda a: -a,
    "quotient": _quotient,
    "abs": abs,
    "sqrt": _total(math.sqrt),
    "sign": lambda a: 1.0 if a > 0 else -1.0 if a < 0 else a,
    **{one.name: _total(one.of_float, pole=one.pole) for one in ELEMENTARY.values()},
    "atan2": math.atan2,
    "copysign": math.copysign,
    "atanh": _atanh,
    "power": _power,
    "round": _round,
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
    "exponent": _exponent,
    "mantissa": _mantissa,
}
"""Every operation of the form on Python's numbers."""
