"""The plan of a linear system: the order of its blocks, and the signs of its pivots."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from sympy import Abs, Piecewise, cos, exp, sin

from lagrange.compiler import machine, model_of, reached
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.equations.regularity import check_regularity
from lagrange.equations.solve_plan import (
    NestedCofactors,
    SolvePlan,
    coupled,
    elimination_order,
    has_large_block,
    plan_of,
    vanishes,
)
from lagrange.equations.structure import Structure
from lagrange.equations.terms import TooLargeError
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.program.elimination import elimination
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from tests.models import M, c, k, l, laws, m, omega, phi, r, stated, theta, x, y, z
from tests.refusals import refusal
from tests.series_systems import HELD, quaternion


def test_the_plan_of_a_matrix_and_its_factors() -> None:
    graph = Graph()
    a, b, c = (graph.symbol(name, Binding.CONFIGURATION) for name in "abc")
    p, zero = graph.symbol("p", Binding.PARAMETER), graph.zero
    plan = plan_of([[a, zero, b], [zero, p, zero], [b, zero, c]])
    assert plan == SolvePlan(((0, 2), (1,)), moving=True) and plan.inverted and not plan.diagonal and plan.size == 3
    assert plan.triangle == ((0, 0), (2, 0), (2, 2), (1, 1))
    assert plan_of([[p]]) == SolvePlan(((0,),), moving=False)
    matrix: list[list[Node]] = [[a, b], [b, c]]
    once = [*plan_of(matrix).solved(matrix, [a, p]), *plan_of(matrix).solved(matrix, [b, c])]
    assert len([node for node in reachable(once) if node.kind is Kind.FACTOR]) == 1


def test_many_right_hand_sides_read_the_matrix_once() -> None:
    """A Jacobian of 294 coordinates has 588 right-hand sides, and its matrix 86,436 entries."""

    class Row(list[Node]):
        reads = 0

        def __getitem__(self, place: Any) -> Any:
            Row.reads += 1
            return super().__getitem__(place)

    graph, n = Graph(), 12
    matrix = [Row(graph.constant(2) if i == j else graph.zero for j in range(n)) for i in range(n)]
    solve = SolvePlan(tuple((i,) for i in range(n)), moving=False).solver(matrix)
    before = Row.reads
    right = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n)]
    assert solve(right) == [node / 2 for node in right] and Row.reads == before


# --- Systems whose inertia comes from constraints: what is solved is definite, and means the same ---


def test_only_a_singular_mass_matrix_is_augmented() -> None:
    for name, make in HELD.items():
        laws = euler_lagrange(make())
        assert (laws.motion.momenta == laws.momenta) == (name != "quaternion")


def test_the_mass_matrix_of_a_quaternion_is_definite_as_it_is_solved() -> None:
    model = model_of(quaternion(), machine("numpy"))
    laws, n = model.equations, model.dimension
    rng = np.random.default_rng(1)
    nodes = tuple(laws.matrix[i][j] for i in range(n) for j in range(n))
    for _ in range(10):
        state = np.concatenate([rng.normal(size=n), np.zeros(n)])
        solved = model.function("matrix", nodes)(0.0, state, model.parameter_array()).reshape(n, n)
        stated_so = model.mass_matrix(state[:n])
        values = np.linalg.eigvalsh(solved)
        assert values[0] > 1e-2 * values[-1]
        assert abs(np.linalg.eigvalsh(stated_so)[0]) < 1e-13 * values[-1]


# --- The order of elimination, and which entries factors have ---


def pattern(rng: np.random.Generator, n: int, m: int) -> np.ndarray:
    """Return the nonzero pattern of [[M, G^T], [G, 0]]; each row of G has an entry."""
    mass = rng.random((n, n)) < 1.5 / n
    border = rng.random((m, n)) < 2 / n
    border[np.arange(m), rng.integers(0, n, m)] = True
    return np.block([[mass | mass.T | np.eye(n, dtype=bool), border.T], [border, np.zeros((m, m), dtype=bool)]])


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(0, 6))
def test_a_multiplier_waits_for_its_coordinates(seed: int, n: int, m: int) -> None:
    there = pattern(np.random.default_rng(seed), n, m)
    neighbours = [np.flatnonzero(row).tolist() for row in there]
    order = elimination_order(range(n + m), neighbours, range(n, n + m))
    assert sorted(order) == list(range(n + m))
    at = {unknown: place for place, unknown in enumerate(order)}
    assert all(at[j] < at[i] for i in range(n, n + m) for j in neighbours[i])


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(0, 6))
def test_the_places_of_the_factors_are_those_that_fill_in(seed: int, n: int, m: int) -> None:
    """With random numbers, the nonzero entries of L are at these positions and nowhere else."""
    rng = np.random.default_rng(seed)
    there = pattern(rng, n, m)
    a = np.where(there, rng.uniform(0.5, 1.5, there.shape), 0.0)
    a = a + a.T + np.diag([*np.full(n, 4.0 * (n + m)), *np.full(m, -4.0 * (n + m))])
    lower = np.zeros_like(a)
    for j in range(n + m):
        lower[j:, j] = a[j:, j] / a[j, j]
        a[j:, j:] -= np.outer(lower[j:, j], a[j, j:].copy())
    entries = frozenset((i, j) for i, j in zip(*np.nonzero(np.tril(there | np.eye(n + m, dtype=bool))), strict=True))
    plan = elimination(n + m, frozenset((int(i), int(j)) for i, j in entries))
    assert set(plan.places) == {(int(i), int(j)) for i, j in zip(*np.nonzero(lower), strict=True)}
    assert sorted((i, j) for j, column in enumerate(plan.columns) for i in column) == [
        (i, j) for i, j in plan.places if i != j
    ]


def shuffled_ladder(loops: int, seed: int) -> tuple[list[list[int]], frozenset[int]]:
    """Return the neighbours in the system of a ladder of point masses, in a random order, and its multipliers."""
    count = 4 * loops + 3
    name = np.random.default_rng(seed).permutation(count).tolist()
    neighbours: list[list[int]] = [[] for _ in range(count)]

    def couple(a: int, b: int) -> None:
        neighbours[name[a]].append(name[b])
        if a != b:
            neighbours[name[b]].append(name[a])

    coordinates = range(2 * loops + 2)
    for a in coordinates:
        couple(a, a)
        couple(2 * loops + 2 + a // 2, a)
    for i in range(loops):
        for a in range(2 * i, 2 * i + 4):
            couple(3 * loops + 3 + i, a)
    return neighbours, frozenset(name[2 * loops + 2 :])


def test_the_order_of_the_statement_does_not_matter() -> None:
    """The number of operations, the bandwidth and the depth do not depend on the order, up to ties."""
    for loops in (10, 40):
        operations, heights = [], []
        for seed in range(6):
            neighbours, multipliers = shuffled_ladder(loops, seed)
            order = elimination_order(range(len(neighbours)), neighbours, multipliers)
            at = {unknown: place for place, unknown in enumerate(order)}
            there = frozenset((max(at[i], at[j]), min(at[i], at[j])) for i, row in enumerate(neighbours) for j in row)
            plan = elimination(len(order), there, tuple(sorted(at[i] for i in multipliers)))
            height = [0] * plan.order
            for i, row in enumerate(plan.rows):
                height[i] = max((height[k] + 1 for k in row), default=0)
            operations.append(plan.operations)
            heights.append(max(height))
            assert plan.band <= 8
        assert max(operations) <= 1.15 * min(operations)
        assert max(operations) <= 36 * loops and max(heights) <= 8 * np.log2(loops)


# --- A mass matrix without an inverse is refused, with the motion without inertia ---


def checked(statement: Statement) -> None:
    check_regularity(euler_lagrange(statement), statement, reached)


NO_TERM = "the Lagrangian has no term of second order in {0}.dot, so {0} has no inertia"
SINGULAR = "the mass matrix d2L/dv2 is singular"
SLIDING, STRING = m * (x.dot - y.dot) ** 2 / 2, m * (x.dot + y.dot) ** 2 / 2 + m * (y.dot + z.dot) ** 2 / 2


@pytest.mark.parametrize(
    ("given", "coordinates", "words"),
    [
        ({"lagrangian": x.dot * sin(x) - x**2}, [x], ["Add the kinetic energy of x, or make x a parameter."]),
        ({"lagrangian": m * x.dot**2 / 2 + y.dot * sin(x) - k * y**2}, [x, y], [NO_TERM.format("y")]),
        ({"kinetic": (x.dot + y.dot) ** 2}, [x, y], ["Add the kinetic energy that is missing, use fewer coordinat"]),
        ({"kinetic": SLIDING + M * z.dot**2 + theta.dot**2}, [z, x, theta, y], ["x.dot = 1, y.dot = 1 has no inertia"]),
        ({"kinetic": STRING}, [x, y, z], ["x.dot = 1, y.dot = -1, z.dot = 1 has no inertia"]),
        ({"kinetic": m * (x.dot * cos(x) + y.dot * sin(y)) ** 2}, [x, y], [SINGULAR, "a motion with x.dot = "]),
    ],
)
def test_a_motion_without_inertia_is_named(given: dict[str, Any], coordinates: list[Any], words: list[str]) -> None:
    message = refusal(checked, stated(**given, coordinates=coordinates))
    assert all(word in message for word in words)
    assert len(coordinates) < 4 or not {"z.dot", "theta.dot"} & set(message.split())


@pytest.mark.parametrize(
    "kinetic",
    [
        m * sin(x) ** 2 * y.dot**2 / 2 + m * x.dot**2 / 2,
        m * (x.dot + y.dot) ** 2 / 2 + M * x**2 * y.dot**2,
        m * (x.dot + y.dot) ** 2 / 2 + M * sp.Float("1e-9") * y.dot**2,
        x.dot * y.dot * m,
        sp.Float("1e-12") * x.dot**2 + sp.Float("5e-10") * x.dot * y.dot + sp.Float("1e12") * y.dot**2,
        # Defined nowhere that is looked at: there is no verdict.
        sp.Piecewise((m * (x.dot + y.dot) ** 2 / 2 + m * x.dot**2, x > 100)),
    ],
)
def test_singular_somewhere_and_units_that_differ_are_no_reason_to_refuse(kinetic: Any) -> None:
    checked(stated(kinetic=kinetic, coordinates=[x, y]))


def chain_matrix(n: int) -> list[list[sp.Expr]]:
    """Return the mass matrix of a chain of n links, in angles to the vertical."""
    a = sp.symbols(f"a:{n}")
    return [[(n - max(i, j)) * cos(a[i] - a[j]) for j in range(n)] for i in range(n)]


@pytest.mark.slow
def test_a_small_determinant_of_many_links_is_not_zero() -> None:
    matrix = chain_matrix(24)
    assert not vanishes(matrix)
    assert vanishes([*matrix[:-1], matrix[0]])


def test_cofactors_of_a_chain_of_rods_are_refused_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    n = 30
    entries = sp.symbols(f"s:{n}")
    band = [[entries[min(i, j)] if abs(i - j) <= 2 else sp.S.Zero for j in range(n)] for i in range(n)]
    monkeypatch.setattr("lagrange.equations.solve_plan.MOST_MINORS", 50)
    with pytest.raises(TooLargeError):
        NestedCofactors(band, [sp.S.One] * n, 10**100).solution()


@pytest.mark.parametrize(("size", "large"), [(11, False), (12, True)])
def test_a_block_without_zeros_is_too_large_from_twelve_on(size: int, large: bool) -> None:
    full = [[True] * size + [False] for _ in range(size)] + [[False] * size + [True]]
    assert has_large_block(full) is large
    full[0][1] = full[1][0] = False
    assert not has_large_block(full)


# --- structure ------------------------------------------------------------------------------------------------
# The structure of a system: all findings with their sentences, and the blocks of random matrices.


def structure(name: str) -> Structure:
    return laws(name).structure


FINDINGS = {
    #                     blocks           constant separable autonomous forced cyclic position_only
    "pendulum": (((0,),), True, True, True, False, (), True),
    "double pendulum": (((0, 1),), False, False, True, False, (), False),
    "elastic pendulum": (((0,), (1,)), False, False, True, False, (), False),
    "spherical pendulum": (((0,), (1,)), False, False, True, False, (1,), False),
    "cart and pole": (((0, 1),), False, False, True, True, (), False),
    "charge": (((0,), (1,), (2,)), True, False, True, False, (), False),
    "8 carried masses": ((tuple(range(8)),), True, True, True, False, (), True),
    "saddle": (((0, 1), (2,)), True, True, True, False, (), True),
    "friction": (((0,), (1,)), True, True, True, True, (), False),
}


@pytest.mark.parametrize("name", FINDINGS)
def test_findings(name: str) -> None:
    result = structure(name)
    assert (
        result.blocks,
        result.constant_mass,
        result.decisions.separable,
        result.decisions.timeless,
        result.forced,
        result.cyclic,
        result.position_only,
    ) == FINDINGS[name]
    assert result.conservative == (not result.forced)


FREE = {"kinetic": m * (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y]}


@pytest.mark.parametrize(
    ("parts", "cyclic"),
    [
        ({**FREE, "potential": k * x}, (1,)),
        ({**FREE, "potential": k * x, "forces": {y: c}}, ()),
        ({**FREE, "dissipation": c * y.dot**2}, (0,)),
        ({"kinetic": r.dot**2 + r**2 * phi.dot**2, "forces": {r: -k * r}, "coordinates": [r, phi]}, (1,)),
        ({**FREE, "kinetic": m * (x.dot + y.dot) ** 2 + m * (x.dot - y.dot) ** 2}, (0, 1)),
    ],
)
def test_a_coordinate_with_a_force_on_it_is_not_cyclic(parts: dict[str, Any], cyclic: tuple[int, ...]) -> None:
    result = euler_lagrange(stated(**parts)).structure
    assert result.cyclic == cyclic and result.blocks == ((0,), (1,))


def test_a_mass_that_depends_on_time_is_not_constant() -> None:
    assert not euler_lagrange(stated(kinetic=m * (1 + t) * theta.dot**2 * l)).structure.constant_mass


@pytest.mark.parametrize(
    ("force", "brief"),
    [
        (cos(3 * t) * x + t**2 * sin(omega * t), False),
        (k * exp(x) + Piecewise((x, x < 1), (1, True)), False),
        (Piecewise((1, t < 1), (0, True)), True),
        (1 / (1 + 100 * (t - 50) ** 2), True),
        (Abs(t - 1) * x, True),
    ],
)
def test_a_force_that_may_act_briefly(force: Any, brief: bool) -> None:
    assert euler_lagrange(stated(kinetic=m * x.dot**2 / 2, forces={x: force})).structure.brief is brief
    assert euler_lagrange(stated(kinetic=m * x.dot**2 / 2, potential=force * x)).structure.brief is brief


def test_sentences_for_the_user() -> None:
    assert structure("Henon-Heiles").sentences()[:2] == [
        "The mass matrix is diagonal and constant.",
        "The momenta depend on velocities alone: all else in the Lagrangian acts as a potential.",
    ]
    assert structure("spherical pendulum").sentences() == [
        "The mass matrix is diagonal and changes along the motion.",
        "The momenta depend on more than the velocities: the Lagrangian does not separate.",
        "Nothing depends on time explicitly and no force acts besides the potential: the energy is conserved.",
        "phi does not appear in L: it is cyclic, so p_phi is conserved.",
    ]
    assert structure("double pendulum").sentences()[0] == (
        "The mass matrix couples all coordinates and changes along the motion."
    )
    assert structure("coupled masses").sentences()[0] == "The mass matrix couples all coordinates and is constant."
    assert structure("saddle").sentences()[0] == "The mass matrix falls into blocks (x, y) and (z) and is constant."
    assert structure("cart and pole").sentences()[2] == "The energy is not conserved: forces or dissipation act."
    both = euler_lagrange(stated(kinetic=m * x.dot**2 / 2, potential=k * x * cos(t), forces={x: c * x.dot}))
    assert both.structure.sentences()[2] == (
        "The energy is not conserved: the Lagrangian depends on time and forces or dissipation act."
    )


def test_what_constraints_leave() -> None:
    result = {name: euler_lagrange(HELD[name]()).structure for name in ("1 rod", "3 rods", "sleigh")}
    assert result["1 rod"].sentences()[2] == (
        "The constraint constraint_1 leaves 1 of 2 velocities free. Its forces do no work."
    )
    assert " and constraint_3 leave 3 of 6 velocities free. Their forces do no work." in result["3 rods"].sentences()[2]
    assert result["sleigh"].sentences()[2:4] == [
        "The constraint blade leaves 2 of 3 velocities free.",
        "The energy was not found to be conserved: constraints that depend on time, or on velocities other than in "
        "proportion, may do work.",
    ]
    assert result["3 rods"].conservative and not result["sleigh"].conservative
    bent = stated(kinetic=x.dot**2 + y.dot**2, coordinates=[x, y], constraints={"speed": x.dot**2 + y.dot**2 - 1})
    assert euler_lagrange(bent).structure.sentences()[3] == (
        "The constraint speed is not linear in the velocities: its force is along its derivative in the velocities "
        "(Chetaev's rule)."
    )


@given(st.integers(1, 9), st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=9))
def test_blocks_are_the_connected_groups(n: int, pairs: list[tuple[int, int]]) -> None:
    full = np.eye(n, dtype=bool)
    for i, j in pairs:
        if i < n and j < n:
            full[i, j] = full[j, i] = True
    reached = np.linalg.matrix_power(full.astype(int), n) > 0
    expected = sorted({tuple(np.flatnonzero(row)) for row in reached})
    assert sorted(coupled([np.flatnonzero(row).tolist() for row in full])) == expected
