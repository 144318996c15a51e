"""Every recipe gives the results of the model, for all scenes, random systems and states of first order."""

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from scipy.integrate import solve_ivp
from sympy import Heaviside, Matrix, simplify

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.recipes.model import Model
from lagrange.statement.coordinate import t
from tests.covering import examples
from tests.export.callers import run
from tests.laws.mechanisms import potentials
from tests.laws.test_random_systems import kinetic_energies, states, x, y
from tests.models import LLVM_FIRST, build, k, phi
from tests.recipes.agreement import EPS, OWN, SCENES, apart, named, sensitivity, singular, unbounded
from tests.recipes.agreement import states as states_of
from tests.refusals import refusal

Function = Callable[[float, Any, Any], Any]
CASADI, JAX, SYMPY = "casadi", "jax", "sympy"
few = settings(max_examples=examples(12), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


@cache
def ready(package: str) -> None:
    """Skip a test whose package is not installed."""
    module = pytest.importorskip(package, reason=f"{package} is not installed")
    if package == JAX:
        module.config.update("jax_enable_x64", val=True)


def by(package: str, model: Model, quantity: str = "rhs") -> Function:
    """Return a quantity, computed by the recipe of a package."""
    ready(package)
    if package == JAX:
        import jax

        compiled: Function = jax.jit(model.as_jax(quantity))
        return compiled
    if package == CASADI:
        made = model.as_casadi(quantity)
        return lambda time, state, p: made(time, state, p).full()
    form = model.as_sympy(quantity)
    plain = sp.lambdify(form.arguments, form.results, modules="math", cse=form.common)
    return lambda time, state, p: plain(time, *state, *p)


def check(package: str, model: Model, quantity: str = "rhs", count: int = 3) -> None:
    result = by(package, model, quantity)
    for time, state in states_of(model, count):
        assert apart(model, quantity, time, state, result(time, state, model.parameter_array())) <= 1, (time, state)


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
@pytest.mark.parametrize("package", [CASADI, SYMPY])
def test_casadi_and_sympy_compute_what_the_model_does(package: str, name: str) -> None:
    check(package, named(name))


def every_system(*quick: str) -> list[Any]:
    """Return all systems as test parameters; a default run takes few, because JAX compiles each operation."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in quick)) for name in [*SCENES, *OWN]]


# Time and angles, a constraint, a matrix for LAPACK, conditions.
@pytest.mark.few(1)
@pytest.mark.parametrize("name", every_system("cart and pole", "cartesian-pendulum", "8 carried masses", "friction"))
def test_jax_computes_what_the_model_does(name: str) -> None:
    check(JAX, named(name), count=2)


QUANTITIES = ["jacobian", "mass_matrix", "energy", "momenta", "multipliers"]


@pytest.mark.few(1)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_other_quantities_have_their_shapes(quantity: str) -> None:
    model = named("cartesian-pendulum")
    shape = model.interpreted(quantity).program.shape
    ready(JAX)
    result = model.as_jax(quantity)
    time, state = list(states_of(model))[1]
    p = model.parameter_array()
    assert result(time, state, p).shape == shape
    assert apart(model, quantity, time, state, result(time, state, p)) <= 1
    ready(CASADI)
    matrix = model.as_casadi(quantity)(time, state, p).full()
    assert matrix.shape == (*shape, 1, 1)[:2]
    assert apart(model, quantity, time, state, matrix) <= 1
    assert model.as_sympy(quantity).shape == shape
    check(SYMPY, model, quantity)


def derivative_apart(model: Model, time: float, state: Any, result: Any) -> float:
    """Return the difference of a derivative from the model's Jacobian, in units of the allowed rounding error.

    A derivative of the elimination has about ten times the operations of ours.
    """
    exact = model.jacobian(time, state)
    bound = 40 * EPS * np.abs(exact).max() + 40 * sensitivity(model, "jacobian", time, state)
    return float(np.abs(np.asarray(result, dtype=float) - exact).max() / bound)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", [*SCENES, *OWN])
def test_derivatives_by_casadi_are_the_jacobian(name: str) -> None:
    ready(CASADI)
    model = named(name)
    slope = model.as_casadi().jacobian()
    for time, state in list(states_of(model))[1:]:
        result = slope(time, state, model.parameter_array(), 0)[1].full()
        assert derivative_apart(model, time, state, result) <= 1


@pytest.mark.few(1)
@pytest.mark.parametrize("name", every_system("cart and pole", "8 carried masses"))
def test_derivatives_by_jax_are_the_jacobian(name: str) -> None:
    ready(JAX)
    import jax

    model = named(name)
    time, state = list(states_of(model))[1]
    result = jax.jit(jax.jacfwd(model.as_jax(), 1))(time, state, model.parameter_array())
    assert derivative_apart(model, time, state, result) <= 1


@few
@given(kinetic_energies(x, y, t), potentials(x, y, t), states)
@pytest.mark.slow
def test_random_systems(kinetic: Any, potential: Any, state: Any) -> None:
    model = build("numpy", kinetic=kinetic, potential=potential, coordinates=[x, y])
    state = np.where(np.abs(state) < 1e-100, 0.0, state)  # JAX takes doubles below 2.2e-308 for zero
    for package in (SYMPY, CASADI, JAX):
        result = by(package, model)(0.3, state, model.parameter_array())
        assert apart(model, "rhs", 0.3, state, result) <= 1, package


def told(package: str, model: Model, *states: Any, **options: Any) -> list[tuple[Any, bool]]:
    """Return the accelerations at states, and True if the recipe reports a singular matrix."""
    ready(package)
    p = model.parameter_array()
    if package == CASADI:
        checked: Any = model.as_casadi(status=True, **options)
    else:
        import jax

        checked = jax.jit(model.as_jax().checked)
    actual = [checked(0.0, np.array(state), p) for state in states]
    return [(np.array(result).ravel(), bool(float(status))) for result, status in actual]


@pytest.mark.parametrize(
    ("package", "options"),
    [(CASADI, {"symbols": "SX"}), (CASADI, {"symbols": "MX"}), pytest.param(JAX, {}, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("n", [2, 6])
def test_a_singular_mass_matrix_is_nan_throughout_and_told(n: int, package: str, options: Any) -> None:
    """A singular mass matrix gives NaN in all entries, for an unrolled matrix and for one solved by LAPACK."""
    of = singular(n)
    regular, degenerate = np.ones(2 * n), np.array([0.0, 0.0, *[1.0] * (2 * n - 2)])
    with pytest.raises(RunError, match="mass matrix"):
        of.rhs(0.0, degenerate)
    (result, fine), (_, bad) = told(package, of, regular, degenerate, **options)
    assert (fine, bad) == (False, True)
    np.testing.assert_allclose(result, of.rhs(0.0, regular), rtol=1e-13)
    assert np.isnan(np.asarray(by(package, of)(0.0, degenerate, of.parameter_array()))).all()


@pytest.mark.parametrize("package", [CASADI, JAX])
@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_matrix_that_is_not_finite_is_not_singular(n: int, package: str) -> None:
    of = unbounded(n)
    starts = [np.array([first, *[1.0] * (2 * n - 1)]) for first in (0.0, -1.0, np.nan)]
    for state, (result, status) in zip(starts, told(package, of, *starts), strict=True):
        np.testing.assert_array_equal(result, of.interpreted("rhs")(0.0, state, of.parameter_array()))
        assert not status


# --- states of first order, whose velocities follow from the coordinates, started with velocities of zero ------


e, i = lg.coordinates("e i")
J, L, R, u = lg.parameters("J L R u")


def lowpass(**options: Any) -> lg.System:
    """Return the system e' = 1 - e, which rises from 0 to 1."""
    return lg.System(kinetic=0, forces={e: 1 - e}, dissipation=e.dot**2 / 2, name="lowpass", **options)


def motor() -> lg.System:
    return lg.System(
        kinetic=J * phi.dot**2 / 2,
        coordinates=[phi, i],
        forces={phi: k * i, i: u - R * i - k * phi.dot},
        dissipation=L * i.dot**2 / 2,
        parameters={J: 0.01, L: 0.5, R: 1.0, k: 0.1, u: 12.0},
        name="motor",
    )


MOTOR_UNITS = {J: "kg*m**2", L: "H", R: "ohm", k: "N*m/A", u: "V", i: "A"}


def test_a_system_without_lagrangian_has_no_energy_to_report() -> None:
    system = lowpass()
    solution = system.run(1.0)
    derivation = system.derivation().text()
    assert not solution.has_energy and solution.card()["energy"] is None
    assert not any("nergy" in text for text in (str(solution), derivation, *system.structure))
    assert len(solution.plot().axes) == 1


def test_terms_of_first_order_need_no_unit_of_energy() -> None:
    """The equation of a current has voltages as terms, that of a filter rates."""
    stated = motor().statement
    forces = dict(zip(stated.coordinates, stated.forces, strict=True))

    def with_units(**other: str) -> lg.System:
        units = MOTOR_UNITS | {symbol: other[str(symbol)] for symbol in (R, u) if str(symbol) in other}
        return lg.System(stated.kinetic, forces=forces, dissipation=stated.dissipation, dimensions=units)

    assert not with_units().statement.dimensions[phi].exponents
    assert "the equation of i has the term -R*i" in refusal(with_units, R="H")
    with pytest.raises(
        StatementError, match=r"i has the term u, whose unit is 0.001 times .*: state u in V instead of mV"
    ):
        with_units(u="mV")
    assert "the equation of e has the term -e, in 1 - e" in refusal(lowpass, dimensions={e: "V"})


def rabbits() -> lg.System:
    """Return the equations of Lotka and Volterra, with orbits around (1, 1)."""
    forces = {x: x * (1 - y), y: y * (x - 1)}
    return lg.System(kinetic=0, coordinates=[x, y], forces=forces, dissipation=(x.dot**2 + y.dot**2) / 2)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("unit", [1e-18, 1e18])
def test_a_state_has_any_unit(unit: float, target: str) -> None:
    """An equation with coefficients below 1e-14 counted as unsolvable."""
    scaled = lg.System(
        kinetic=0, forces={e: -R * e}, dissipation=L * e.dot**2 / 2, parameters={R: unit, L: unit}, initial={e: 1}
    )
    assert scaled.run(1.0, target=target).require()[e][-1] == pytest.approx(np.exp(-1), rel=1e-8)


def test_scipy_starts_with_the_velocities_that_follow() -> None:
    problem = motor().compile(check=False).as_scipy()
    assert problem.y0().tolist() == pytest.approx([0.0, 0.0, 0.0, 24.0])
    result = solve_ivp(**problem.arguments((0, 2), rtol=1e-9, atol=1e-9)).y[:, -1]
    assert result == pytest.approx(motor().run(2.0).y[:, -1], rel=1e-6)


@pytest.mark.parametrize("target", ["numpy", pytest.param("llvm", marks=pytest.mark.slow)])
def test_the_motion_does_not_depend_on_velocities_that_follow(target: str) -> None:
    """A torque depends on the rate of the current. The run starts with wrong rates, such as zero."""
    system = lg.System(
        kinetic=J * phi.dot**2 / 2,
        coordinates=[phi, i],
        forces={phi: k * i + i.dot / 5, i: u * lg.t - R * i - k * phi.dot},
        dissipation=L * i.dot**2 / 2,
        parameters={J: 0.01, L: 0.5, R: 1.0, k: 0.1, u: 12.0},
    )
    model = system.compile(target, check=False)
    # L i' = u t - R i - k phi', and its rate.
    current_rate = (12.0 * 0.5 - 0.25 - 0.1 * 2.0) / 0.5
    spin_rate = (0.1 * 0.25 + current_rate / 5) / 0.01
    expected = [2.0, current_rate, spin_rate, (12.0 - current_rate - 0.1 * spin_rate) / 0.5]
    for velocity in (0.0, current_rate, 7.0):
        assert model.rhs(0.5, [1.0, 0.25, 2.0, velocity]) == pytest.approx(expected, rel=1e-14)
    columns = model.rhs(0.5, np.array([[1.0, 0.25, 2.0, 0.0], [1.0, 0.25, 2.0, 7.0]]).T)
    assert columns == pytest.approx(np.column_stack([expected, expected]), rel=1e-14)
    assert not model.jacobian(0.5, [1.0, 0.25, 2.0, 0.0])[:, 3].any()
    assert system.check(points=2)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5", "bs3", "verner9"])
@pytest.mark.parametrize("target", LLVM_FIRST)
def test_a_voltage_that_jumps_is_passed(method: str, target: str) -> None:
    """The rate of the current, which a torque contains, jumps with the voltage at t = 1."""
    switched = lg.System(
        kinetic=phi.dot**2 / 2,
        coordinates=[phi, i],
        forces={phi: i + i.dot / 2, i: 3 * Heaviside(lg.t - 1) - i},
        dissipation=i.dot**2 / 2,
    )
    solution = switched.run(3.0, method=method, target=target)
    assert solution.status is lg.Status.SUCCESS
    fallen = np.exp(-2.0)
    # With s = t - 1: i = 3(1 - exp(-s)), and the spin is the integral of i, plus i/2.
    assert solution[i][-1] == pytest.approx(3 * (1 - fallen), abs=1e-8)
    assert solution[i.dot][-1] == pytest.approx(3 * fallen, abs=1e-8)
    assert solution[phi.dot][-1] == pytest.approx(3 * (2 - 1 + fallen) + 1.5 * (1 - fallen), abs=1e-8)


def moved_in_c(system: lg.System, call: str, folder: Path) -> list[float]:
    """Return the outcome and the state after a call of an exported integrator from the state 0, 0."""
    name = system.statement.name
    (folder / "start.c").write_text(f"""\
#include <stdio.h>
#include "{name}.h"
int main(void) {{
    double p[{name.upper()}_PREPARED], t[] = {{0.0}}, y[] = {{0.0, 0.0}};
    {name}_prepare({name}_default_parameters, p);
    (void)t;
    int status = (int){name}_{call};
    printf("%d %.17g %.17g", status, y[0], y[1]);
    return 0;
}}
""")
    run(f"cc -O1 -o start start.c {name}.c -lm", folder)
    return [float(word) for word in run("./start", folder).split()]


needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")


@pytest.mark.slow
@needs_cc
def test_exported_steps_with_error_control_pass_a_voltage_that_jumps(tmp_path: Path) -> None:
    switched = lg.System(kinetic=0, forces={e: 3 * Heaviside(lg.t - 1) - e}, dissipation=e.dot**2 / 2, name="switched")
    switched.export("c", tmp_path, ["dop853"])
    numbers = moved_in_c(switched, "dop853(t, 3.0, y, p, 1e-10, 1e-10, 100000)", tmp_path)
    assert numbers == pytest.approx([0, 3 - 3 * np.exp(-2), 3 * np.exp(-2)], abs=1e-8)


@pytest.mark.parametrize("target", ["numpy", "llvm"])
def test_a_velocity_of_zero_that_contradicts_a_nonlinear_equation_is_refused(target: str) -> None:
    """The equation 1 - e = e.dot + e.dot**3 is nonlinear in the velocity."""
    cubic = lg.System(kinetic=0, forces={e: 1 - e}, dissipation=e.dot**2 / 2 + e.dot**4 / 4)
    model = cubic.compile(target, check=False)
    assert "e has no inertia, and its velocity in y is 0, which contradicts" in refusal(model.rhs, 0.0, [0.0, 0.0])
    assert "Start from model.as_scipy" in refusal(model.rhs, 0.0, [[1.0, 0.0], [0.0, 0.0]])
    assert "e has no inertia" in refusal(model.jacobian, 0.0, [0.0, 0.0])
    assert "e has no inertia" in refusal(model.accelerations, [0.0], [0.0])
    # At rest in equilibrium, and where a velocity was given: 1 - e = 2 and (1 + 3 e'**2) e'' = -e'.
    assert model.rhs(0.0, [1.0, 0.0]).tolist() == [0.0, 0.0]
    assert model.rhs(0.0, [-1.0, 1.0]).tolist() == [1.0, -0.25]


def test_velocities_are_found_where_their_equation_has_no_slope_at_rest() -> None:
    system = lg.System(kinetic=0, forces={e: 1 - e}, dissipation=abs(e.dot) ** 3 / 3)
    # e'**2 = 1 - e, so that e = 1 - (1 - t/2)**2.
    assert system.run(1.0)[e][-1] == pytest.approx(0.75, abs=1e-9)


def test_velocities_with_two_solutions_are_not_chosen() -> None:
    system = lg.System(kinetic=0, forces={e: 1 - e}, dissipation=e.dot**3 / 3)
    assert "e, without inertia, are not determined at the initial state" in refusal(system.run, 1.0)


@needs_cc
@pytest.mark.parametrize(
    "method", ["rk4", *(pytest.param(name, marks=pytest.mark.slow) for name in ("taylor", "dop853"))]
)
def test_exported_integrators_start_from_coordinates_alone(method: str, tmp_path: Path) -> None:
    lowpass().export("c", tmp_path, [method])
    call = "0.0, 0.01, y, p" if method == "rk4" else "t, 0.01, y, p, 1e-12, 1e-12, 100000"
    numbers = moved_in_c(lowpass(), f"{method}({call})", tmp_path)
    # The error of a step of rk4 is its length to the power of 5 over 120.
    assert numbers == pytest.approx([0, 1 - np.exp(-0.01), np.exp(-0.01)], abs=1e-11)


def test_pages_and_tables_of_main_start_with_the_velocities_that_follow(tmp_path: Path) -> None:
    page = motor().to_page(tmp_path / "motor.html").read_text("utf-8")
    result = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert result is not None and json.loads(result.group(1))["initial"] == pytest.approx([0.0, 0.0, 0.0, 24.0])


@pytest.mark.slow
def test_the_portrait_of_two_states_of_first_order_is_a_plane() -> None:
    result = lg.phase_portrait(rabbits(), window={x: (0.1, 3), y: (0.1, 3)}, starts=[{x: 1.5, y: 1.0}])
    orbit = result.orbits[0]
    assert orbit.closed
    rounds = orbit.states[:, 0] - np.log(orbit.states[:, 0]) + orbit.states[:, 1] - np.log(orbit.states[:, 1])
    assert rounds == pytest.approx(rounds[0], abs=1e-9)
    places, heights = np.meshgrid(result.x, result.y)
    assert result.u == pytest.approx(places * (1 - heights), abs=1e-12)
    assert result.v == pytest.approx(heights * (places - 1), abs=1e-12)


@pytest.mark.parametrize(
    ("system", "arguments", "says"),
    [
        (lowpass, {}, "e has no inertia, so the state of lowpass is one number, and a phase plane needs two"),
        (
            lowpass,
            {"at": {e.dot: 0}},
            "the argument at has a value for e_dot, which follows from the coordinates, since e has no inertia",
        ),
        (rabbits, {}, "no window is given, and there is no default window for 2 coordinates"),
        (motor, {}, "3 entries of its state are free.*Give all others a value, as at=\\{'phi_dot': 0\\}"),
    ],
)
def test_portraits_without_a_plane_are_refused(system: Any, arguments: dict[str, Any], says: str) -> None:
    assert re.search(says, refusal(lg.phase_portrait, system(), **arguments))


def test_modes_and_linear_equations_name_the_states_without_inertia() -> None:
    both = lg.System(
        x.dot**2 / 2, x**2 / 2, coordinates=[x, e], forces={e: x - e}, dissipation=e.dot**2 / 2, name="both"
    )
    assert re.search(r"not an equilibrium of lowpass, and e has no inertia.*equilibria", refusal(lowpass().modes))
    assert "not an equilibrium of motor, and i has no inertia" in refusal(motor().linearize, {i: 1.0})
    for system, point in ((lowpass(), {e: 1}), (both, {})):
        with pytest.raises(
            StatementError,
            match=r"e has no inertia.*not all motions.*eigenvalues of "
            r"linearize\(...\).A",
        ):
            system.modes(point)


def test_linear_equations_of_a_motor_are_those_of_a_book() -> None:
    """State [phi, i, phi'], with the voltage as input (G. F. Franklin et al., Feedback Control, 2015, section 2.3)."""
    voltage = lg.given("u")
    parts = {"coordinates": [phi, i], "dissipation": L * i.dot**2 / 2, "parameters": {J: 1, L: 2, R: 3, k: 4}}
    forces = {phi: k * i, i: voltage - R * i - k * phi.dot}
    result = lg.System(kinetic=J * phi.dot**2 / 2, forces=forces, **parts).linearize(inputs=[voltage])
    assert Matrix([[0, 0, 1], [0, -R / L, -k / L], [0, k / J, 0]]) == result.A
    assert Matrix([0, 1 / L, 0]) == result.B
    # A torque that depends on the rate of the current, too, which is eliminated.
    forces[phi] += i.dot
    coupled = lg.System(kinetic=J * phi.dot**2 / 2, forces=forces, **parts).linearize(inputs=[voltage])
    assert (coupled.A[2, :] - result.A[2, :] - result.A[1, :] / J).applyfunc(simplify).is_zero_matrix
    assert Matrix([0, 1 / L, 1 / (L * J)]) == coupled.B


def test_eigenvalues_decide_the_stability_of_a_motor_on_a_spring() -> None:
    for stiffness, stable in ((1.0, True), (-1.0, False)):
        spring = lg.System(
            kinetic=phi.dot**2 / 2,
            potential=stiffness * phi**2 / 2,
            coordinates=[i, phi],
            forces={phi: i, i: 1 - i - phi.dot},
            dissipation=i.dot**2 / 2,
        )
        assert [place.stable for place in spring.equilibria()] == [stable]
