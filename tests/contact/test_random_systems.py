"""Laws of contact on random systems: discs that fall on planes and on each other, with up to four contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.statement.contact import Contact

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


@pytest.mark.parametrize("steps", [2, 5, 9])
def test_a_run_that_stops_at_a_limit_keeps_its_energy(steps: int) -> None:
    run = random_discs(4).run(3.0, max_steps=steps)
    assert run.status is lg.Status.MAX_STEPS
    assert np.ptp(run.energy + run.energy_lost) < 1e-11 * np.abs(run.energy).max()
