"""All ways to run plain procedures: as Python, interpreted, printed as Python, compiled."""

import importlib.util
import linecache
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from lagrange.errors import LagrangeError
from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.machine.llvm.procedures import INLINE_ANGLES
from lagrange.machine.python_source import loaded
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import (
    CONSTANT,
    REAL,
    WHOLE,
    Array,
    Block,
    Each,
    Let,
    Note,
    Parameter,
    Procedure,
    Statement,
    rebuilt,
    walk,
)
from lagrange.procedure.front import decorators
from lagrange.procedure.front.decorators import Plain, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, record
from lagrange.procedure.interpreter import run
from lagrange.procedure.visit import FIELDS, Visitor, defined, operands, visits
from tests.procedure.plain_functions import (
    Counter,
    Pair,
    Weights,
    applied,
    by_name,
    caller,
    gathered,
    scratch,
    several,
    sized,
    spliced,
)
from tests.procedure.random_functions import DATA, SIZE, TABLE, bits, example

WEIGHTS = Weights((1.0, 2.0, -0.5))


def flat(args: Any) -> list[Any]:
    """Return arguments with bundles replaced by their fields, as a procedure takes them."""
    return [
        item for arg in args for item in ((arg.source, arg.target, arg.length) if isinstance(arg, Pair) else (arg,))
    ]


def seen(results: Any, args: list[Any]) -> list[Any]:
    """Return all numbers after a call, with all NaN equal."""
    numbers = list(results) if isinstance(results, tuple) else [] if results is None else [results]
    for arg in flat(args):
        if isinstance(arg, np.ndarray):
            numbers += arg.tolist()
        elif hasattr(arg, "total"):
            numbers += [arg.total, arg.count]
    return ["nan" if x != x else float(x) for x in numbers]


def numbers(seed: int, size: int = 8) -> Any:
    rng = np.random.default_rng(seed)
    made = rng.standard_normal(size) * 10.0 ** rng.integers(-3, 4, size)
    made[rng.integers(0, size)] = 0.0
    return np.concatenate([made, np.zeros(8)])


def _record(stated: Any) -> Any:
    return stated.record


def _zeros(size: int) -> Any:
    return np.zeros(size)


CASES: dict[str, tuple[Plain[Any, Any], dict[str, Any], Callable[[int], list[Any]]]] = {
    "gathered": (gathered, {}, lambda s: [s, Pair(numbers(s), _zeros(16), s % 9), _record(Counter).structure(1.0, 2)]),
    "several": (several, {}, lambda s: [s % 8, numbers(s), np.zeros(8)]),
    "spliced": (spliced, {"weights": WEIGHTS, "twice": False}, lambda s: [s % 7, 0.25, numbers(s)]),
    "spliced twice": (spliced, {"weights": WEIGHTS, "twice": True}, lambda s: [s % 7, 0.25, numbers(s)]),
    "by name": (by_name, {"ops": ("mul", "max", "sub")}, lambda s: [0.3 * s, Pair(numbers(s), _zeros(16), 3)]),
    "scratch": (scratch, {}, lambda s: [s % 6, numbers(s), np.zeros(8)]),
    # Whole blocks: numbers of the last block beyond the size are undefined.
    "sized": (sized, {"size": 8, "with_tail": True}, lambda s: [np.zeros(11), np.zeros(1), 0.5 * s]),
    "caller": (caller, {}, lambda s: [7, numbers(s), np.zeros(16), np.zeros(2, dtype=np.int64)]),
}


def in_reverse(procedure: Procedure) -> Procedure:
    """Return a procedure whose `each` loops without reductions run from the last iteration to the first."""
    unused = count(max((ref for statement in walk(procedure.body) for ref in defined(statement)), default=0) + 1000)

    def reordered(block: Block) -> Block:
        return tuple(
            reverse(statement) if isinstance(statement, Each) and not statement.folds else rebuilt(statement, reordered)
            for statement in block
        )

    def reverse(each: Each) -> Each:
        one, last, index = (next(unused) for _ in range(3))
        first = (
            Let(one, WHOLE, CONSTANT, (), 1),
            Let(last, WHOLE, "sub", (each.iterations, one)),
            Let(each.place, WHOLE, "sub", (last, index)),
        )
        return each._replace(place=index, body=(*first, *each.body))

    return replace(procedure, body=reordered(procedure.body))


