"""The equations of motion as nodes agree with SymPy's derivatives and with each other, and need little code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange
from lagrange.equations.euler_lagrange import Equations, StateLayout, euler_lagrange
from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Kind, reachable
from lagrange.program.catalogue import QUANTITIES, program_of
from lagrange.statement.coordinate import acceleration_of
from lagrange.statement.statement import Statement
from tests.evidence.stand_in import StandIn
from tests.models import SYSTEMS, chain, laws, model

SMALL = [name for name in SYSTEMS if name not in ("chain of 7", "8 carried masses", "blocks")]


def numbers(statement: Statement, seed: int) -> tuple[Any, Any, float]:
    rng = np.random.default_rng(seed)
    n = len(statement.coordinates)
    return rng.uniform(0.3, 1.2, n), rng.uniform(-1.0, 1.0, n), 0.6


@pytest.mark.few(4)
@pytest.mark.parametrize("name", SMALL)
def test_every_quantity_is_what_sympy_derives(name: str) -> None:
    statement = SYSTEMS[name]()
    book, compiled = StandIn(statement), model(name, "numpy")
    q, v, time = numbers(statement, 5)
    for quantity in ("lagrangian", "energy", "momenta", "forces", "bias", "mass_matrix"):
        expected = book.evaluate(quantity, q, v, time)
        assert compiled.evaluate(quantity, q, v, time) == pytest.approx(expected, rel=1e-11, abs=1e-12), quantity
    M, h = compiled.evaluate("mass_matrix", q, v, time), compiled.evaluate("bias", q, v, time)
    assert M @ compiled.accelerations(q, v, time) == pytest.approx(h, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_mass_matrix_is_symmetric_to_the_node(name: str) -> None:
    equations = laws(name)
    n = len(equations.q)
    assert all(equations.mass[i][j] is equations.mass[j][i] for i in range(n) for j in range(n))


def test_a_constant_mass_matrix_leaves_no_bias_beyond_the_forces() -> None:
    for name in ("oscillator", "Henon-Heiles", "Kepler orbit", "coupled masses", "8 carried masses", "saddle"):
        assert laws(name).bias == laws(name).forces
    assert laws("double pendulum").bias != laws("double pendulum").forces


def test_translate_knows_accelerations_and_refuses_strangers() -> None:
    equations = laws("pendulum")
    theta = SYSTEMS["pendulum"]().coordinates[0]
    assert equations.translate(acceleration_of(theta)) is equations.accelerations[0]
    with pytest.raises(StatementError, match="Symbol in 'stranger' is not supported"):
        equations.translate(sp.Symbol("stranger"))


def size(equations: Equations, name: str) -> int:
    return len(program_of(name, equations).instructions)


def test_the_work_grows_mildly_with_the_length_of_a_chain() -> None:
    """Each link adds one row of M and of the elimination, so the work grows quadratically."""
    sizes = {n: size(euler_lagrange(chain(n)), "rhs") for n in (3, 6, 12)}
    assert sizes[12] < 4.5 * sizes[6] < 4.5 * 4.5 * sizes[3]
    assert sizes[12] < 12 * 12 * 6


def test_nothing_of_zero_is_computed() -> None:
    equations = laws("charge")
    program = program_of("rhs", equations)
    assert not any(instruction.op in ("factor", "solve") for instruction in program.instructions)
    zeros = [i for i in program.instructions if i.op == "constant" and i.value == 0]
    assert not zeros


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_quantity_of_the_equations_reads_nothing_it_may_not(name: str) -> None:
    equations = laws("double pendulum")
    nodes = [node for block in QUANTITIES[name].results(equations).values() for node in block]
    highest = max(node.binding for node in nodes)
    assert highest <= (Binding.CONFIGURATION if name == "mass_matrix" else Binding.VELOCITY)


def test_blocks_are_solved_each_alone() -> None:
    factors = [node for node in reachable(laws("blocks").accelerations) if node.kind is Kind.FACTOR]
    assert sorted(node.data for node in factors) == [(2, ()), (2, ())]
    assert laws("blocks").structure.blocks == ((0, 2), (1, 3), (4,))


# --- Where the parts of a state stand: read from the layout, and nowhere taken for halves ---


PACKAGE = Path(lagrange.__file__).parent
HALVES = re.compile(r"len\((y|y0|names|state\.y)\) // 2|shape\[\d\] // 2|np\.split\(\w+, 2\)|\.states // 2")


def test_parts_of_different_sizes() -> None:
    """Parts may have different numbers of coordinates and rates, such as a quaternion and three rates."""
    layout = StateLayout(("a", "b", "c", "d"), ("x", "y", "z"))
    q, v = layout.split(np.arange(7.0))
    assert layout.size == 7 and q.tolist() == [0, 1, 2, 3] and v.tolist() == [4, 5, 6]
    assert layout.names() == ("a", "b", "c", "d", "x_dot", "y_dot", "z_dot")
    assert layout.names(".dot")[4:] == ("x.dot", "y.dot", "z.dot")


def test_programs_read_the_state_as_it_is_laid_out() -> None:
    equations = laws("cart and pole")
    sizes = [len(range(*rows.indices(equations.layout.size))) for rows in (equations.layout.q, equations.layout.v)]
    assert [block.size for block in program_of("rhs", equations).inputs] == sizes == [2, 2]
    assert equations.rate == equations.v and list(equations.state) == ["q", "v"]


def test_nothing_that_runs_or_shows_takes_a_state_for_two_halves() -> None:
    result = [
        f"{path.relative_to(PACKAGE)}:{number}"
        for folder in ("trajectory", "evidence", "show", "machine/kernel")
        for path in sorted((PACKAGE / folder).rglob("*.py"))
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if HALVES.search(line)
    ]
    assert not result
    assert HALVES.search("n = len(y0) // 2") and HALVES.search("q, v = np.split(after, 2)")
