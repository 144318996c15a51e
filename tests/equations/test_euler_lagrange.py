"""Equations of motion as nodes, with and without constraints, and what is said about conservation."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
import sympy as sp
from sympy import Abs, Max, Piecewise, Rational, cos, cosh, exp, sign, sin, sinh, sqrt, tan

import lagrange
import lagrange as lg
from lagrange.equations import decisions, textbook_algebra
from lagrange.equations.derivation import derive
from lagrange.equations.euler_lagrange import Equations, StateLayout, euler_lagrange
from lagrange.equations.structure import Structure
from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Kind, reachable
from lagrange.program.catalogue import QUANTITIES, program_of
from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from tests.evidence.statements import StandIn
from tests.models import SYSTEMS, c, chain, k, laws, model, r, stated
from tests.refusals import refusal

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
    assert "Symbol in 'stranger' is not supported" in refusal(equations.translate, sp.Symbol("stranger"))


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


# --- derivations with constraints: Euler-Lagrange equations with multipliers, and constraint forces ------------


m, g, l, a, R, I, J, omega = lg.parameters("m g l a R I J omega")
x, y, z, phi, psi = lg.coordinates("x y z phi psi")
rod, roll, side = lg.multiplier("rod"), lg.multiplier("roll"), lg.multiplier("side")

PENDULUM: dict[str, Any] = {
    "kinetic": m * (x.dot**2 + y.dot**2) / 2,
    "potential": m * g * y,
    "constraints": {"rod": x**2 + y**2 - l**2},
}
DISC: dict[str, Any] = {
    "kinetic": m * (x.dot**2 + y.dot**2) / 2 + I * phi.dot**2 / 2 + J * psi.dot**2 / 2,
    "potential": 0,
    "coordinates": [x, y, phi, psi],
    "constraints": {"roll": x.dot - R * phi.dot * cos(psi), "side": y.dot - R * phi.dot * sin(psi)},
}


def test_multipliers_stand_on_the_right() -> None:
    derivation = derive(declare(**PENDULUM))
    assert [(law.lhs, law.rhs) for law in derivation.equations] == [
        (m * x.ddot, 2 * rod * x),
        (m * y.ddot + m * g, 2 * rod * y),
    ]
    assert [(law.lhs, law.rhs) for law in derivation.constraints] == [(x**2 + y**2 - l**2, 0)]
    assert derivation.constraint_forces == {"rod": {x: 2 * rod * x, y: 2 * rod * y}}


def test_tension_of_the_rod_as_in_the_book() -> None:
    derivation = derive(declare(**PENDULUM))
    radius = x**2 + y**2
    assert sympy.expand(derivation.multipliers["rod"] * 2 * radius) == sympy.expand(m * (g * y - x.dot**2 - y.dot**2))
    assert str(derivation.accelerations[x]).startswith("(g*y(t) - Derivative(x(t), t)**2")


def test_rolling_needs_no_more_than_the_disc_turns() -> None:
    derivation = derive(declare(**DISC))
    rights = [law.rhs for law in derivation.equations]
    assert rights == [roll, side, -R * roll * cos(psi) - R * side * sin(psi), 0]
    assert derivation.accelerations[x] == -R * phi.dot * psi.dot * sin(psi)
    assert derivation.multipliers["side"] == m * R * phi.dot * psi.dot * cos(psi)


def test_constraints_that_move_have_their_second_rate_in_the_accelerations() -> None:
    derivation = derive(declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, constraints={"lift": y - a * sin(omega * lg.t)}))
    assert derivation.accelerations == {x: 0, y: -a * omega**2 * sin(omega * lg.t)}
    assert derivation.multipliers["lift"] == -m * a * omega**2 * sin(omega * lg.t)


def test_forces_of_a_constraint_that_is_not_linear_follow_chetaev() -> None:
    stated = declare(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        potential=m * g * z,
        constraints={"appell": x.dot**2 + y.dot**2 - a**2 * z.dot**2},
    )
    exerted = derive(stated).constraint_forces["appell"]
    appell = lg.multiplier("appell")
    assert exerted == {x: 2 * appell * x.dot, y: 2 * appell * y.dot, z: -2 * a**2 * appell * z.dot}


def test_a_coordinate_without_inertia_that_a_constraint_holds_is_solved_for() -> None:
    derivation = derive(declare(kinetic=m * x.dot**2 / 2, coordinates=[x, y], constraints={"tie": y - 2 * x}))
    assert derivation.accelerations == {x: 0, y: 0}


def test_multipliers_are_refused_with_the_accelerations_where_they_are_too_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(textbook_algebra, "LONGEST_FORMULA", 3)
    monkeypatch.setattr(textbook_algebra, "EXPANDED_WITH_MULTIPLIERS", 0)
    for part in ("accelerations", "multipliers"):
        assert "too large for the solved accelerations to be wr" in refusal(getattr, derive(declare(**PENDULUM)), part)


@pytest.mark.parametrize("expanded", [0, 6])
def test_constraints_that_depend_on_one_another_have_no_formula(expanded: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(textbook_algebra, "EXPANDED_WITH_MULTIPLIERS", expanded)
    stated = declare(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, constraints={"first": x - 2 * y, "second": 4 * y - 2 * x}
    )
    assert refusal(lambda: derive(stated).accelerations) == (
        "the accelerations of x and y and the multipliers of first and second are not determined by a formula, at any "
        "state: the constraints depend on one another, or a motion that they allow has no inertia. Drop a constraint "
        "that follows from the others, or add the kinetic energy that is missing."
    )


# --- forces with multipliers, such as Coulomb friction, compared with closed forms and with a direct elimination ---


theta = lg.coordinate("theta")

mu, slope, L = lg.parameters("mu slope L")
NORMAL, WALL = lg.multiplier("floor"), lg.multiplier("wall")


def incline(**more: Any) -> lg.System:
    stated = {"forces": {x: -mu * NORMAL * sign(x.dot)}, "constraints": {"floor": y}, "initial": {x.dot: 1.5}, **more}
    return lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        m * g * (y * cos(slope) - x * sin(slope)),
        coordinates=[x, y],
        parameters={m: 2, g: 9.81, mu: 0.2, slope: 0.6},
        name="incline",
        **stated,
    )


METHODS = ("taylor", "dopri5", "tsit5", "verner9", "dop853", "bs3", "radau5", "radau5-index2", "scipy-radau")


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_a_block_slides_down_with_every_adaptive_method(method: str) -> None:
    run = incline().run(2.0, method=method)
    pull = 9.81 * (np.sin(0.6) - 0.2 * np.cos(0.6))
    assert abs(run.final["x"] - (3 + 2 * pull)) <= 1e-7  # the tolerance of a run is 1e-9, a few steps add up
    assert abs(run.final["x_dot"] - (1.5 + 2 * pull)) <= 1e-7
    np.testing.assert_allclose(run.evaluate(NORMAL), 2 * 9.81 * np.cos(0.6), rtol=1e-12)


def test_a_page_shows_the_multiplier_and_accelerations_without_it() -> None:
    page = incline().derivation()
    assert page.equations[0].rhs == -mu * NORMAL * sign(x.dot)
    assert page.equations[1].rhs == NORMAL
    assert page.multipliers == {"floor": g * m * cos(slope)}
    assert sympy.expand(page.accelerations[x] - g * (sin(slope) - mu * cos(slope) * sign(x.dot))) == 0


@pytest.mark.slow
def test_forces_with_multipliers_are_checked() -> None:
    assert incline().check()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_random_systems_solve_the_bordered_equations(seed: int) -> None:
    random = np.random.default_rng(seed)

    def draw() -> Any:
        return Rational(int(random.integers(-9, 10)), 11)

    def stated(**more: Any) -> lg.System:
        return lg.System(
            kinetic,
            potential,
            coordinates=[x, y, z, theta],
            constraints={"floor": z - sin(x) * y, "turn": theta.dot - x.dot * cos(y) - z * y.dot},
            name=f"random {seed}",
            **more,
        )

    speeds = [q.dot for q in (x, y, z, theta)]
    kinetic = sum(q**2 for q in speeds) + sum(draw() * a * b / 4 for a in speeds for b in speeds)
    kinetic += (x * theta.dot) ** 2 + draw() * y.dot
    potential = g * z + draw() * x * theta + y**2
    held = [NORMAL, lg.multiplier("turn")]
    pushes = [[draw() * sin(x) * y.dot / 2, draw() * z / 2 + draw() / 3] for _ in range(4)]
    others = [draw() * y.dot, draw() * x, 0, -draw() * theta.dot]
    forces = [q + sum(a * b for a, b in zip(row, held, strict=True)) for q, row in zip(others, pushes, strict=True)]
    rough = stated(forces=dict(zip((x, y, z, theta), forces, strict=True)), parameters={g: 2})
    smooth = stated(forces=dict(zip((x, y, z, theta), others, strict=True)), parameters={g: 2})
    model, plain = rough.compile("numpy"), smooth.compile("numpy")
    q, v = random.normal(size=4), random.normal(size=4)
    values = dict(zip((x, y, z, theta, *speeds), map(float, (*q, *v)), strict=True))
    b = np.array(sympy.Matrix(pushes).subs(values, simultaneous=True).tolist(), dtype=float)
    gradient = plain.evaluate("constraint_gradient", q, v)
    border = np.block([[plain.mass_matrix(q, v=v), -(gradient.T + b)], [gradient, np.zeros((2, 2))]])
    right = [*plain.evaluate("bias", q, v), *-plain.evaluate("constraint_bias", q, v)]
    expected = np.linalg.solve(border, right)
    result = [*model.accelerations(q, v), *model.multipliers(q, v)]
    # Both solve in doubles, by other eliminations of a matrix with a condition below 1e3.
    np.testing.assert_allclose(result, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"forces": {x: -mu * abs(NORMAL)}}, "the force on x is not linear in lambda[floor]: give a coef"),
        (
            {"forces": {x: -mu * sqrt(NORMAL**2 + WALL**2)}, "constraints": {"floor": y, "wall": x - y}},
            "the force on x is not linear in lambda[floor] and lambda[wall]: give a coefficient in coordinates, "
            "velocities and parameters times a multiplier, such as -mu*lambda[floor]*sign(x.dot), and end",
        ),
        ({"forces": {x: lg.multiplier("flor")}}, "a force contains lambda[flor], but the constraint is floor."),
        ({"dissipation": NORMAL * x.dot**2}, "the dissipation contains lambda[floor], the multiplier of a constraint"),
        ({"forces": {y: -NORMAL}}, "the multipliers of incline are not determined: its constraints depend on"),
        ({"redundant": "allow"}, "the forces of incline contain multipliers, which redundant constraints"),
        (
            {"dimensions": {m: "mass", g: "m/s**2", x: "m", y: "m", mu: "1"}, "forces": {x: -mu * NORMAL * x.dot}},
            "the force on x",
        ),
    ],
)
def test_refusals(more: Any, words: str) -> None:
    assert refusal(incline, **more).startswith(words)


def test_forces_whose_multipliers_cancel_in_a_sum_are_seen() -> None:
    # With x = y the forces lambda/2 and -lambda/2 change the multiplier alone.
    pair = lg.System(
        x.dot**2 + y.dot**2 / 2,
        g * x,
        coordinates=[x, y],
        constraints={"bar": x - y},
        forces={x: lg.multiplier("bar") / 2, y: -lg.multiplier("bar") / 2},
        parameters={g: 3},
    )
    assert dict(pair.accelerations()) == {x: -g / 3, y: -g / 3}
    np.testing.assert_allclose(pair.compile("numpy").multipliers([0.0, 0.0], [0.0, 0.0]), [3 / 4.5])


def test_a_coordinate_without_inertia_follows_a_constraint() -> None:
    # lambda = x from the equation of y, so that 2 x'' = -y - lambda + lambda/2 = -3 x/2.
    bound = lg.System(x.dot**2, x * y, coordinates=[x, y], constraints={"floor": y - x}, forces={x: NORMAL / 2})
    model = bound.compile("numpy")
    np.testing.assert_allclose(model.accelerations([0.4, 0.4], [0.0, 0.0]), [-0.3, -0.3], rtol=1e-14)
    np.testing.assert_allclose(model.multipliers([0.4, 0.4], [0.0, 0.0]), [0.4], rtol=1e-14)


def test_a_coordinate_of_first_order_that_a_multiplier_pushes_is_refused() -> None:
    with pytest.raises(StatementError, match=r"the forces of system contain multipliers, and its mass matrix d2L"):
        lg.System(
            x.dot**2 + y.dot**2,
            coordinates=[x, y, z],
            constraints={"floor": y - x},
            forces={z: NORMAL},
            dissipation=z.dot**2,
        )


def chain_on_a_rough_rail(links: int) -> lg.System:
    """Return a cart on a rough rail with a chain of pendulums; its multiplier depends on all angles."""
    angles = lg.coordinates(" ".join(f"a_{i}" for i in range(1, links + 1)))
    place, kinetic, potential = (x, y), lg.kinetic_energy(m, (x, y)), lg.gravity(m, (x, y), g)
    for angle in angles:
        place = place[0] + sin(angle), place[1] - cos(angle)
        kinetic, potential = kinetic + lg.kinetic_energy(m, place), potential + lg.gravity(m, place, g)
    return lg.System(
        kinetic,
        potential,
        constraints={"floor": y},
        forces={x: -mu * NORMAL * sign(x.dot)},
        parameters={m: 1, g: 9.81, mu: 0.1},
        initial={x.dot: 3.0, **dict.fromkeys(angles, 0.3)},
        name="chain",
    )


@pytest.mark.slow
def test_a_long_multiplier_is_no_obstacle_where_its_parts_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The multiplier of a chain of five has 21,512 operations without sharing, and was refused."""
    model = chain_on_a_rough_rail(5).compile("numpy", check=False)
    q, v = np.split(np.array(model.statement.initial), 2)
    assert model.evaluate("constraint_forces", q, v).ravel()[1] == pytest.approx(model.multipliers(q, v)[0])
    monkeypatch.setattr("lagrange.equations.regularity.MOST_WRITTEN_OPERATIONS", 100)
    with pytest.raises(StatementError, match=r"multipliers in the forces of chain have .* operations when written out"):
        chain_on_a_rough_rail(2)


