"""Every printer against the interpreter, to the last bit, on random procedures."""

from __future__ import annotations

import ctypes
import math
import struct
from typing import Any

import numpy as np
import pytest

from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind, Procedure
from lagrange.procedure.interpreter import run
from lagrange.procedure.verify import verify
from tests.procedure.random_procedures import FUNCTIONS, IN_MACHINE_CODE, KEPT, SIZE, RandomProcedure

EVERY = range(60)
SEEDS = range(60)
INPUTS = [(0.75, -1.5, 2), (math.nan, 1.0, 0), (-math.inf, 0.0, 7), (1e-308, 1e308, -3)]
DATA = [0.5, -1.25, 0.1, 0.0, -0.0, 1e200, -1e-200, 2.0, 7 / 3, -4.0, 1.0]
TABLE = np.array(DATA[::-1])


def bits(value: Any) -> Any:
    """Tell zeros apart; all NaN are one, for the form says nothing of their signs."""
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("<d", value)
    return value


def in_machine_code(procedure: Procedure, x: float, y: float, n: int, data: Any, kept: Any, *, optimize: bool) -> Any:
    text = module([procedure])
    kinds: dict[Kind, Any] = {REAL: ctypes.c_double, FLAG: ctypes.c_bool}
    result = ctypes.create_string_buffer(256)
    fields = [(f"r{i}", kinds.get(kind, ctypes.c_int64)) for i, kind in enumerate(procedure.results)]
    structure: Any = type("Results", (ctypes.Structure,), {"_fields_": fields})
    machine_types = ", ".join({REAL: "double", FLAG: "i1"}.get(kind, "i64") for kind in procedure.results)
    returned = "{" + machine_types + "}"
    wrapper = (
        f"{IN_MACHINE_CODE}"
        f"define void @wrapper(ptr %result, double %x, double %y, i64 %n, ptr %data, ptr %table, ptr %kept) {{\n"
        f"  %made = call {returned} @{procedure.name}(double %x, double %y, i64 %n, ptr %data, ptr %table, ptr %kept, "
        f"ptr @compare, ptr @replace, ptr @mark)\n"
        f"  store {returned} %made, ptr %result\n  ret void\n}}\n"
    )
    compiled = Module(text + wrapper, optimize=optimize)
    call = ctypes.CFUNCTYPE(
        None, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int64, *[ctypes.c_void_p] * 3
    )(compiled.address("wrapper"))
    call(ctypes.addressof(result), x, y, n, data.ctypes.data, TABLE.ctypes.data, ctypes.addressof(kept))
    found = structure.from_buffer(result)
    return tuple(getattr(found, name) for name, _ in fields)


def outcome(results: Any, data: Any, kept: Any) -> list[Any]:
    return [bits(value) for value in (*results, *map(float, data[:SIZE]), kept.x, kept.count)]


def memory() -> tuple[Any, Any]:
    return np.array([*DATA, *[0.0] * 8]), KEPT.structure(0.25, 3)


@pytest.mark.parametrize("optimize", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_machine_code_does_what_the_interpreter_does(seed: int, optimize: bool) -> None:
    procedure = RandomProcedure(seed, fused=True).build()
    for given in INPUTS:
        (data, kept), (other, held) = memory(), memory()
        expected = outcome(run(procedure, *given, data, TABLE, kept, *FUNCTIONS), data, kept)
        assert outcome(in_machine_code(procedure, *given, other, held, optimize=optimize), other, held) == expected


@pytest.mark.few
@pytest.mark.parametrize("seed", SEEDS)
def test_python_source_does_what_the_interpreter_does(seed: int) -> None:
    procedure = RandomProcedure(seed, fused=False).build()
    made = loaded(procedure)
    for given in INPUTS:
        (data, kept), (other, held) = memory(), memory()
        expected = outcome(run(procedure, *given, data, TABLE, kept, *FUNCTIONS), data, kept)
        plain = other.tolist()
        assert outcome(made(*given, plain, TABLE.tolist(), held, *FUNCTIONS), plain, held) == expected
        (view, kept), table = memory(), memoryview(TABLE.data)
        assert outcome(made(*given, memoryview(view.data), table, kept, *FUNCTIONS), view, kept) == expected


@pytest.mark.parametrize("count", [1, 3, 8, 11, None])
def test_products_that_are_added_up_are_rounded_once(count: int | None) -> None:
    """What is left of products that cancel is what rounding them takes, in vectors of four and one by one."""
    p = Builder("scalar_product", "The sum of products.")
    n, a, b = p.given("n", WHOLE), p.array("a", room=4, read=True), p.array("b", room=4, read=True)
    with p.each(n if count is None else count) as i:
        total = p.dot(a[i], b[i])
    p.leave(total.value)
    procedure = p.finish(REAL)
    small = [(3 + i) * 2.0**-30 for i in range(16)]
    numbers = [1 + x for x in small], [(-1) ** (i // 4) * (1 - x) for i, x in enumerate(small)]
    expected = run(procedure, 11, *numbers)[0]
    code = Module(module([procedure]), optimize=True)
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, *[ctypes.c_void_p] * 2)(code.address(procedure.name))
    one, other = (np.array(values) for values in numbers)
    assert call(11, one.ctypes.data, other.ctypes.data) == expected
    assert loaded(procedure)(11, *numbers) == pytest.approx(expected, abs=1e-15)


def test_random_procedures_have_every_statement() -> None:
    texts = [source(RandomProcedure(seed, fused=False).build()) for seed in EVERY]
    words = "for ", "while ", "else:", "_max(", "] * 4", " if ", ".x = ", "compare(", "replace(", "mark(", "exchange_"
    for word in words:
        assert any(word in text for text in texts)


def test_the_same_procedure_prints_the_same_text() -> None:
    for printer in (source, lambda procedure: module([procedure])):
        texts = {printer(RandomProcedure(7, fused=True).build()) for _ in range(3)}
        assert len(texts) == 1


def test_a_procedure_is_checked_when_it_is_built() -> None:
    for seed in range(10):
        verify(RandomProcedure(seed, fused=True).build())
