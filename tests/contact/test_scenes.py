"""The scenes of the library with contacts, against closed forms and published figures."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import lagrange as lg
from tests.models import SCENE_NAMES, shared_scene, stated_in

NAMES = [name for name in SCENE_NAMES if "contacts" in stated_in(name)]
DRIVEN = ("ball-on-table", "belt")
"""Scenes in which a moving surface does work."""


@cache
def run_of(name: str) -> lg.Solution:
    return shared_scene(name).run(rtol=1e-12).require()


def changes(run: lg.Solution, contact: str) -> list[float]:
    """Return the times at which the mode of a contact changes."""
    modes = run.contacts[contact].mode
    return [float(run.t[i + 1]) for i in np.flatnonzero(modes[1:] != modes[:-1])]


QUICK = ("ball-on-table", "belt", "block-on-incline", "bouncing-ball", "elliptic-billiard")
"""Scenes whose runs take a part of a second; those of the others take seconds."""

CASES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]


def test_a_tolerance_of_the_method_is_one_of_the_run() -> None:
    """Transitions did not know it: the run of the rocking block was unreliable, and the tippe top's had no end."""
    scene, method = shared_scene("rocking-block"), lg.methods.DOP853(rtol=1e-3)
    model, expected = scene.compile(), scene.run(2.0, method="dop853", rtol=1e-3).require()
    assert (scene.run(2.0, method=method).require().y == expected.y).all()
    assert (lg.flow(model, method=method)(model.statement.initial, 0.0, 2.0) == expected.y[:, -1]).all()


@pytest.mark.parametrize("name", CASES)
def test_no_body_enters_another_and_energy_is_booked(name: str) -> None:
    run = run_of(name)
    for stated, contact in zip(shared_scene(name).statement.contacts, run.contacts.values(), strict=True):
        # The scale of all scenes is near 1. Forces of friction are compared with the largest force.
        assert contact.gap.min() > -1e-12 and contact.force.min() >= -1e-12 * max(1.0, contact.force.max())
        if stated.slip:
            mu = float(stated.friction[0].subs(shared_scene(name).parameters))
            size = np.linalg.norm(np.atleast_2d(contact.friction), axis=0)
            assert (size <= mu * contact.force + 1e-12 * contact.force.max()).all()
    if name not in DRIVEN:
        assert np.ptp(run.energy + run.energy_lost) < 1e-11 * np.abs(run.energy).max()


def test_the_ball_meets_the_table_once_in_a_period() -> None:
    impacts = run_of("ball-on-table").contacts["table"].impacts
    assert [impact.t for impact in impacts] == pytest.approx([1, 2, 3, 4, 5], abs=1e-9)
    # It leaves with the speed g T/2 with which it came.
    assert [impact.impulse for impact in impacts] == pytest.approx([1] * 5, abs=1e-8)


def test_the_block_on_the_belt_sticks_and_slips_in_a_cycle() -> None:
    """It slips about x = 0.3, where the spring has the force of kinetic friction, from x = 0.6 back to x = 0."""
    begin, rate, belt = 3.0, np.sqrt(10), 0.2
    slips = 2 * (np.pi - np.arctan(0.3 * rate / belt)) / rate
    cycle = slips + 0.6 / belt
    times = changes(run_of("belt"), "belt")
    assert times[:6] == pytest.approx([begin + k * cycle + late for k in range(3) for late in (0, slips)], abs=1e-10)


@pytest.mark.slow
def test_the_ladder_leaves_the_wall() -> None:
    run = run_of("ladder-leaves-wall")
    left = np.argmax(run.contacts["wall"].mode == "open")
    assert run["y"][left] == pytest.approx(2 / 3 * np.cos(0.1), abs=1e-11)
    assert [contact.mode[-1] for contact in run.contacts.values()] == ["closed", "open", "closed"]


@pytest.mark.slow
def test_the_woodpecker_falls_into_the_published_cycle() -> None:
    """Glocker and Studer start on the cycle, with phiM = -0.1036 where the sleeve touches: three digits compare."""
    passes = [lg.event(lg.coordinate("phiS") + 0.2788, direction=-1)]
    run = shared_scene("woodpecker").run(1.0, events=passes).require()
    state = dict(zip(run.names, run.y_events[0][-1], strict=True))
    assert state["phiM"] == pytest.approx(-0.1036, rel=2e-3)
    assert state["y_dot"] == pytest.approx(-0.3411, rel=0.01)
    assert state["phiS_dot"] == pytest.approx(-7.4583, rel=2e-3)
    strikes = [impact.t for impact in run.contacts["beak"].impacts]
    assert np.diff(strikes) == pytest.approx([0.146] * (len(strikes) - 1), abs=2e-4)


@pytest.mark.slow
def test_the_tippe_top_turns_over_and_keeps_the_integral_of_jellett() -> None:
    run = run_of("tippe-top")
    theta, rates = run["theta"], (run["phi_dot"], run["psi_dot"])
    spin = rates[1] + rates[0] * np.cos(theta)
    vertical = rates[0] * np.sin(theta) ** 2 + spin * np.cos(theta)
    jellett = 0.015 * vertical - 0.003 * spin
    assert np.ptp(jellett) < 1e-9 * abs(jellett[0])
    assert theta.max() > 2.5


def test_the_panel_of_the_energy_adds_what_contacts_took() -> None:
    """A picture samples some times twice; there the energy that is lost belongs to the state that is given."""
    run = run_of("bouncing-ball")
    time = run.contacts["floor"].impacts[0].t
    twice = run.sampled([0.1, time, time, time, 1.0])
    assert np.ptp(twice.energy + twice.energy_lost) < 1e-12
    titles = [axis.get_title(loc="left") for axis in run.plot().axes]
    assert "energy drift: (E + energy lost − E₀) relative to the initial energy" in titles