# --- statements on the conservation of energy and momenta are right for all formulations of a system -----------


ON_SPHERE = (l * sin(theta) * cos(phi), l * sin(theta) * sin(phi), -l * cos(theta))
ON_HOOP = (l * sin(theta) * cos(omega * t), l * sin(theta) * sin(omega * t), -l * cos(theta))
IN_PLANE = (r * cos(phi), r * sin(phi))
ON_CONE = (*IN_PLANE, r / tan(c))
BODY_RATES = (
    phi.dot * sin(theta) * sin(psi) + theta.dot * cos(psi),
    phi.dot * sin(theta) * cos(psi) - theta.dot * sin(psi),
    phi.dot * cos(theta) + psi.dot,
)
FREE = {"kinetic": m * (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y]}
ROD = {**FREE, "constraints": {"rod": x**2 + y**2 - 1}}


def laws_of(**parts: Any) -> Equations:
    return euler_lagrange(stated(**parts))


def found(**parts: Any) -> Structure:
    return laws_of(**parts).structure


def moving(position: Any, potential: Any) -> dict[str, Any]:
    return {"kinetic": lg.kinetic_energy(m, position), "potential": potential}


STATED_BY_POSITIONS = {
    "sphere": (moving(ON_SPHERE, m * g * ON_SPHERE[2]), "phi"),
    "hoop": (moving(ON_HOOP, m * g * ON_HOOP[2]), ""),
    "central force": (moving(IN_PLANE, -k / sqrt(IN_PLANE[0] ** 2 + IN_PLANE[1] ** 2)), "phi"),
    "cone": (moving(ON_CONE, m * g * ON_CONE[2]), "phi"),
    "top": ({"kinetic": lg.rotational_energy((k, k, c), BODY_RATES), "potential": m * g * l * cos(theta)}, "phi psi"),
    "hyperbola": ({"kinetic": m * y.dot**2 * (cosh(x) ** 2 - sinh(x) ** 2) + m * x.dot**2, "potential": k * x}, "y"),
    "half angles": ({"kinetic": m * x.dot**2 * (cos(phi) - 2 * cos(phi / 2) ** 2 + 2) + m * phi.dot**2}, "phi x"),
}


