"""What a series costs is counted from its vectors, and orders and forms follow: counted here from its code as well."""

from __future__ import annotations

import re
from functools import cache

import pytest

from lagrange.algorithm.series.cost import MOST_OPERATIONS, is_large, operations
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.series.llvm_driver import CompiledJet
from lagrange.program.taylor import series_program
from tests.models import SYSTEMS
from tests.series_systems import LARGER

NAMES = ("double pendulum", "Kepler orbit", "Henon-Heiles", "elastic pendulum", "blocks")


@cache
def packing(name: str, lanes: int = 8) -> Packing:
    return pack(series_program(euler_lagrange({**LARGER, **SYSTEMS}[name]()))[0], lanes)


def written(name: str, order: int) -> int:
    """Return how many operations on doubles the code of the series has that is written out."""
    ir = CompiledJet(packing(name), order).ir
    jet = ir[ir.index("@taylor_jet(") :]
    jet = jet[: jet.index("\n}")]
    return len(re.findall(r" f(?:add|sub|mul|div) |@llvm\.fma", jet))


@pytest.mark.parametrize("order", [8, 16])
@pytest.mark.parametrize("name", NAMES)
def test_operations_are_those_of_the_code(name: str, order: int) -> None:
    """0.82 to 1.07 of the count were found in the code, which shares what order 0 has in common with a mass matrix."""
    assert 0.75 < written(name, order) / operations(packing(name), order) < 1.15


def test_a_series_is_written_out_up_to_so_many_operations() -> None:
    for name in NAMES:
        for order in range(4, 33):
            assert is_large(packing(name), order) == (operations(packing(name), order) > MOST_OPERATIONS)
    assert not is_large(packing("double pendulum"), 32)
