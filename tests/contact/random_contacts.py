"""Random systems with up to four contacts, and the laws that a run through them obeys."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from sympy import cos, diff, sin, sqrt

import lagrange as lg
from lagrange.statement.contact import Contact

G, LAWS, RESTITUTIONS = 9.81, ("newton", "sequence"), (0.0, 0.3, 0.7, 1.0)

ENERGY, OVERLAP, CONE, DIRECTION = 1e-11, 1e-12, 1e-12, 1e-9
"""Largest change of the energy with that lost, as a part of the energy; overlap, as a part of the largest coordinate;
friction beyond its cone, or pull of a surface, as a part of the largest normal force; and power that friction adds, as
a part of the largest force and slip."""


@dataclass(frozen=True, eq=False)
class RandomSystem:
    """A system, the length of its run, and whether a belt, a table or a force does work on it."""

    system: lg.System
    end: float
    driven: bool


class Draw:
    """Random numbers of one system, and the energies, contacts and start that they make."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.kinetic: Any = 0
        self.potential: Any = 0
        self.contacts: dict[str, Contact] = {}
        self.forces: dict[Any, Any] = {}
        self.start: dict[Any, float] = {}
        self.driven = False

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def normal(self) -> float:
        return float(self.rng.normal())

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def shake(self, size: float, share: float) -> Any:
        """Return a height that oscillates, or zero."""
        if not self.chance(share):
            return 0
        self.driven = True
        return size * sin(self.between(3, 12) * lg.t)

    def speed(self, share: float) -> float:
        """Return the speed of a belt, zero for one that stands."""
        moves = self.chance(share)
        self.driven |= moves
        return self.normal() / 2 if moves else 0.0

    def touch(self, name: str, gap: Any, *slip: Any) -> None:
        """Add a contact with random friction and restitution."""
        static = float(self.rng.choice([0, 0.1, 0.3, 0.6, 0.9]))
        kinetic = static * float(self.rng.choice([0.5, 0.8, 1, 1]))
        restitution = float(self.rng.choice(RESTITUTIONS))
        law = {"slip": slip, "friction": (static, kinetic)} if static else {}
        self.contacts[name] = lg.contact(gap, restitution=restitution, **law)

    def point(self, name: str, rotary: float = 0.0) -> tuple[Any, ...]:
        """Return coordinates x, y and an angle of a body in a plane under gravity, with a moment of inertia / mass."""
        x, y, theta = lg.coordinates(f"x{name} y{name} theta{name}")
        mass = self.between(0.5, 2)
        self.kinetic += mass * (x.dot**2 + y.dot**2 + rotary * theta.dot**2) / 2
        self.potential += mass * G * y
        return x, y, theta

    def random_system(self, end: float) -> RandomSystem:
        law = str(self.rng.choice(LAWS))
        energies = self.kinetic, self.potential
        system = lg.System(
            *energies, forces=self.forces, contacts=self.contacts, simultaneous=law, initial=self.start, name="random"
        )
        return RandomSystem(system, end, self.driven)


def discs(draw: Draw) -> RandomSystem:
    """One or two discs that fall on a floor that may shake, with walls, each other and a spring between them."""
    bodies = []
    shake = draw.shake(0.05, 1 / 3)
    for i in range(draw.rng.integers(1, 3)):
        r, tilt = draw.between(0.1, 0.3), float(draw.rng.choice([0, 0.2]))
        x, y, phi = draw.point(str(i), r**2 / 2)
        bodies.append((x, y, phi, r))
        height = r / np.cos(tilt) + 2 * i * np.tan(tilt) + max(0.0, draw.normal())
        draw.start |= {x: 2.0 * i, y: height, x.dot: draw.normal(), phi.dot: 5 * draw.normal()}
        along = x.dot * cos(tilt) + y.dot * sin(tilt) + r * phi.dot
        draw.touch(f"floor{i}", y * cos(tilt) - x * sin(tilt) - r - shake, along)
        if draw.chance(0.5):
            draw.touch(f"wall{i}", 4 - x - r, y.dot + r * phi.dot)
    if len(bodies) == 2 and len(draw.contacts) < 4:
        (x, y, phi, r), (u, v, psi, s) = bodies
        distance = sqrt((u - x) ** 2 + (v - y) ** 2)
        slip = ((v.dot - y.dot) * (u - x) - (u.dot - x.dot) * (v - y)) / distance - s * psi.dot - r * phi.dot
        draw.touch("pair", distance - r - s, slip)
        draw.potential += float(draw.rng.choice([0, 5])) * ((u - x) ** 2 + (v - y) ** 2) / 2
    return draw.random_system(3.0)


