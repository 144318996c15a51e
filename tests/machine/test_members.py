"""Procedures for many members at once: each member has the bits of the interpreter for this member alone."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.procedure.form import REAL, Procedure, Record
from lagrange.procedure.interpreter import run
from lagrange.procedure.lane_values import UNIFORM, VARYING
from lagrange.procedure.lanes import ACTIVE, MemberProcedures
from tests.procedure.random_functions import DATA, SIZE, TABLE, bits, example
from tests.procedure.verify import verify

NUMBERS = (0.75, -1.5, math.nan, 1.0, -math.inf, 0.0, 1e-308, 1e308, -0.0, 3.25)


def interleaved(rows: Any) -> np.ndarray[Any, Any]:
    """Return the rows of all members in the order of machine code."""
    return np.ascontiguousarray(np.array(rows).T)


def interpreted(entry: Procedure) -> Any:
    """Return an entry procedure in the interpreter as a function of numbers and arrays."""

    def call(*arguments: Any) -> None:
        arrays: list[Any] = [item.ravel() if isinstance(item, np.ndarray) else item for item in arguments]
        records = [item.type.structure if isinstance(item.type, Record) else None for item in entry.parameters]
        pairs = zip(arrays, records, strict=True)
        run(entry, *[item if record is None else record.from_buffer(item) for item, record in pairs])

    return call


def in_lanes(procedure: Procedure, members: Any, lanes: int, active: int, life: str, *, own_n: bool) -> Any:
    """Run members side by side; return the results of each with its data and record."""
    xs, ys = (np.array([member[k] for member in members], dtype=float) for k in (0, 1))
    ns = np.array([member[2] for member in members], dtype=np.int64)
    data = interleaved([[*DATA, *[0.0] * 8] for _ in members])
    kept = np.zeros((2, lanes))
    kept[0], kept.view(np.int64)[1] = 0.25, 3
    shares = {
        "x": VARYING,
        "y": VARYING,
        "n": VARYING if own_n else UNIFORM,
        "data": VARYING,
        "table": UNIFORM,
        "kept": VARYING,
    }
    memory = {"x": xs, "y": ys, "n": ns, "data": data, "table": np.array(TABLE), "kept": kept}
    signature = tuple(shares[item.name] for item in procedure.parameters)
    entry = MemberProcedures(lanes).entry(procedure, signature)
    for item in (*entry.callees, entry):
        verify(item)
    results = [np.zeros(lanes, dtype=float if kind is REAL else np.int64) for kind in procedure.results]
    memory |= {f"result{k}": row for k, row in enumerate(results)}
    memory[ACTIVE] = np.array([active >> k & 1 for k in range(lanes)])
    given = [int(ns[0]) if item.name == "n" and not own_n else memory[item.name] for item in entry.parameters]
    call = interpreted(entry) if life == "interpreter" else CompiledProcedure(entry, optimize=life == "optimized")
    call(*given)
    result = []
    for k in range(lanes):
        values: list[Any] = [row[k].item() for row in results]
        after = [*map(float, data[:SIZE, k]), float(kept[0, k]), int(kept.view(np.int64)[1, k])]
        result.append([bits(item) for item in (*values, *after)])
    return result


def alone(procedure: Procedure, member: Any) -> list[Any]:
    """Run a member in the interpreter."""
    (structure,) = (item.type.structure for item in procedure.parameters if isinstance(item.type, Record))
    data, kept = [*DATA, *[0.0] * 8], structure(0.25, 3)
    given = {"x": member[0], "y": member[1], "n": member[2], "data": data, "table": TABLE, "kept": kept}
    results = run(procedure, *(given[item.name] for item in procedure.parameters))
    plain = [
        int(item) if kind is not REAL else float(item) for item, kind in zip(results, procedure.results, strict=True)
    ]
    return [bits(item) for item in (*plain, *map(float, data[:SIZE]), kept.x, kept.count)]


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("seed", range(60))
def test_each_member_gives_what_it_gives_alone(seed: int, lanes: int, tmp_path: Path) -> None:
    """Half of the procedures also run in the interpreter, which has no vectors."""
    procedure = example(seed, tmp_path).form(option=seed % 3 == 0)
    draw = random.Random(seed)
    for own_n in (True, False):
        whole = draw.randrange(-3, 8)
        members = [
            (draw.choice(NUMBERS), draw.choice(NUMBERS), draw.randrange(-3, 8) if own_n else whole)
            for _ in range(lanes)
        ]
        active = draw.randrange(1, 2**lanes)
        for life in ("plain", "interpreter") if seed % 2 else ("optimized",):
            result = in_lanes(procedure, members, lanes, active, life, own_n=own_n)
            for k, member in enumerate(members):
                if active >> k & 1:
                    assert result[k] == alone(procedure, member), (life, k, member)