@pytest.mark.parametrize("name", STATED_BY_POSITIONS)
def test_what_cancels_is_not_there(name: str) -> None:
    parts, ignorable = STATED_BY_POSITIONS[name]
    structure = found(**parts)
    assert structure.conservative and structure.decisions.timeless is True
    assert sorted(structure.names[i] for i in structure.cyclic) == ignorable.split()
    told = " ".join(structure.sentences())
    turning = "Jacobi integral v.p - L is conserved (T + V is not this integral)."
    kept = turning if name == "hoop" else "energy is conserved."
    assert f"no force acts besides the potential: the {kept}" in told
    assert all(f"{item} d" in told for item in ignorable.split()) and "not conserved" not in told


def test_an_integral_that_is_not_the_sum_of_the_energies_is_named() -> None:
    turning = m * ((x.dot - c * y) ** 2 + (y.dot + c * x) ** 2) / 2
    assert found(kinetic=turning).sentences()[2].endswith("the Jacobi integral v.p - L is conserved.")
    mixed = found(kinetic=turning, potential=k * x**2)
    assert mixed.sentences()[2].endswith("the Jacobi integral v.p - L is conserved (T + V is not this integral).")
    # Homogeneous once its angles have cancelled, and not with its expressions as they stand.
    hidden = m * x.dot**2 + k * (sin(x) ** 2 + cos(x) ** 2 - 1)
    assert found(kinetic=hidden, potential=k * x**2).sentences()[2].endswith(": the energy is conserved.")