def box(draw: Draw) -> RandomSystem:
    """A box with two to four corners that falls on a plane, which may be tilted and shake."""
    a, b = draw.between(0.2, 0.6), draw.between(0.2, 0.6)
    x, y, theta = draw.point("", (a**2 + b**2) / 3)
    shake, tilt = draw.shake(0.03, 1 / 4), float(draw.rng.choice([0, 0.15]))
    count = int(draw.rng.integers(2, 5))
    for name, (w, h) in list(zip("abcd", ((-a, -b), (a, -b), (a, b), (-a, b)), strict=True))[:count]:
        across, up = x + w * cos(theta) - h * sin(theta), y + w * sin(theta) + h * cos(theta)
        along = diff(across * cos(tilt) + up * sin(tilt), lg.t)
        draw.touch(name, up * cos(tilt) - across * sin(tilt) - shake, along)
    height = np.hypot(a, b) / np.cos(tilt) + abs(draw.normal()) / 2 + 0.05
    draw.start |= {y: height, theta: 0.3 * draw.normal(), x.dot: draw.normal(), theta.dot: draw.normal()}
    return draw.random_system(2.0 if count > 2 else 1.2)


def spheres(draw: Draw) -> RandomSystem:
    """One or two masses with springs on a plane that may move, with friction in a disc, and walls."""
    for i in range(draw.rng.integers(1, 3)):
        (x, y, z), mass, spring = lg.coordinates(f"x{i} y{i} z{i}"), draw.between(0.5, 2), draw.between(1, 10)
        draw.kinetic += mass * (x.dot**2 + y.dot**2 + z.dot**2) / 2
        draw.potential += mass * G * z + spring * ((x - 2 * i) ** 2 + y**2) / 2
        draw.touch(f"floor{i}", z, x.dot - draw.speed(0.5), y.dot)
        if draw.chance(0.5):
            draw.touch(f"wall{i}", 3.0 + 2 * i - x, y.dot, z.dot)
        height = float(draw.rng.choice([0, abs(draw.normal())]))
        draw.start |= {x: 2.0 * i, z: height, x.dot: draw.normal(), y.dot: draw.normal()}
    return draw.random_system(3.0)


def blocks(draw: Draw) -> RandomSystem:
    """One to three blocks on belts, coupled by springs; a force may drive the last, which may meet a wall."""
    before: Any = 0
    for i in range(draw.rng.integers(1, 4)):
        x, y, _ = draw.point(str(i), 1)
        draw.touch(f"belt{i}", y, x.dot - draw.speed(1 / 3))
        draw.potential += draw.between(2, 20) * (x - before - 1) ** 2 / 2
        height = float(draw.rng.choice([0, 0, 0.3]))
        draw.start |= {x: 2.0 * i + draw.normal(), x.dot: draw.normal(), y: height}
        before = x
    if draw.chance(0.3):
        draw.forces, draw.driven = {x: draw.between(0, 8) * cos(draw.between(1, 3) * lg.t)}, True
    if draw.chance(0.4):
        draw.touch("wall", max(6.0, draw.start[x] + 0.5) - x, y.dot)
    return draw.random_system(4.0)