@pytest.mark.parametrize("name", CASES)
def test_a_plain_procedure_does_the_same_in_every_life(name: str) -> None:
    plain, known, make = CASES[name]
    form = plain.form(**known)
    compiled, printed = CompiledProcedure(form, optimize=True), loaded(form)
    for seed in range(6):
        args = [make(seed) for _ in range(5)]
        expected = seen(run(form, *flat(args[0])), args[0])
        assert seen(run(in_reverse(form), *flat(args[4])), args[4]) == expected
        assert seen(compiled(*flat(args[1])), args[1]) == expected
        # As it stands a function adds in Python's order, and printed Python rounds the product of `fma`.
        near = pytest.approx([x if isinstance(x, float) else 0.0 for x in expected], rel=1e-13, abs=1e-300)
        assert [x if isinstance(x, float) else 0.0 for x in seen(plain(*args[2], **known), args[2])] == near
        plain_text = printed(*[memoryview(a.data) if isinstance(a, np.ndarray) else a for a in flat(args[3])])
        assert [x if isinstance(x, float) else 0.0 for x in seen(plain_text, args[3])] == near


def test_a_function_that_is_given_is_called() -> None:
    def weigh(x: float, a: Any) -> float:
        return x * float(a[0])

    a = np.array([2.0, 3.0])
    assert run(applied.form(), weigh, 0.5, a) == (3.0,)
    assert applied(weigh, 0.5, a) == 3.0
    assert applied(weigh, -0.5, a) == run(applied.form(), weigh, -0.5, a)[0] == -1.0


def test_a_form_is_built_once_for_values_of_each_type() -> None:
    assert spliced.form(weights=WEIGHTS) is spliced.form(twice=False, weights=WEIGHTS)
    assert spliced.form(weights=WEIGHTS, twice=True).name == "spliced_twice"
    forms = {id(scaled.form(factor=factor)) for factor in (1, 1.0)}
    assert len(forms) == 2


@procedure
def scaled(x: float, *, factor: float) -> float:
    return x * factor


# --- refusals: each with the file, the line, the construct, and what to write


def _same(kind: Any, /) -> Any:
    return kind


def refused(function: Any, *words: str, **types: Any) -> None:
    """Assert that a function is refused with a message. `types` are the types of parameters without annotation."""
    given: dict[str, Any] = {name: partial(_same, kind) for name, kind in types.items()}
    declared = Plain(function, noinline=False, types=given)
    with pytest.raises(LagrangeError) as caught:
        declared.form()
    message = str(caught.value)
    assert len(message) < 500
    for word in words:
        assert word in message
    assert ", line " in message


def test_what_a_procedure_cannot_have_is_refused_with_its_place() -> None:
    def breaks(n: int) -> int:
        i = 0
        while i < n:
            break
        return i

    def raises(n: int) -> int:
        raise ValueError

    def grows(n: int, a: Out) -> None:
        values: list[float] = []
        for i in range(n):
            values.append(a[i])

    def chained(a: In) -> bool:
        return 0.0 < a[0] + 1.0 < 2.0

    refused(breaks, "`break`", "put the condition into the `while`")
    refused(raises, "`raise`", "return a status")
    refused(grows, "values.append(a[i])", "is not a procedure")
    refused(chained, "give it a name")


def test_a_name_that_is_read_where_it_is_not_set_is_refused() -> None:
    def behind_loop(n: int, a: In) -> float:
        for i in range(n):
            x = a[i]
        return x

    def behind_index(n: int) -> int:
        for i in range(n):
            n = n - i
        return i

    def one_branch(x: float) -> float:
        if x > 0.0:
            y = 1.0
        return y

    def rebound(n: int, a: In, b: In) -> float:
        c = a
        if n > 0:
            c = b
        return c[0]

    def known_set(n: int, a: In, b: In) -> float:
        pair = (a, 2)
        if n > 0:
            pair = (b, 4)
        return pair[0][0]

    refused(behind_loop, "`x` is read after the loop", "return x")
    refused(behind_index, "`i` is read after the loop")
    refused(one_branch, "`y` is read after the branch", "set it before")
    refused(rebound, "`c` is read after the branch")
    refused(known_set, "`pair` is read after the branch")


def test_what_an_each_cannot_have_is_refused() -> None:
    def temporary(n: int, a: Out) -> float:
        x = 1.0
        for i in each(n):
            a[i] = x
            x = a[i] * 2.0
        return x

    def branch(n: int, a: Out) -> None:
        for i in each(n):
            if a[i] > 0.0:
                a[i] = 0.0

    def shifted(n: int, a: Out) -> None:
        b = a[1:]
        for i in each(n):
            b[i] = a[i]

    def elsewhere(n: int, a: Out) -> None:
        for i in each(n):
            a[i + 1] = 1.0

    def loads(n: int, a: Out, b: In) -> None:
        for i in each(n):
            a[i] = b[i] if b[i] > 0.0 else 0.0

    def calls(n: int, a: Out) -> None:
        for i in each(n):
            a[i] = scaled(1.0, factor=2.0)

    def partial(n: int, a: In) -> float:
        total = 0.0
        for i in each(n):
            total += a[i]
            total = total * 2.0
        return total

    refused(temporary, "`x` is set by an `each`", "use `range`")
    refused(branch, "cannot contain `if`", "a if condition else b")
    refused(shifted, "other slices of an array", "disjoint=True")
    refused(elsewhere, "its own index")
    refused(loads, "loads", "a name first")
    refused(calls, "the call of scaled", "use `range`")
    refused(partial, "`total` is set by an `each`")


