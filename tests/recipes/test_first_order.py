"""States of first order, whose velocities follow from the coordinates, started with velocities of zero."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sympy import Heaviside, Matrix, simplify

import lagrange as lg
from lagrange.errors import StatementError
from tests.export.callers import run
from tests.models import LLVM_FIRST, k, phi, x, y

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
    with pytest.raises(StatementError, match=r"the equation of i has the term -R\*i"):
        with_units(R="H")
    with pytest.raises(
        StatementError, match=r"i has the term u, whose unit is 0.001 times .*: state u in V instead of mV"
    ):
        with_units(u="mV")
    with pytest.raises(StatementError, match=r"the equation of e has the term -e, in 1 - e"):
        lowpass(dimensions={e: "V"})


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


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["numpy", "llvm"])
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
    with pytest.raises(StatementError, match=r"e has no inertia, and its velocity in y is 0, which contradicts"):
        model.rhs(0.0, [0.0, 0.0])
    with pytest.raises(StatementError, match=r"Start from model.as_scipy"):
        model.rhs(0.0, [[1.0, 0.0], [0.0, 0.0]])
    with pytest.raises(StatementError, match=r"e has no inertia"):
        model.jacobian(0.0, [0.0, 0.0])
    with pytest.raises(StatementError, match=r"e has no inertia"):
        model.accelerations([0.0], [0.0])
    # At rest in equilibrium, and where a velocity was given: 1 - e = 2 and (1 + 3 e'**2) e'' = -e'.
    assert model.rhs(0.0, [1.0, 0.0]).tolist() == [0.0, 0.0]
    assert model.rhs(0.0, [-1.0, 1.0]).tolist() == [1.0, -0.25]


def test_velocities_are_found_where_their_equation_has_no_slope_at_rest() -> None:
    system = lg.System(kinetic=0, forces={e: 1 - e}, dissipation=abs(e.dot) ** 3 / 3)
    # e'**2 = 1 - e, so that e = 1 - (1 - t/2)**2.
    assert system.run(1.0)[e][-1] == pytest.approx(0.75, abs=1e-9)


def test_velocities_with_two_solutions_are_not_chosen() -> None:
    system = lg.System(kinetic=0, forces={e: 1 - e}, dissipation=e.dot**3 / 3)
    with pytest.raises(StatementError, match=r"e, without inertia, are not determined at the initial state"):
        system.run(1.0)


@needs_cc
@pytest.mark.parametrize(
    "method", ["rk4", *(pytest.param(name, marks=pytest.mark.slow) for name in ("taylor", "dop853"))]
)
def test_exported_integrators_start_from_coordinates_alone(method: str, tmp_path: Path) -> None:
    made = lowpass().export("c", tmp_path, [method, "main"])
    for command in made.commands:
        told = run(command, tmp_path)
    assert told.endswith("results are right\n")
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
    with pytest.raises(StatementError, match=says):
        lg.phase_portrait(system(), **arguments)


def test_modes_and_linear_equations_name_the_states_without_inertia() -> None:
    both = lg.System(
        x.dot**2 / 2, x**2 / 2, coordinates=[x, e], forces={e: x - e}, dissipation=e.dot**2 / 2, name="both"
    )
    with pytest.raises(StatementError, match=r"not an equilibrium of lowpass, and e has no inertia.*equilibria"):
        lowpass().modes()
    with pytest.raises(StatementError, match=r"not an equilibrium of motor, and i has no inertia"):
        motor().linearize({i: 1.0})
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
