"""Rotations: a free body beside heyoka on equations by hand and beside MuJoCo, and the length of the quaternion.

python docs/benchmarks/rotations.py    (with the packages heyoka and mujoco)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import heyoka as hy
import mujoco
import numpy as np
from measure import Page, best, microseconds, shown, verdict
from numpy.typing import NDArray
from sympy import diag

import lagrange as lg

MOMENTS, RATES, TURN = (1.0, 2.0, 3.0), (0.3, 1.0, 0.2), (1.0, 0.0, 0.0, 0.0)
HEYOKA_BAR, SPEED_BAR, LENGTH_BAR = 1.2, 20.0, 1e-13
"""Largest ratio to the time of heyoka, smallest ratio of the time of MuJoCo, and largest error of the length."""

ERROR, LOOSE = 1e-6, 1e-7
"""Error of the attitude that MuJoCo's step is chosen for, and our tolerance with a smaller error."""

LONG, TIGHT, STEPS = 2000.0, 1e-12, 100_000
"""Seconds of a run beside heyoka and its tolerance; steps over which the length is watched."""


def body() -> tuple[lg.System, Any]:
    """Return a free body with three different moments of inertia, and its rotation."""
    R = lg.rotation("R")
    return lg.System(R.body.dot(diag(*MOMENTS) * R.body) / 2, initial={R: TURN, R.body: RATES}), R


def by_hand(tolerance: float) -> Any:
    """Return heyoka's integrator of Euler's three equations and the four of the quaternion."""
    a, b, c = hy.make_vars("a", "b", "c")
    w, x, y, z = hy.make_vars("w", "x", "y", "z")
    first, second, third = MOMENTS
    equations = [
        (a, (second - third) / first * b * c),
        (b, (third - first) / second * c * a),
        (c, (first - second) / third * a * b),
        (w, -0.5 * (x * a + y * b + z * c)),
        (x, 0.5 * (w * a + y * c - z * b)),
        (y, 0.5 * (w * b + z * a - x * c)),
        (z, 0.5 * (w * c + x * b - y * a)),
    ]
    return hy.taylor_adaptive(equations, [*RATES, *TURN], tol=tolerance)


def rival(step: float) -> tuple[Any, Any]:
    """Return MuJoCo's model of the body, by Runge-Kutta of order 4, and its data at the start."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step}" gravity="0 0 0" integrator="RK4"/><worldbody><body><freejoint/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="{" ".join(map(str, MOMENTS))}"/></body></worldbody></mujoco>'
    )
    return model, mujoco.MjData(model)


def turned(model: Any, data: Any, steps: int) -> NDArray[np.float64]:
    """Return MuJoCo's quaternion after some steps from the start."""
    mujoco.mj_resetData(model, data)
    data.qvel[3:] = RATES
    mujoco.mj_step(model, data, steps)
    return np.array(data.qpos[3:7])


def apart(quaternion: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the angle in radians between two attitudes, which must be small."""
    aligned = np.sign(quaternion @ other) * quaternion / np.linalg.norm(quaternion)
    return 2 * float(np.linalg.norm(aligned - other / np.linalg.norm(other)))


def main() -> None:
    """Write the tables."""
    page = Page("Rotations", __file__)
    system, _ = body()
    beside_heyoka(page, system)
    beside_mujoco(page, system)
    lengths(page, system)
    page.write()


def beside_heyoka(page: Page, system: lg.System) -> None:
    """Add the times of long runs."""
    flow, start, hand = lg.flow(system.compile(), rtol=TIGHT), system.run(1.0).y[:, 0], by_hand(TIGHT)

    def theirs() -> NDArray[np.float64]:
        hand.time, hand.state[:] = 0.0, [*RATES, *TURN]
        hand.propagate_until(LONG)
        return np.array(hand.state[3:])

    far = apart(flow(start, 0.0, LONG)[:4], theirs())
    t = best({"flow": lambda: flow(start, 0.0, LONG), "heyoka": theirs}, rounds=7)
    ratio = t["flow"] / t["heyoka"]
    page.table(
        (f"free body, {LONG:g} s at {TIGHT:g}", "lagrange, us", "heyoka, us", "ratio", "bar", "met"),
        [("by flow", *map(microseconds, t.values()), shown(ratio), HEYOKA_BAR, verdict(ratio, HEYOKA_BAR))],
    )
    page.text(f"The attitudes of both agree to {far:.1g} rad.")


def beside_mujoco(page: Page, system: lg.System) -> None:
    """Add the times of runs of different lengths to an attitude error of `ERROR`."""
    flow, start, rows = lg.flow(system.compile(), rtol=LOOSE), system.run(1.0).y[:, 0], []
    for end in (1.0, 10.0, 100.0):
        exact, steps = system.run(end, rtol=1e-14).y[:4, -1], 2
        while not apart(turned(*rival(end / steps), steps), exact) <= ERROR:  # Long steps end at NaN
            steps = max(steps + 1, round(1.05 * steps))
        model, data = rival(end / steps)
        own = apart(flow(start, 0.0, end)[:4], exact)
        runs: dict[str, Callable[[], Any]] = {
            "flow": partial(flow, start, 0.0, end),
            "run": partial(system.run, end, rtol=LOOSE),
            "MuJoCo": partial(turned, model, data, steps),
        }
        t = best(runs, rounds=7)
        ratios = [t["MuJoCo"] / t[name] for name in ("flow", "run")]
        rows.append((f"{end:g}", f"{own:.1g}", *map(microseconds, t.values()), *map(shown, ratios)))
    page.table(("seconds", "our error", "flow, us", "run, us", "MuJoCo, us", "by flow", "by run"), rows)
    page.text(f"At least {SPEED_BAR:g} times the speed of MuJoCo to an error of {ERROR:g} rad is asked.")


def lengths(page: Page, system: lg.System) -> None:
    """Add the errors of the length of the quaternion over many steps."""
    rows = []
    for rtol in (1e-9, 1e-10, 1e-12):
        few = system.run(100.0, rtol=rtol)
        run = system.run(100.0 * STEPS / few.steps, rtol=rtol)
        error = float(np.abs(np.linalg.norm(run.y[:4], axis=0) - 1).max())
        rows.append((f"{rtol:g}", run.steps, f"{error:.2g}", verdict(error, LENGTH_BAR)))
    page.table(("rtol", "steps", "largest error of the length", f"within {LENGTH_BAR:g}"), rows)


if __name__ == "__main__":
    main()