def test_forces_that_do_no_work_keep_the_energy() -> None:
    turned = found(**FREE, forces={x: k * y.dot, y: -k * x.dot})
    assert turned.conservative
    assert "the forces besides the potential do no work: the energy is conserved." in turned.sentences()[2]
    paid = found(**FREE, potential=t * k * x, forces={x: -k * x / x.dot})
    assert paid.sentences()[2] == (
        "The forces besides the potential do the work that explicit time takes: the energy is conserved."
    )
    assert found(**FREE, dissipation=c * x.dot).energy_kept is False


@pytest.mark.parametrize(
    ("parts", "verdict", "told"),
    [
        ({**ROD, "forces": {x: -c * x.dot}}, False, "is not conserved: forces or dissipation act."),
        ({**ROD, "forces": {x: c * x, y: c * y}}, None, "was not found to be conserved: forces or dissipation act."),
        ({**ROD, "potential": t * (x**2 + y**2 - 1)}, None, "not found to be conserved: the Lagrangian depends on tim"),
        ({**FREE, "constraints": {"wall": x - sin(t)}}, None, "not found to be conserved: constraints that depend on"),
        ({**FREE, "potential": k * x * cos(t)}, False, "is not conserved: the Lagrangian depends on time."),
    ],
)
def test_nothing_is_denied_that_may_hold(parts: dict[str, Any], verdict: bool | None, told: str) -> None:
    structure = found(**parts)
    assert structure.energy_kept is verdict and not structure.conservative
    assert any(told in sentence for sentence in structure.sentences())