def test_numbers_of_another_kind_are_refused() -> None:
    def whole(x: float, n: int) -> float:
        return x + n

    def place(x: Any, a: In) -> float:
        value: float = a[x]
        return value

    def stores(n: int, a: Any) -> None:
        a[0] = 1.0

    def flags(x: Any) -> bool:
        value: bool = x and x > 1.0
        return value

    def divides(n: int) -> float:
        return n / 2

    def last(a: In) -> float:
        return a[-1]

    def variable(n: int) -> float:
        total: Any = 0
        for _ in range(n):
            total = total + 0.5
        return float(total)

    refused(whole, "x + n", "add cannot take real, whole")
    refused(place, "an index must be a whole number", "int(x)", x=REAL)
    refused(stores, "cannot be written", "Out", a=Array(read=True))
    refused(flags, "a condition must be true or false", x=REAL)
    refused(divides, "float(n)")
    refused(last, "from the end")
    refused(variable, "total")


def test_a_call_with_wrong_arguments_is_refused() -> None:
    def fewer(x: float) -> float:
        wrong: Any = scaled
        return float(wrong(factor=2.0))

    def unknown(x: float) -> float:
        return scaled(x, factor=x)

    def stranger(x: float) -> float:
        return float(np.hypot(x, x))

    refused(fewer, "scaled", "missing")
    refused(unknown, "factor", "known when")
    refused(stranger, "hypot", "@inline")
    with pytest.raises(LagrangeError, match="static parameters factor: give factor"):
        scaled.form()


def test_a_promise_that_parts_are_apart_is_taken() -> None:
    a = np.arange(12.0)
    run(exchanged.form(), 4, a)
    assert a.tolist() == [6, 7, 8, 9, 4, 5, 0, 1, 2, 3, 10, 11]


@procedure
def exchanged(n: int, a: Out) -> None:
    b = a[6:]
    for i in each(n, disjoint=True):
        a[i], b[i] = b[i], a[i]


@record
class Settings:
    """A record with numbers of a run."""

    rtol: float
    most: int


def test_a_record_is_the_same_in_python_and_in_memory() -> None:
    settings = Settings()
    assert (settings.rtol, settings.most) == (0.0, 0)
    assert [name for name, _ in _record(Settings).fields] == ["rtol", "most"]
    with pytest.raises(LagrangeError, match="use float or int"):

        @record
        class Wrong:
            name: str


# --- visit ----------------------------------------------------------------------------------------------------
# The visitor of statements: none is forgotten, and the table of fields says what a procedure reads and defines.


def test_a_visitor_that_forgets_statements_is_refused() -> None:
    with pytest.raises(TypeError, match="Forgetful has no method for Let, SineCosine, Reserve"):

        class Forgetful(Visitor):
            @visits(Note)
            def note(self, note: Note) -> None:
                pass


def test_the_table_has_every_statement_and_fields_that_it_has() -> None:
    kinds = get_args(Statement)
    assert tuple(FIELDS) == kinds
    for kind in kinds:
        assert set(FIELDS[kind].read) | set(FIELDS[kind].defined) <= set(kind._fields)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_read_is_defined_once(seed: int, tmp_path: Path) -> None:
    procedure = example(seed, tmp_path).form(option=True)
    made = [item.ref for item in procedure.parameters if isinstance(item, Parameter)]
    made += [ref for statement in walk(procedure.body) for ref in defined(statement)]
    assert len(made) == len(dict.fromkeys(made))
    # An entry of a fold is made inside its loop, which the loop itself reads.
    assert {ref for statement in walk(procedure.body) for ref in operands(statement)} <= set(made)


# --- random functions -----------------------------------------------------------------------------------------
# Random plain procedures: the interpreter, with loops in any order, and machine code agree.

INPUTS = [(0.75, -1.5, 2), (math.nan, 1.0, 0), (-math.inf, 0.0, 7), (1e-308, 1e308, -3)]


