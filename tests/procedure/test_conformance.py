"""Every printer against the interpreter, to the last bit, on random procedures."""

from __future__ import annotations

import ctypes
import itertools
import math
import struct
from typing import Any

import numpy as np
import pytest

from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.form import FLAG, REAL, Kind, Procedure
from lagrange.procedure.interpreter import run
from lagrange.procedure.verify import verify
from tests.procedure.random_procedures import KEPT, SIZE, RandomProcedure

SEEDS = range(60)
INPUTS = [(0.75, -1.5, 2), (math.nan, 1.0, 0), (-math.inf, 0.0, 7), (1e-308, 1e308, -3)]
DATA = [0.5, -1.25, 3.0, 0.0, -0.0, 1e200, -1e-200, 2.0, 7.5, -4.0, 1.0]
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
        f"define void @wrapper(ptr %result, double %x, double %y, i64 %n, ptr %data, ptr %table, ptr %kept) {{\n"
        f"  %made = call {returned} @{procedure.name}(double %x, double %y, i64 %n, ptr %data, ptr %table, ptr %kept)\n"
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
        expected = outcome(run(procedure, *given, data, TABLE, kept), data, kept)
        assert outcome(in_machine_code(procedure, *given, other, held, optimize=optimize), other, held) == expected


@pytest.mark.parametrize("seed", SEEDS)
def test_python_source_does_what_the_interpreter_does(seed: int) -> None:
    procedure = RandomProcedure(seed, fused=False).build()
    made = loaded(procedure)
    for given in INPUTS:
        (data, kept), (other, held) = memory(), memory()
        expected = outcome(run(procedure, *given, data, TABLE, kept), data, kept)
        plain = other.tolist()
        assert outcome(made(*given, plain, TABLE.tolist(), held), plain, held) == expected


def test_random_procedures_have_every_statement() -> None:
    texts = [source(RandomProcedure(seed, fused=False).build()) for seed in SEEDS]
    for word in ("for ", "while ", "else:", "_max(", "] * 4", " if ", ".x = "):
        assert any(word in text for text in texts)


def test_the_same_procedure_prints_the_same_text() -> None:
    for printer in (source, lambda procedure: module([procedure])):
        texts = {printer(RandomProcedure(7, fused=True).build()) for _ in range(3)}
        assert len(texts) == 1


def test_a_procedure_is_checked_when_it_is_built() -> None:
    for seed in itertools.islice(SEEDS, 10):
        verify(RandomProcedure(seed, fused=True).build())