def test_methods_that_split_take_what_separates_however_it_is_stated() -> None:
    hoop = lg.System(**STATED_BY_POSITIONS["hoop"][0], parameters={m: 1, l: 1, g: 9.81, omega: 2}, initial={theta: 0.5})
    exact, split = hoop.run(1.0, rtol=1e-12).final, hoop.run(1.0, method="yoshida6", step=0.005).final
    assert split["theta"] == pytest.approx(exact["theta"], abs=1e-9)
    assert not hoop.laws.structure.position_only and hoop.laws.structure.decisions.position_only is True
    # The derivative of sign(v) is zero on either side: dry friction depends on velocities all the same.
    for dry in ({"dissipation": k * Abs(x.dot)}, {"forces": {x: -k * sign(x.dot)}}):
        assert found(kinetic=m * x.dot**2, **dry).decisions.position_only is None
    assert found(kinetic=m * x.dot**2, dissipation=k * x.dot**2).decisions.position_only is False


def test_a_jump_is_no_constant() -> None:
    step = Piecewise((1, phi < 1000), (2, True))
    assert found(kinetic=m * (x.dot**2 + phi.dot**2), potential=k * step, coordinates=[x, phi]).cyclic == (0,)
    heavy = found(kinetic=m * x.dot**2 * Max(1, x - 1000)).sentences()
    assert heavy[0] == "The mass matrix is diagonal." and heavy[1].startswith("Nothing depends on time")


