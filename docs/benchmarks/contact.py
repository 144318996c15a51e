"""Contact: a ball that bounces to rest beside MuJoCo, bounces beside resets of events, and stick-slip on a belt.

python docs/benchmarks/contact.py    (with the package mujoco)
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from measure import Page, best, microseconds, milliseconds, shown, verdict

import lagrange as lg

REST_BAR, BOUNCE_BAR, SHORT_BAR, CHANGE_BAR = 0.1, 1.0, 1.5, 1e-5
STEPS, UNDAMPED, DAMPED = (2e-3, 1e-3, 1e-4), "-100000 0", "-100000 -45"
"""Steps of MuJoCo in seconds, and the stiffness and damping of its contacts; ours has a restitution of 0.8."""

G, SECONDS, BOUNCES, SHORT, BELT = 9.81, 10.0, 20_000.0, 2.0, 20_000.0


def ball(restitution: float) -> lg.System:
    """Return a ball that falls from 1 m, with a floor as a contact."""
    y, (m, g) = lg.coordinate("y"), lg.parameters("m g")
    floor = lg.contact(y, restitution=restitution)
    return lg.System(m * y.dot**2 / 2, m * g * y, contacts={"floor": floor}, parameters={m: 1, g: G}, initial={y: 1})


def reset_ball() -> tuple[lg.System, Any]:
    """Return the ball without a contact, and an event that reverses its velocity at the floor."""
    y, (m, g) = lg.coordinate("y"), lg.parameters("m g")
    system = lg.System(m * y.dot**2 / 2, m * g * y, parameters={m: 1, g: G}, initial={y: 1})
    return system, lg.event(y, direction=-1, reset={y.dot: -y.dot})


def belt() -> lg.System:
    """Return a block on a running belt, held by a spring."""
    x, y = lg.coordinates("x y")
    contact = lg.contact(y, slip=x.dot - 0.2, friction=(0.6, 0.3))
    return lg.System((x.dot**2 + y.dot**2) / 2, 10 * y + 5 * x**2, contacts={"belt": contact}, initial={x.dot: 0.2})


def rival(step: float, contact: str) -> tuple[Any, Any]:
    """Return MuJoCo's model of a sphere that falls by 1 m, and its data."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step}" gravity="0 0 -{G}"/><worldbody>'
        f'<geom type="plane" size="1 1 .1" solref="{contact}"/><body pos="0 0 1.1"><joint type="slide" axis="0 0 1"/>'
        f'<geom type="sphere" size=".1" mass="1" solref="{contact}"/></body></worldbody></mujoco>'
    )
    return model, mujoco.MjData(model)


def apex(step: float) -> float:
    """Return the height of the first bounce of MuJoCo's sphere without damping."""
    model, data = rival(step, UNDAMPED)
    heights = []
    for _ in range(round(1.3 / step)):
        mujoco.mj_step(model, data)
        heights.append(1 + data.qpos[0])
    return float(max(heights[int(np.argmin(heights)) :]))


def changes_of(run: lg.Solution) -> int:
    """Return the number of modes of a run."""
    history = run.trajectory.contacts
    return 0 if history is None else len(history.begins)


def main() -> None:
    """Write the tables."""
    page = Page("Contact", __file__)
    resting, elastic, (free, floor), moved = ball(0.8), ball(1.0), reset_ball(), belt()
    box = lg.scene("box-on-corner")
    page.table(("MuJoCo's step, s", "first apex of 1 m, m"), [(f"{step:g}", f"{apex(step):.4f}") for step in STEPS])
    model, data = rival(STEPS[-1], DAMPED)

    def theirs() -> None:
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, round(SECONDS / STEPS[-1]))

    t = best(
        {
            "rest": lambda: resting.run(SECONDS),
            "MuJoCo": theirs,
            "contact": lambda: elastic.run(BOUNCES),
            "event": lambda: free.run(BOUNCES, events=[floor]),
            "short": lambda: elastic.run(SHORT),
            "short event": lambda: free.run(SHORT, events=[floor]),
            "belt": lambda: moved.run(BELT),
            "box": box.run,
        },
        rounds=7,
    )
    bounces = len(elastic.run(BOUNCES).contacts["floor"].impacts)
    changes, others = changes_of(moved.run(BELT)), changes_of(box.run())
    rest, bounce, change = t["rest"] / t["MuJoCo"], t["contact"] / t["event"], t["belt"] / changes
    short, event = t["short"], t["short event"]
    rows = [
        ("ball to rest, 10 s, ms", milliseconds(t["rest"]), milliseconds(t["MuJoCo"]), rest, REST_BAR),
        ("bounce, us", microseconds(t["contact"] / bounces), microseconds(t["event"] / bounces), bounce, BOUNCE_BAR),
        ("a run of two bounces, us", microseconds(short), microseconds(event), short / event, SHORT_BAR),
    ]
    page.table(
        ("case", "contact", "MuJoCo, or an event", "ratio", "bar", "met"),
        [(*row[:3], shown(row[3]), row[4], verdict(row[3], row[4])) for row in rows],
    )
    page.text(
        f"Stick-slip on a belt: {changes} changes at {microseconds(change)} us each; at most "
        f"{microseconds(CHANGE_BAR)}: {verdict(change, CHANGE_BAR)}. A box on its corner: {others} changes at "
        f"{microseconds(t['box'] / others)} us each."
    )
    page.write()


if __name__ == "__main__":
    main()
