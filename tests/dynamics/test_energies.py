"""Energies along runs and shapes of modes, against what linear systems have in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import StatementError
from tests.dynamics.planar import driven_linear, m, pendulum, r, theta, x, y
from tests.models import shared_scene

k, M, a = lg.parameters("k M a")
x1, x2, x3 = lg.coordinates("x1 x2 x3")


def coupled() -> lg.System:
    """Return two unit oscillators with a weak spring between: frequencies 1 and sqrt(1 + 2 k)."""
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=(x**2 + y**2) / 2 + k * (x - y) ** 2 / 2,
        parameters={k: 0.1},
        initial={x: 1.0},
        name="coupled",
    )


def test_the_energy_of_a_normal_mode_stays_where_it_is() -> None:
    solution = coupled().run(60.0, rtol=1e-12)
    found = lg.energy_exchange(solution, "modes")
    assert found.frequencies == pytest.approx([1.0, np.sqrt(1.2)])
    for name, size in (("mode 1", 0.25), ("mode 2", 0.3)):
        assert found.parts[name] == pytest.approx(np.full(len(found.t), size), rel=1e-10)
    assert found.total == pytest.approx(np.full(len(found.t), 0.55), rel=1e-10)
    assert found.error < 1e-9


def test_entries_of_matrices_may_be_single_parameters() -> None:
    """Of a linear molecule, 2 M + m moves against the middle in one mode, and the first moves alone."""
    line = lg.System(
        kinetic=m * (x1.dot**2 + x3.dot**2) / 2 + M * x2.dot**2 / 2,
        potential=k * ((x2 - x1) ** 2 + (x3 - x2) ** 2) / 2,
        parameters={m: 16, M: 12, k: 1},
        initial={x1: -0.1},
        name="molecule",
    )
    found = lg.energy_exchange(line.run(20.0, rtol=1e-12), by="modes")
    assert found.frequencies == pytest.approx([0.0, np.sqrt(1 / 16), np.sqrt(1 / 16 + 1 / 6)], abs=1e-7)
    assert found.total == pytest.approx(np.full(len(found.t), 0.005), rel=1e-10)


def test_the_energy_of_a_coordinate_goes_to_the_other_and_comes_back() -> None:
    """Beats have the frequency sqrt(1.2) - 1: half a beat later the energy is in y."""
    found = lg.energy_exchange(coupled().run(60.0, rtol=1e-12), by="coordinates")
    assert list(found.parts) == ["x", "y", "coupling"]
    half = np.pi / (np.sqrt(1.2) - 1)
    there = int(np.argmin(np.abs(found.t - half)))
    assert found.parts["x"][0] == pytest.approx(0.55)
    assert found.parts["y"][there] == pytest.approx(0.55, rel=0.02)
    assert found.parts["x"][there] == pytest.approx(0.0, abs=0.02)
    assert sum(found.parts.values()) == pytest.approx(found.total)
    assert found.error < 1e-9


@pytest.mark.parametrize("stated", ["energies", "lagrangian"])
def test_kinetic_and_potential_energy_make_the_energy_of_the_run(stated: str) -> None:
    kinetic, potential = r**2 * theta.dot**2 / 2, -9.81 * r * cos(theta)
    how: dict[str, Any] = (
        {"kinetic": kinetic, "potential": potential} if stated == "energies" else {"lagrangian": kinetic - potential}
    )
    system = lg.System(**how, parameters={r: 0.7}, initial={theta: 2.0})
    found = lg.energy_exchange(system.run(3.0))
    states = system.run(3.0).at(found.t)
    assert found.parts["kinetic"] == pytest.approx(0.49 * states[1] ** 2 / 2)
    assert found.parts["potential"] == pytest.approx(-9.81 * 0.7 * np.cos(states[0]))
    assert found.error < 1e-6


def test_energies_that_do_not_make_the_energy_are_said_so() -> None:
    """On a hoop that turns, T + V changes: the motor works."""
    turning = lg.System(
        kinetic=(theta.dot**2 + 25 * sin(theta) ** 2) / 2, potential=-9.81 * cos(theta), initial={theta: 1.0}
    )
    found = lg.energy_exchange(turning.run(3.0))
    assert found.error > 0.1
    assert "T + V is not the energy v.p - L here" in found.message


def test_energies_of_modes_are_those_at_the_parameters_of_the_run() -> None:
    """The middle atom of a molecule moves in its third mode alone, whose energy is all but that of the centre."""
    solution = molecule().run(5.0, {x2: 0.1}, parameters={M: 24.0}, rtol=1e-11)
    found = lg.energy_exchange(solution, "modes")
    assert found.frequencies == pytest.approx([0, np.sqrt(2 / 16), np.sqrt(2 / 16 * (1 + 32 / 24))], abs=1e-7)
    assert found.parts["mode 3"] == pytest.approx(np.full(len(found.t), 2 * 0.1**2), rel=1e-9)
    assert np.abs([found.parts["mode 1"], found.parts["mode 2"]]).max() < 1e-12


def test_what_cannot_be_meant_is_refused() -> None:
    solution = pendulum().run(1.0, {theta: 1.0})
    three: Any = 3
    for given, by, at, says in (
        (solution, "mode", None, "by = 'mode': give energies, modes and coordinates"),
        (three, "modes", None, "3 is no solution: give what system.run"),
        (solution, "modes", {theta: 1}, "there are no modes at this point"),
        (solution, "energies", {theta: 0}, 'give by="modes" with it'),
    ):
        with pytest.raises(StatementError, match=says):
            lg.energy_exchange(given, by, at=at)
    circulating = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, potential=x**2 + y**2, forces={x: -y / 2, y: x / 2}, initial={x: 1.0}
    )
    with pytest.raises(StatementError, match="the stiffness of system is not symmetric"):
        lg.energy_exchange(circulating.run(1.0), "modes")
    assert lg.energy_exchange(driven_linear().run(1.0)).parts["kinetic"].shape == (2000,)


def molecule() -> lg.System:
    return lg.System(
        kinetic=m * (x1.dot**2 + x3.dot**2) / 2 + M * x2.dot**2 / 2,
        potential=k * (x2 - x1) ** 2 / 2 + k * (x3 - x2) ** 2 / 2,
        coordinates=[x1, x2, x3],
        parameters={k: 2.0, m: 16.0, M: 12.0, a: 1.0},
        positions={"left": (x1 - a, 0), "middle": (x2, 0), "right": (x3 + a, 0)},
        links=[("left", "middle", "spring"), ("middle", "right", "spring")],
        name="carbon dioxide",
    )


def test_the_modes_of_a_triatomic_molecule_are_drawn_where_its_atoms_are() -> None:
    """H. Goldstein et al., Classical Mechanics, 3rd ed., section 6.4: 0, sqrt(k/m) and sqrt(k/m (1 + 2 m/M))."""
    shapes = molecule().modes().shapes_in_numbers()
    assert shapes.frequencies == pytest.approx([0, np.sqrt(2 / 16), np.sqrt(2 / 16 * (1 + 32 / 12))])
    wanted = np.array([[1, 1, 1], [1, 0, -1], [-0.375, 1, -0.375]])
    assert shapes.components == pytest.approx(wanted, abs=1e-12)
    assert shapes.points["left"] == pytest.approx([-1.0, 0.0])
    for name, column in (("left", 0), ("middle", 1), ("right", 2)):
        assert shapes.displacements[name] == pytest.approx(np.column_stack([wanted[:, column], np.zeros(3)]), abs=1e-12)


def test_displacements_are_the_derivatives_of_the_positions() -> None:
    """Those of a double pendulum about an equilibrium with one arm upright, against differences."""
    system = shared_scene("double-pendulum")
    shapes = system.modes({"theta2": np.pi}).shapes_in_numbers()
    names = [q.name for q in system.statement.plain.values()]
    assert names[0] == "theta1"
    values = {p.name: v for p, v in system.parameters.items()}
    l1, l2 = values["l1"], values["l2"]

    def second(q1: float, q2: float) -> Any:
        return np.array([l1 * np.sin(q1) + l2 * np.sin(q2), -l1 * np.cos(q1) - l2 * np.cos(q2)])

    last = list(system.statement.positions)[-1]
    assert shapes.points[last] == pytest.approx(second(0.0, np.pi))
    for row, (b1, b2) in zip(shapes.displacements[last], shapes.components, strict=True):
        h = 1e-6
        assert row == pytest.approx(
            (second(h * b1, np.pi + h * b2) - second(-h * b1, np.pi - h * b2)) / (2 * h), abs=1e-8
        )


def test_shapes_want_values_of_the_parameters() -> None:
    open_ended = lg.System(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1.0})
    with pytest.raises(StatementError, match="shapes are drawn at values of the parameters, and k has none"):
        open_ended.modes().plot()