def rods(draw: Draw) -> RandomSystem:
    """A rod that falls on a floor beside a wall. Its ends bounce in turn, and accumulate again and again."""
    half = draw.between(0.3, 1)
    x, y, theta = draw.point("", half**2 / 3)
    for name, side in (("a", -half), ("b", half)):
        across, up = x + side * cos(theta), y + side * sin(theta)
        draw.touch(name, up, diff(across, lg.t))
        if draw.chance(0.5):
            draw.touch(f"wall_{name}", across + 1, diff(up, lg.t))
    tilt, height = draw.between(-1.3, 1.3), float(draw.rng.choice([0, abs(draw.normal()) / 2]))
    draw.start |= {theta: tilt, y: half * abs(np.sin(tilt)) + height, x: 0.3, x.dot: draw.normal()}
    draw.start[theta.dot] = draw.normal()
    return draw.random_system(1.5)


def pendula(draw: Draw) -> RandomSystem:
    """A double pendulum between a wall, a stop and a floor."""
    a, b = lg.coordinates("a b")
    x, y = sin(a), -cos(a)
    u, v = x + sin(b), y - cos(b)
    for across, up in ((x, y), (u, v)):
        mass = draw.between(0.5, 2)
        draw.kinetic += mass * (diff(across, lg.t) ** 2 + diff(up, lg.t) ** 2) / 2
        draw.potential += mass * G * up
    draw.touch("wall", u + draw.between(0.2, 0.8), diff(v, lg.t))
    if draw.chance(0.5):
        draw.touch("stop", x + draw.between(0.2, 0.8), diff(y, lg.t))
    if draw.chance(0.5):
        draw.touch("floor", v + draw.between(1.6, 1.9), diff(u, lg.t))
    draw.start |= {a: draw.between(0.6, 1.2), b: draw.between(0.6, 1.3)}
    return draw.random_system(3.0)


KINDS = (discs, box, spheres, blocks, rods, pendula)


def random_system(seed: int) -> RandomSystem:
    """Return the system of a seed: kinds take turns."""
    return KINDS[seed % len(KINDS)](Draw(seed))


def broken_laws(system: lg.System, run: lg.Solution, *, driven: bool, error: float = 0.0) -> list[str]:
    """Return a text for each law that a run breaks, with the size by which it does.

    `error` is the relative error that the tolerance of the run allows, if it is larger than the limits above.
    """
    texts = []
    total = run.energy + run.energy_lost
    change = float(np.ptp(total) / np.abs(run.energy).max())
    if change > max(ENERGY, error) and not driven:
        texts.append(f"energy {change:.2g}")
    length = max(1.0, float(np.abs(run.y[: len(system.coordinates)]).max()))
    largest = max(1.0, *(float(contact.force.max()) for contact in run.contacts.values()))
    for stated, contact in zip(system.statement.contacts, run.contacts.values(), strict=True):
        static, kinetic = map(float, stated.friction)
        allowed = np.where(contact.mode == "sticking", static, kinetic) * contact.force
        friction = np.atleast_2d(contact.friction)
        beyond = np.linalg.norm(friction, axis=0) - allowed if friction.size else np.zeros(1)
        slips = np.array([run.evaluate(slip) for slip in stated.slip])
        power = (friction * slips).sum(axis=0) * (contact.mode == "sliding") if friction.size else np.zeros(1)
        sizes = {
            "gap": -contact.gap.min() / length / max(OVERLAP, error),
            "pull": -contact.force.min() / largest / max(CONE, error),
            "cone": beyond.max() / largest / max(CONE, error),
            # Friction takes energy. A slip that begins has a direction of round-off.
            "direction": power.max() / largest / max(max(DIRECTION, error) * np.abs(slips).max(initial=0.0), 1e-300),
        }
        texts += [f"{law} of {stated.name} {size:.2g} times the limit" for law, size in sizes.items() if size > 1]
    return texts