def test_what_is_absent_needs_no_decision(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whether a run is held to its energy is asked of every model: a chain of links must not pay for it.
    monkeypatch.setattr(decisions, "values", None)
    structure = laws_of(kinetic=lg.kinetic_energy(m, (x, y)), potential=k * x * y, coordinates=[x, y]).structure
    assert (
        structure.conservative
        and structure.decisions.timeless
        and structure.decisions.separable
        and structure.constant_mass
    )


EARTH = cos(Rational(729, 10**7) * t) + sin(Rational(1991, 10**10) * t)
"""Two periods that are whole multiples of one part only in the thousands: its cosine is a polynomial of that degree."""


def test_a_proof_has_a_bound_of_work() -> None:
    # The power of these forces disappears in 50 digits beside cos(x), so that only algebra could decide.
    structure = found(kinetic=x.dot**2 / 2, potential=cos(x) + x * EARTH / 10**26, coordinates=[x])
    assert structure.energy_kept is None
    assert found(kinetic=x.dot**2 / 2, potential=x * EARTH, coordinates=[x]).energy_kept is False
    # Samples have the size of the lengths in the formula, here 1e11.
    far = -(10**20) / sqrt(x**2 + 10**22) + x * EARTH
    assert found(kinetic=x.dot**2 / 2, potential=far, coordinates=[x]).energy_kept is False
    twelve = sin(12 * t) - 2 * sin(6 * t) * cos(6 * t)
    assert found(kinetic=x.dot**2 / 2, potential=x * twelve, coordinates=[x]).energy_kept


def test_a_run_that_keeps_its_energy_asks_for_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decisions, "StatedAlgebra", None)
    system = lg.System(x.dot**2 / 2, cos(x) + x * EARTH / 10**26)
    assert system.run(1.0, {x: 1.0}, target="numpy").status is lg.Status.SUCCESS


def test_numbers_beyond_doubles_have_no_value() -> None:
    # The cosine of such a number takes as many digits of pi as the number has in front of the point.
    assert found(kinetic=x.dot**2 / 2, potential=cos(exp(exp(x + 60)) * t), coordinates=[x]).energy_kept is None


def test_card_and_plot_say_what_was_found() -> None:
    wall = lg.System(**FREE, constraints={"wall": x - sin(t)}, parameters={m: 1}, initial={x.dot: 1.0})
    run = wall.run(1.0)
    assert "(not found to be conserved)" in repr(run) and run.card()["energy"]["conserved"] is None
    assert run.plot().axes[2].get_title(loc="left") == "energy (not found to be conserved)"
