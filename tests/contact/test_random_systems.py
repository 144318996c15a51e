"""Laws of contact on random systems: discs that fall on planes and on each other, with up to four contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, diff, sin, sqrt

import lagrange as lg
from lagrange.statement.contact import Contact
from lagrange.trajectory.contact.kinematics import Kinematics
from lagrange.trajectory.contact.modes import Mode, modes_of
from lagrange.trajectory.contact.transition import Transitions

LAWS = ("newton", "sequence")


def random_discs(seed: int) -> lg.System:
    """Return one or two discs over a floor, with friction and restitution at random, and a spring between them."""
    rng = np.random.default_rng(seed)
    kinetic: Any = 0
    potential: Any = 0
    contacts: dict[str, Contact] = {}
    start: dict[Any, float] = {}
    discs: list[tuple[Any, Any, Any, float]] = []

    def law() -> dict[str, float]:
        return {"friction": float(rng.choice([0, 0.1, 0.3, 0.8])), "restitution": float(rng.choice([0, 0.3, 0.7, 1.0]))}

    def touching(gap: Any, slip: Any) -> Contact:
        laws = law()
        return lg.contact(gap, slip if laws["friction"] else None, **laws)

    for i in range(rng.integers(1, 3)):
        x, y, phi = lg.coordinates(f"x{i} y{i} phi{i}")
        m, radius, tilt = float(rng.uniform(0.5, 2)), float(rng.uniform(0.1, 0.3)), float(rng.choice([0, 0.2]))
        discs.append((x, y, phi, radius))
        kinetic += m * (x.dot**2 + y.dot**2) / 2 + m * radius**2 * phi.dot**2 / 4
        potential += m * 9.81 * y
        height = radius / np.cos(tilt) + 2 * i * np.tan(tilt) + max(0.0, float(rng.normal()))
        start |= {x: 2.0 * i, y: height, x.dot: float(rng.normal()), phi.dot: 5 * float(rng.normal())}
        along = x.dot * cos(tilt) + y.dot * sin(tilt) + radius * phi.dot
        contacts[f"floor{i}"] = touching(y * cos(tilt) - x * sin(tilt) - radius, along)
        if rng.random() < 0.5:
            contacts[f"wall{i}"] = touching(4 - x - radius, y.dot + radius * phi.dot)
    if len(discs) == 2 and len(contacts) < 4:
        (x, y, phi, r), (u, v, psi, s) = discs
        distance = sqrt((u - x) ** 2 + (v - y) ** 2)
        slip = ((v.dot - y.dot) * (u - x) - (u.dot - x.dot) * (v - y)) / distance - s * psi.dot - r * phi.dot
        contacts["pair"] = touching(distance - r - s, slip)
        potential += float(rng.choice([0, 5])) * ((u - x) ** 2 + (v - y) ** 2) / 2
    return lg.System(kinetic, potential, contacts=contacts, simultaneous=str(rng.choice(LAWS)), initial=start)


@pytest.mark.parametrize("seed", [4, 26, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 2, 16))])
def test_bodies_do_not_overlap_and_energy_goes_where_it_is_booked(seed: int) -> None:
    system = random_discs(seed)
    run = system.run(3.0).require()
    total = run.energy + run.energy_lost
    # Events are located to round-off of their own functions, and each of some hundred may cost 1e-13 of the energy.
    assert np.abs(total - total[0]).max() < 1e-11 * np.abs(run.energy).max()
    for stated, contact in zip(system.statement.contacts, run.contacts.values(), strict=True):
        mu, largest = float(stated.friction[0]), contact.force.max()
        assert contact.gap.min() > -1e-14 and contact.force.min() >= -1e-12 * largest
        if contact.friction.size:
            assert (np.abs(contact.friction) <= mu * contact.force + 1e-12 * largest).all()


def random_rod(seed: int) -> lg.System:
    """Return a rod that falls on a floor beside a wall, with friction and restitution of each end at random."""
    rng = np.random.default_rng(seed)
    x, y, theta = lg.coordinates("x y theta")
    mass, half, tilt = float(rng.uniform(0.5, 2)), float(rng.uniform(0.3, 1)), float(rng.uniform(-1.3, 1.3))
    contacts = {}
    for name, side in (("a", -half), ("b", half)):
        across, up = x + side * cos(theta), y + side * sin(theta)
        mu, e = float(rng.choice([0, 0.3, 0.9])), float(rng.choice([0, 0.3, 0.7]))
        contacts[name] = lg.contact(up, diff(across, lg.t) if mu else None, friction=(mu, mu / 2), restitution=e)
        contacts[name + "_wall"] = lg.contact(across + 1, restitution=e)
    start = {theta: tilt, y: half * abs(np.sin(tilt)), x: 0.3, x.dot: float(rng.normal()), theta.dot: 1.0}
    kinetic = mass * (x.dot**2 + y.dot**2) / 2 + mass * half**2 / 6 * theta.dot**2
    return lg.System(kinetic, mass * 9.81 * y, contacts=contacts, simultaneous=str(rng.choice(LAWS)), initial=start)


@pytest.mark.parametrize("seed", range(6))
def test_a_rod_comes_to_rest_with_the_energy_that_its_ends_have_lost(seed: int) -> None:
    """Ends that bounce in turn accumulate again and again; flat on the floor, its slips and gaps depend on each other.

    A velocity has a part of round-off in one of them and a large one in another.
    """
    run = random_rod(seed).run(2.0, rtol=1e-12).require()
    total = run.energy + run.energy_lost
    assert np.abs(total - total[0]).max() < 1e-11 * np.abs(run.energy).max()
    assert min(contact.gap.min() for contact in run.contacts.values()) > -1e-14


def test_a_slip_of_round_off_that_closing_the_gap_turns_around_is_at_rest() -> None:
    """Friction pushed along the slip: the event at which it stops does not come."""
    x, y, theta = lg.coordinates("x y theta")
    floor = lg.contact(y - sin(theta), slip=diff(x + cos(theta), lg.t), friction=0.2)
    kinetic = (x.dot**2 + y.dot**2) / 2 + theta.dot**2 / 24
    model = lg.System(kinetic, 9.81 * y, contacts={"floor": floor}).compile()
    kinematics = Kinematics(model, np.empty(0))
    transitions = Transitions(modes_of(model), kinematics, 1.0, 1e-12)
    angle, mode = np.radians(75), Mode(("open",), (None,))
    place = [0.0, np.sin(angle), angle]
    # The largest velocities so far say what is round-off of a gap rate and a slip.
    kinematics.at(0.0, np.array([*place, 1.0, 0.0, 0.0]))
    slip, rate = -1.01e-11, 0.99e-11
    for sign in (1, -1):
        following = transitions.behind(0.0, np.array([*place, slip, sign * rate, 0.0]), mode)
        moved = kinematics.at(0.0, following.y).rates[1]
        assert following.mode.states == ("sticking",) or following.mode.ways[0] * moved > 0


def test_closed_gaps_without_terms_have_round_off_and_no_missed_impact() -> None:
    (x, y), (u, w) = lg.coordinates("x y"), lg.coordinates("u w")
    contacts = {
        "left": lg.contact(y, slip=x.dot, friction=(0.3, 0.15)),
        "right": lg.contact(w, slip=u.dot, friction=0.6),
    }
    kinetic, weight = (x.dot**2 + y.dot**2) / 2 + 0.7 * (u.dot**2 + w.dot**2), 9.81 * (y + 1.4 * w)
    potential = weight + 6 * (u - x - sqrt(2) / 3) ** 2 + x**4 / 3
    system = lg.System(kinetic, potential, contacts=contacts, initial={x: 0.3, u: 2, x.dot: 0.7, u.dot: -0.5})
    run = system.run(4.0, rtol=1e-12).require()
    assert np.ptp(run.energy + run.energy_lost) < 1e-11 * np.abs(run.energy).max()


@pytest.mark.parametrize("steps", [2, 5, 9])
def test_a_run_that_stops_at_a_limit_keeps_its_energy(steps: int) -> None:
    run = random_discs(4).run(3.0, max_steps=steps)
    assert run.status is lg.Status.MAX_STEPS
    assert np.ptp(run.energy + run.energy_lost) < 1e-11 * np.abs(run.energy).max()


def test_a_limit_inside_the_loop_is_told_in_coordinates_of_the_system() -> None:
    run = random_slider(1).run(8.0, max_steps=5)
    assert run.status is lg.Status.MAX_STEPS
    assert (
        run.steps == 5 and "used up max_steps = 5 at t =" in run.message and "way" not in run.message.split("where")[1]
    )


def random_slider(seed: int) -> lg.System:
    """Return a block or a ball on a tilted belt that shakes, with a spring and a driving force, all at random."""
    rng = np.random.default_rng(seed)
    (x, y, phi), t = lg.coordinates("x y phi"), lg.t
    mass, tilt, spin = float(rng.uniform(0.5, 2)), float(rng.uniform(-0.3, 0.3)), float(rng.choice([0, 0.1]))
    along, height = x * cos(tilt) + y * sin(tilt), y * cos(tilt) - x * sin(tilt)
    belt = float(rng.normal()) / 3 + float(rng.choice([0, 0.3])) * cos(2 * t)
    static, share = float(rng.uniform(0.2, 0.7)), float(rng.choice([0.5, 1.0]))
    floor = lg.contact(height, along.diff(t) + spin * phi.dot - belt, friction=(static, share * static))
    drive = float(rng.uniform(0, 8)) * cos(float(rng.uniform(1, 3)) * t)
    start = {x: float(rng.normal()), x.dot: float(rng.normal()), phi.dot: float(rng.normal())}
    return lg.System(
        mass * (x.dot**2 + y.dot**2) / 2 + mass * phi.dot**2 / 50,
        mass * 9.81 * y + float(rng.uniform(2, 20)) * along**2 / 2,
        forces={x: drive * cos(tilt), y: drive * sin(tilt)},
        contacts={"belt": floor},
        initial=start | {y: start[x] * np.tan(tilt), y.dot: start[x.dot] * np.tan(tilt)},
    )


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 4, 9, 17, 18))])
def test_friction_inside_the_loop_is_that_of_a_look_at_each_change(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    looks, behind = list[float](), Transitions.behind

    def counted(self: Transitions, t: float, *state: Any, **ends: Any) -> Any:
        looks.append(t)
        return behind(self, t, *state, **ends)

    monkeypatch.setattr(Transitions, "behind", counted)
    system = random_slider(seed)
    inside = system.run(8.0, rtol=1e-12).require()
    assert looks == [0.0]
    monkeypatch.setattr(Kinematics, "held", lambda *_: False)
    outside = system.run(8.0, rtol=1e-12).require()
    found, reference = inside.trajectory.contacts, outside.trajectory.contacts
    assert found is not None and reference is not None
    assert len(looks) == 1 + len(reference.begins)
    assert [mode.states for mode in found.modes] == [mode.states for mode in reference.modes]
    # A time is known to the tolerance divided by the slope of the slip or of the force at its end, some 0.01 here.
    assert np.abs(found.begins - reference.begins).max() < 1e-9
    assert np.abs(inside.at(8.0) - outside.at(8.0)).max() < 1e-9
