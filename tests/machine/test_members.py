"""Procedures for many members at once: each member gives what the interpreter gives for it alone, to the last bit."""

from __future__ import annotations

import ctypes
import math
import random
from typing import Any

import numpy as np
import pytest

from lagrange.machine.llvm.engine import Module
from lagrange.machine.members.module import members_module
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.interpreter import run
from lagrange.procedure.rewrite import bound
from lagrange.procedure.spread import COMMON, OWN, Spreads
from tests.procedure import random_procedures
from tests.procedure.random_procedures import KEPT, SIZE, RandomProcedure
from tests.procedure.test_conformance import DATA, TABLE, bits

NUMBERS = (0.75, -1.5, math.nan, 1.0, -math.inf, 0.0, 1e-308, 1e308, -0.0, 3.25)


def functions() -> dict[str, Procedure]:
    """The functions of random procedures, as procedures."""
    p = Builder("compare", "The difference, and whether it is below zero.")
    a, b = p.given("a", REAL), p.given("b", REAL)
    p.leave(a - b, a - b < 0.0)
    compare = p.finish(REAL, FLAG)
    p = Builder("replace", "Put a number at the first place.")
    x, data = p.given("x", REAL), p.array("data")
    data[0] = x
    p.leave(x < 0.0)
    replace = p.finish(FLAG)
    p = Builder("mark", "Put a whole number at the second place, or not.")
    flag, n, data = p.given("flag", FLAG), p.given("n", WHOLE), p.array("data")
    with p.when(flag):
        data[1] = p.real(n)
    return {"compare": compare, "replace": replace, "mark": p.finish()}


def interleaved(rows: Any) -> np.ndarray[Any, Any]:
    """Return the rows of all members as machine code has them."""
    return np.ascontiguousarray(np.array(rows).T)


def in_lanes(procedure: Procedure, members: Any, lanes: int, active: int, *, optimize: bool, own_n: bool) -> Any:
    """Run members side by side; return the results of each with its data and record."""
    xs, ys = (np.array([member[k] for member in members], dtype=float) for k in (0, 1))
    ns = np.array([member[2] for member in members], dtype=np.int64)
    data = interleaved([[*DATA, *[0.0] * 8] for _ in members])
    kept = np.zeros((2, lanes))
    kept[0], kept.view(np.int64)[1] = 0.25, 3
    shares = {"x": OWN, "y": OWN, "n": OWN if own_n else COMMON, "data": OWN, "table": COMMON, "kept": OWN}
    memory = {"x": xs, "y": ys, "n": ns, "data": data, "table": TABLE, "kept": kept}
    signature = tuple(shares[one.name] for one in procedure.parameters)
    code = Module(members_module(procedure, signature, lanes), optimize=optimize)
    results = np.zeros((len(procedure.results), lanes))
    given: list[Any] = []
    for one in procedure.parameters:
        by_value = one.name == "n" and not own_n
        given.append(ctypes.c_int64(int(ns[0])) if by_value else ctypes.c_void_p(memory[one.name].ctypes.data))
    call = ctypes.CFUNCTYPE(None, ctypes.c_int64, *map(type, given), ctypes.c_void_p)(code.address(procedure.name))
    call(active, *given, results.ctypes.data)
    found, differing = [], Spreads().of(procedure, signature).results
    for k in range(lanes):
        values: list[Any] = []
        for kind, row, own in zip(procedure.results, results, differing, strict=True):
            place = k if own else 0
            values.append(float(row[place]) if kind is REAL else int(row.view(np.int64)[place]))
        after = [*map(float, data[:SIZE, k]), float(kept[0, k]), int(kept.view(np.int64)[1, k])]
        found.append([bits(one) for one in (*values, *after)])
    return found


def alone(procedure: Procedure, member: Any) -> list[Any]:
    """Run a member in the interpreter."""
    data, kept = [*DATA, *[0.0] * 8], KEPT.structure(0.25, 3)
    given = {"x": member[0], "y": member[1], "n": member[2], "data": data, "table": TABLE, "kept": kept}
    results = run(procedure, *(given[one.name] for one in procedure.parameters))
    plain = [int(one) if kind is not REAL else float(one) for one, kind in zip(results, procedure.results, strict=True)]
    return [bits(one) for one in (*plain, *map(float, data[:SIZE]), kept.x, kept.count)]


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("seed", range(60))
def test_each_member_gives_what_it_gives_alone(seed: int, lanes: int) -> None:
    procedure = bound(RandomProcedure(seed, fused=True).build(), functions())
    draw = random.Random(seed)
    for own_n in (True, False):
        whole = draw.randrange(-3, 8)
        members = [
            (draw.choice(NUMBERS), draw.choice(NUMBERS), draw.randrange(-3, 8) if own_n else whole)
            for _ in range(lanes)
        ]
        active = draw.randrange(1, 2**lanes)
        found = in_lanes(procedure, members, lanes, active, optimize=seed % 2 == 0, own_n=own_n)
        for k, member in enumerate(members):
            if active >> k & 1:
                assert found[k] == alone(procedure, member), (k, member)


def test_whole_numbers_change_their_signs() -> None:
    p = Builder("change", "Minus a whole number.")
    n, data = p.given("n", WHOLE), p.array("data")
    data[0] = p.real(-n)
    procedure = p.finish()
    members = [(0.0, 0.0, n) for n in (-3, 0, 1, 2**40)]
    found = in_lanes(procedure, members, len(members), 15, optimize=False, own_n=True)
    assert [row[0] for row in found] == [bits(float(-n)) for *_, n in members]


@pytest.fixture(autouse=True)
def _no_signs_of_nan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what copies the sign of a NaN, of which the form says nothing."""
    monkeypatch.setattr(random_procedures, "REAL_BINARY", ("add", "sub", "mul", "div", "min", "max", "magnitude"))