@pytest.mark.few(2)
@pytest.mark.parametrize("option", [False, True])
@pytest.mark.parametrize("seed", range(60))
def test_a_random_function_does_the_same_in_every_life(seed: int, option: bool, tmp_path: Path) -> None:
    """Half of the functions have no fused operation, which printed Python does not have."""
    fused = seed % 2 == 0
    plain = example(seed, tmp_path, fused=fused)
    kept_record, form = plain.function.__globals__["Kept"].record, plain.form(option=option)

    def outcome(call: Any, given: tuple[float, float, int], table: Any = None) -> list[Any]:
        data, kept = np.array([*DATA, *[0.0] * 8]), kept_record.structure(0.25, 3)
        arrays = (data, np.array(TABLE)) if table is None else (memoryview(data.data), table)
        x, whole, flag = call(*given, *arrays, kept)
        return [bits(float(x)), int(whole), bool(flag), *map(bits, data.tolist()[:SIZE]), bits(kept.x), kept.count]

    lives: dict[str, Callable[..., Any]] = {
        "loops in reverse": partial(run, in_reverse(form)),
        "machine code": CompiledProcedure(form),
        "optimized machine code": CompiledProcedure(form, optimize=True),
    }
    for given in INPUTS:
        expected = outcome(partial(run, form), given)
        for name, life in lives.items():
            assert outcome(life, given) == expected, name
        if not fused:
            assert outcome(loaded(form), given, memoryview(np.array(TABLE).data)) == expected


# --- sine cosine ----------------------------------------------------------------------------------------------
# The sine and cosine of an angle as one operation: the same in every life of a procedure.

ANGLES = (0.0, -0.0, 0.7, -2.5, 1e5, 3e7, -1e300, math.inf, math.nan)
"""Beyond 2**20 the machine takes the C library's functions."""


def pairs(count: int) -> Procedure:
    """Return a procedure that computes sine and cosine of an angle, and `count` - 1 other pairs that enter a sum."""
    p = Builder("pairs", "Return the sine and the cosine of x.")
    x = p.given("x", REAL)
    sine, cosine = p.sine_cosine(x)
    total = p.real(0.0)
    for k in range(1, count):
        other = p.sine_cosine(x * float(k))
        total = p.fnma(*other, total)
    p.leave(sine, cosine, total)
    return p.finish(REAL, REAL, REAL)


@pytest.mark.parametrize("count", [1, INLINE_ANGLES + 1], ids=["written out", "of a function"])
def test_every_life_has_the_sine_and_the_cosine(count: int) -> None:
    procedure = pairs(count)
    lives = partial(run, procedure), loaded(procedure), CompiledProcedure(procedure)
    for x in ANGLES:
        finite = math.isfinite(x)
        expected = (math.sin(x), math.cos(x)) if finite else (math.nan, math.nan)
        for life in lives:
            result = life(x)
            # The machine's own sine and the C library's are each right to less than a unit in the last place.
            assert result[:2] == pytest.approx(expected, rel=2.0**-51, abs=0.0, nan_ok=True)
            assert math.copysign(1.0, result[0]) == math.copysign(1.0, expected[0]) or not finite


# --- stored functions -----------------------------------------------------------------------------------------
# Rewritten functions stored beside byte code: the next process uses them, unless a source has changed.


SOURCE = """
from lagrange.procedure.front.decorators import procedure

@procedure
def doubled(x: float) -> float:
    return x * 2.0
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a module in a new package, for which functions are stored."""
    monkeypatch.setattr(decorators, "PACKAGE", tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    path = tmp_path / "module.py"
    path.write_text(SOURCE)
    return path


def doubled(source: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the function of a module, imported as in a new process."""
    monkeypatch.setattr(decorators, "_STORED", {})
    linecache.clearcache()
    decorators._module.cache_clear()
    spec = importlib.util.spec_from_file_location(source.stem, source)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.doubled


def stored(source: Path) -> Path:
    return next((source.parent / "__pycache__").glob("*.plain"))


def test_the_next_process_reads_no_source(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = doubled(source, monkeypatch).form()
    function = doubled(source, monkeypatch)
    monkeypatch.setattr(decorators, "source_of", None)
    assert function.form().body == expected.body
    assert run(function.form(), 3.0) == (6.0,)


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: content[:40] + b"?" + content[41:]])
def test_a_damaged_file_is_ignored_and_replaced(damage: Any, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doubled(source, monkeypatch).form()
    content = stored(source).read_bytes()
    stored(source).write_bytes(damage(content))
    assert run(doubled(source, monkeypatch).form(), 3.0) == (6.0,)
    assert stored(source).read_bytes() == content


def test_a_change_of_the_source_counts(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doubled(source, monkeypatch).form()
    source.write_text(SOURCE.replace("2.0", "14.0"))
    assert run(doubled(source, monkeypatch).form(), 3.0) == (42.0,)


def test_a_folder_that_cannot_be_written_to_is_no_error(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (source.parent / "__pycache__").write_text("")
    assert doubled(source, monkeypatch).form().name == "doubled"
