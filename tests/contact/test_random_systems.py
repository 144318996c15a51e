"""Laws of contact on random systems, and on those that once broke them."""

from typing import Any

import numpy as np
import pytest
from sympy import cos, diff, sin

import lagrange as lg
from lagrange.trajectory.contact.kinematics import ContactState, Kinematics
from lagrange.trajectory.contact.modes import Mode, ModeEnd, modes_of
from lagrange.trajectory.contact.transition import Transitions
from tests.contact.random_contacts import broken_laws, random_system


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "seed", [2, 7, 9, 10, 12, 5, 13, 14, 16, 17, 21, 22, pytest.param(21_247, marks=pytest.mark.slow)]
)
def test_bodies_do_not_overlap_and_energy_goes_where_it_is_booked(seed: int) -> None:
    """Each law of `random_contacts`; `docs/benchmarks/random_contacts.py` takes 500 systems.

    In system 21,247 an impact of one corner comes at the instant at which the slip of another stops.
    """
    drawn = random_system(seed)
    run = drawn.system.run(drawn.end, rtol=1e-12).require()
    assert not broken_laws(drawn.system, run, driven=drawn.driven)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
@pytest.mark.parametrize("seed", [50_005, 50_008, 50_014, 50_025, 50_030, 50_044])
def test_the_laws_hold_to_the_default_tolerance(method: str, seed: int) -> None:
    drawn = random_system(seed)
    run = drawn.system.run(drawn.end, method=method).require()
    assert run.trajectory.rtol == 1e-9
    assert not broken_laws(drawn.system, run, driven=drawn.driven, error=1e-8)


@pytest.mark.slow
def test_a_run_that_is_used_up_by_impacts_says_of_which() -> None:
    """One end of this rod loses nothing, the other does: they bounce in turn, every 1e-6. It advised radau5."""
    drawn = random_system(40_108)
    message = drawn.system.run(drawn.end, rtol=1e-12, max_steps=700).message
    assert (
        "It used up max_steps in 350 changes of the mode, the last ones 1e-06 apart in time, by impacts of 'a' and 'b'."
        in message
    )


def test_a_body_that_contacts_leave_no_freedom_is_at_rest() -> None:
    """A double pendulum between a wall and a floor: velocities of round-off would begin a slip again and again."""
    a, b = lg.coordinates("a b")
    places = (sin(a), -cos(a)), (sin(a) + sin(b), -cos(a) - cos(b))
    kinetic = sum((diff(x, lg.t) ** 2 + diff(y, lg.t) ** 2) / 2 for x, y in places)
    (_, middle), (across, up) = places
    contacts = {"wall": lg.contact(across + 0.6, slip=diff(up, lg.t), friction=0.3), "floor": lg.contact(up + 1.845)}
    start = {a: 1.1, b: 1.1}
    system = lg.System(kinetic, 9.81 * (middle + up), contacts=contacts, simultaneous="newton", initial=start)
    run = system.run(3.0, rtol=1e-12).require()
    assert not run.y[2:, -1].any() and run.contacts["wall"].mode[-1] == "sticking"


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
        touch = kinematics.at(0.0, np.array([*place, slip, sign * rate, 0.0]))
        following = transitions.after(touch, mode, ModeEnd())
        moved = kinematics.at(0.0, following.y).rates[1]
        assert following.mode.states == ("sticking",) or following.mode.ways[0] * moved > 0


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
    looks, after = list[float](), Transitions.after

    def counted(self: Transitions, touch: ContactState, mode: Mode, *ends: Any) -> Any:
        looks.append(touch.t)
        return after(self, touch, mode, *ends)

    monkeypatch.setattr(Transitions, "after", counted)
    system = random_slider(seed)
    inside = system.run(8.0, rtol=1e-12).require()
    assert looks == [0.0]
    monkeypatch.setattr(Kinematics, "held", lambda *_: False)
    outside = system.run(8.0, rtol=1e-12).require()
    result, reference = inside.trajectory.contacts, outside.trajectory.contacts
    assert result is not None and reference is not None
    assert len(looks) == 1 + len(reference.begins)
    assert [mode.states for mode in result.modes] == [mode.states for mode in reference.modes]
    # A time is known to the tolerance divided by the slope of the slip or of the force at its end, some 0.01 here.
    assert np.abs(result.begins - reference.begins).max() < 1e-9
    assert np.abs(inside.at(8.0) - outside.at(8.0)).max() < 1e-9


def test_a_limit_inside_the_loop_is_told_in_coordinates_of_the_system() -> None:
    run = random_slider(1).run(8.0, max_steps=5)
    assert run.status is lg.Status.MAX_STEPS
    assert (
        run.steps == 5 and "used up max_steps = 5 at t =" in run.message and "way" not in run.message.split("where")[1]
    )
