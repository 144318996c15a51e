"""The lives of plain procedures: as Python, in exact arithmetic, interpreted, printed as Python, compiled."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from lagrange.errors import LagrangeError
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Kind, Procedure
from lagrange.procedure.front.plain import Plain, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, record
from lagrange.procedure.interpreter import run
from tests.procedure.plain_functions import (
    Counter,
    Pair,
    Weights,
    applied,
    arithmetic,
    by_name,
    caller,
    gathered,
    guarded,
    scratch,
    several,
    signs,
    sized,
    spliced,
)

WEIGHTS = Weights((1.0, 2.0, -0.5))
C_TYPES: dict[Kind, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64, FLAG: ctypes.c_bool}


def flat(args: Any) -> list[Any]:
    """Write bundles out, as a procedure takes them."""
    return [one for arg in args for one in ((arg.source, arg.target, arg.length) if isinstance(arg, Pair) else (arg,))]


def machine_code(form: Procedure) -> Callable[..., Any]:
    """Return the compiled procedure as a function of its arguments."""
    types = {REAL: "double", WHOLE: "i64", FLAG: "i1"}
    results = ", ".join(types[kind] for kind in form.results)
    kinds = [one.type if isinstance(one.type, Kind) else None for one in form.parameters]
    takes = ", ".join(f"{types[kind] if kind else 'ptr'} %a{i}" for i, kind in enumerate(kinds))
    returned = f"{{{results}}}" if len(form.results) > 1 else results
    text = f"define void @wrapper(ptr %result, {takes}) {{\n  %r = call {returned} @{form.name}({takes})\n"
    text += f"  store {returned} %r, ptr %result\n  ret void\n}}\n"
    compiled = Module(module([form]) + text, optimize=True)
    c_types = [C_TYPES[kind] if kind else ctypes.c_void_p for kind in kinds]
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, *c_types)(compiled.address("wrapper"))
    fields = [(f"r{i}", C_TYPES[kind]) for i, kind in enumerate(form.results)]
    structure: Any = type("Results", (ctypes.Structure,), {"_fields_": fields, "code": compiled})

    def run_compiled(*args: Any) -> Any:
        found = structure()
        places = [arg.ctypes.data if isinstance(arg, np.ndarray) else arg for arg in args]
        call(
            ctypes.addressof(found),
            *[ctypes.addressof(one) if isinstance(one, ctypes.Structure) else one for one in places],
        )
        return tuple(getattr(found, name) for name, _ in fields)

    return run_compiled


def seen(results: Any, args: list[Any]) -> list[Any]:
    """Return all numbers that a call leaves; all NaN are one."""
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
    "signs": (signs, {}, lambda s: [6, numbers(s), np.zeros(8)]),
    "gathered": (gathered, {}, lambda s: [s, Pair(numbers(s), _zeros(16), s % 9), _record(Counter).structure(1.0, 2)]),
    "several": (several, {}, lambda s: [s % 8, numbers(s), np.zeros(8)]),
    "guarded": (guarded, {}, lambda s: [s % 8, np.abs(numbers(s)) if s % 3 == 0 else numbers(s), np.zeros(8)]),
    "spliced": (spliced, {"weights": WEIGHTS, "twice": False}, lambda s: [s % 7, 0.25, numbers(s)]),
    "spliced twice": (spliced, {"weights": WEIGHTS, "twice": True}, lambda s: [s % 7, 0.25, numbers(s)]),
    "by name": (by_name, {"ops": ("mul", "max", "sub")}, lambda s: [0.3 * s, Pair(numbers(s), _zeros(16), 3)]),
    "arithmetic": (arithmetic, {}, lambda s: [s * 7 - 25, s - 3 or 2, s * 0.7 - 1.0]),
    "scratch": (scratch, {}, lambda s: [s % 6, numbers(s), np.zeros(8)]),
    # Whole blocks: numbers of the last block beyond the size are undefined.
    "sized": (sized, {"size": 8, "with_tail": True}, lambda s: [np.zeros(11), np.zeros(1), 0.5 * s]),
    "caller": (caller, {}, lambda s: [7, numbers(s), np.zeros(16), np.zeros(2, dtype=np.int64)]),
}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", CASES)
def test_a_plain_procedure_does_the_same_in_every_life(name: str, seed: int) -> None:
    plain, known, make = CASES[name]
    form = plain.form(**known)
    args = [make(seed) for _ in range(6)]
    expected = seen(run(form, *flat(args[0])), args[0])
    assert seen(plain.exactly(*args[1], **known), args[1]) == expected
    assert seen(plain.exactly(*args[2], seed=seed, **known), args[2]) == expected
    assert seen(machine_code(form)(*flat(args[3])), args[3]) == expected
    # As it stands a function adds in Python's order, and printed Python rounds the product of `fma`.
    near = pytest.approx([x if isinstance(x, float) else 0.0 for x in expected], rel=1e-13, abs=1e-300)
    assert [x if isinstance(x, float) else 0.0 for x in seen(plain(*args[4], **known), args[4])] == near
    plain_text = loaded(form)(*[memoryview(a.data) if isinstance(a, np.ndarray) else a for a in flat(args[5])])
    assert [x if isinstance(x, float) else 0.0 for x in seen(plain_text, args[5])] == near


def test_a_function_that_is_given_is_called() -> None:
    def weigh(x: float, a: Any) -> float:
        return x * float(a[0])

    a = np.array([2.0, 3.0])
    assert run(applied.form(), weigh, 0.5, a) == (3.0,)
    assert applied(weigh, 0.5, a) == applied.exactly(weigh, 0.5, a) == 3.0
    assert applied(weigh, -0.5, a) == run(applied.form(), weigh, -0.5, a)[0] == -1.0


def test_a_form_is_built_once_for_values_of_each_type() -> None:
    assert spliced.form(weights=WEIGHTS) is spliced.form(twice=False, weights=WEIGHTS)
    assert spliced.form(weights=WEIGHTS, twice=True).name == "spliced_twice"
    forms = {id(scaled.form(factor=factor)) for factor in (1, 1.0)}
    assert len(forms) == 2


@procedure
def scaled(x: float, *, factor: float) -> float:
    return x * factor


def test_comments_and_names_are_printed() -> None:
    text = source(commented.form())
    assert "# Half of it." in text
    assert "half = x * 0.5" in text


@procedure
def commented(x: float) -> float:
    # Half of it.
    half = x * 0.5
    return half + x


# --- refusals: each with the file, the line, the construct, and what to write


def _same(kind: Any, /) -> Any:
    return kind


def refused(function: Any, *words: str, **types: Any) -> None:
    """Check the message for a function; `types` are those of parameters that Python's checker does not see."""
    given: dict[str, Any] = {name: partial(_same, kind) for name, kind in types.items()}
    declared = Plain(function, apart=False, types=given)
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

    refused(behind_loop, "`x` is read behind the loop", "return x")
    refused(behind_index, "`i` is read behind the loop")
    refused(one_branch, "`y` is read behind the branch", "first value")
    refused(rebound, "`c` is read behind the branch")
    refused(known_set, "`pair` is read behind the branch")


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
    refused(branch, "no branches", "a if condition else b")
    refused(shifted, "other parts of an array", "disjoint=True")
    refused(elsewhere, "own index")
    refused(loads, "loads", "a name first")
    refused(calls, "calls scaled", "use `range`")
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

    refused(whole, "x + n", "add takes no real, whole")
    refused(place, "a place is a whole number", "int(x)", x=REAL)
    refused(stores, "only read", "Out", a=Array(read=True))
    refused(flags, "a condition is true or false", x=REAL)
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
    with pytest.raises(LagrangeError, match="factor is missing"):
        scaled.form()


def test_a_parameter_of_another_type_is_refused() -> None:
    def untyped(x: str) -> float:
        return float(x)

    with pytest.raises(LagrangeError, match="not a type of a parameter"):
        procedure(untyped).form()


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
    """Numbers of a run."""

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
