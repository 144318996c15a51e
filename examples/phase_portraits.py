"""Phase portraits of a pendulum, theta'' = -sin(theta), by three methods with a short and with a long step.

RK4 knows nothing of the geometry. The variational method of the trapezoidal rule [1], Stormer's and Verlet's,

    theta[n-1] - 2 theta[n] + theta[n+1] = -h^2 sin(theta[n]),

conserves areas and nothing else; it is the standard map, whose separatrix is a chaotic layer. The integrable one [2],

    theta[n-1] - 2 theta[n] + theta[n+1] = -4 arg(1 + h^2/4 e^(i theta[n])),

has an invariant as well, which is the energy up to h^2:

    I = cos((theta[n+1] - theta[n])/2) + h^2/4 cos((theta[n+1] + theta[n])/2) = 1 - h^2/4 (v^2/2 - cos(theta)) + O(h^4).

With u = e^(i theta[n+1]/2), z = e^(i theta[n]/2), w = e^(i theta[n-1]/2) and e = h^2/4 it reads
u w (1 + e z^2) = z^2 + e, so that u and w are the two roots of u^2 (1 + e z^2) - 2 I u z + z^2 + e = 0, which is
symmetric in u and z. The sign is that of the hanging pendulum, theta = 0 below: arg(1 + e e^(i theta)) is e sin(theta)
up to e^2, and with a plus in front of the 4 the map would be that of the pendulum measured from above.

[1] J. E. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 10, 2001, section 2.3.
[2] Yu. B. Suris, Integrable mappings of the standard type, Functional Analysis and Its Applications 23, 1989.

    python examples/phase_portraits.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj, ellipk
from sympy import Rational, atan, cos, sin

import lagrange as lg
from lagrange.show.dynamics import PoincareSection

STEPS = (0.1, 0.9)
COUNT = 3000
SPEEDS = (0.5, 1.0, 1.4, 1.7, 1.8, 1.9, 1.97, 2.03, 2.15, 2.5)
"""Those with which the pendulum passes its lowest point; from 2 on it turns over."""

METHODS = ("RK4", "variational", "integrable")
AMPLITUDE, SHORT = 1.5, 2.0

Array = NDArray[np.float64]


def pendulum(method: str, h: float) -> lg.System:
    """Return the pendulum, or for the integrable map one whose force stands for -sin(theta) at this step."""
    theta = lg.coordinate("theta")
    if method != "integrable":
        return lg.System(kinetic=theta.dot**2 / 2, potential=-cos(theta), name="pendulum")
    e = Rational(str(h)) ** 2 / 4
    angle = atan(e * sin(theta) / (1 + e * cos(theta)))
    return lg.System(kinetic=theta.dot**2 / 2, forces={theta: -angle / e}, coordinates=[theta], name="integrable map")


def orbits(method: str, h: float, count: int, starts: Sequence[tuple[float, float]]) -> PoincareSection:
    """Return the states after each of the steps: the map of a method is a section of its own motion."""
    named = "rk4" if method == "RK4" else "velocity-verlet"
    return lg.poincare(pendulum(method, h), h, [list(one) for one in starts], crossings=count, method=named, step=h)


def orbit(method: str, h: float, count: int, theta: float, speed: float) -> tuple[Array, Array]:
    """Return the angles and the speeds at the start and after each of the steps, (count + 1,) each."""
    return with_start(orbits(method, h, count, [(theta, speed)]), 0)


def with_start(found: PoincareSection, place: int) -> tuple[Array, Array]:
    """Return the angles and the speeds of one of the orbits, its start before them."""
    angles, speeds = np.vstack([found.starts[place], found.states[place]]).T
    return angles, speeds


def residual(method: str, h: float, theta: Array) -> float:
    """Return how far angles are off the recursion of the method as it is written above."""
    middle = theta[1:-1]
    force = -(h**2) * np.sin(middle) if method == "variational" else -4 * np.angle(1 + h**2 / 4 * np.exp(1j * middle))
    return float(np.abs(theta[:-2] - 2 * middle + theta[2:] - force).max())


def invariant(h: float, theta: Array) -> Array:
    """Return the invariant of the integrable map, as an energy, between the steps."""
    now, then = theta[:-1], theta[1:]
    found = np.cos((then - now) / 2) + h**2 / 4 * np.cos((then + now) / 2)
    return np.asarray((1 - found) * 4 / h**2)


def exact_angle(t: float) -> float:
    """Return the angle of a pendulum that starts at rest at the amplitude."""
    k2 = np.sin(AMPLITUDE / 2) ** 2
    return float(2 * np.arcsin(np.sqrt(k2) * ellipj(ellipk(k2) - t, k2)[0]))


def order(method: str) -> float:
    """Return the observed order: log2 of the ratio of the errors with two steps."""
    errors = [abs(orbit(method, h, round(SHORT / h), AMPLITUDE, 0.0)[0][-1] - exact_angle(SHORT)) for h in (0.02, 0.01)]
    return float(np.log2(errors[0] / errors[1]))


def measured(method: str, h: float, orbits: list[tuple[Array, Array]]) -> dict[str, float]:
    """Return how far orbits are off the recursion, and how far energy and invariant move along them."""
    return {
        "recursion": max(residual(method, h, theta) for theta, _ in orbits),
        "energy": max(float(np.ptp(speed**2 / 2 - np.cos(theta))) for theta, speed in orbits),
        "invariant": max(float(np.ptp(invariant(h, theta))) for theta, _ in orbits),
    }


def picture(found: dict[tuple[str, float], PoincareSection], path: Path) -> None:
    """Draw the portraits: a row for each step, a column for each method."""
    figure = lg.figure(len(STEPS), len(METHODS), size=(11.4, 7.2))
    for axis, ((method, h), portrait) in zip(figure.axes, found.items(), strict=True):
        portrait.plot(ax=axis)
        axis.set_title(f"{method}, step {h:g}", loc="left", fontsize=10)
        axis.set(xlim=(-np.pi, np.pi), ylim=(-3.1, 3.1))
    figure.savefig(path, dpi=130)


def main(folder: Path = Path("out")) -> dict[tuple[str, float], dict[str, float]]:
    """Print the table, save the picture and return what was measured, by method and step."""
    portraits: dict[tuple[str, float], PoincareSection] = {}
    found: dict[tuple[str, float], dict[str, float]] = {}
    heads = ("step", 5), ("order", 8), ("off the recursion", 20), ("energy moves", 15), ("invariant moves", 18)
    print(f"{'method':<12}" + "".join(f"{head:>{width}}" for head, width in heads))
    for h in STEPS:
        for method in METHODS:
            portraits[method, h] = orbits(method, h, COUNT, [(0.0, speed) for speed in SPEEDS])
            several = [with_start(portraits[method, h], k) for k in range(len(SPEEDS))]
            row = {"order": order(method), **measured(method, h, several)}
            found[method, h] = row
            off = "" if method == "RK4" else f"{row['recursion']:.1e}"
            print(
                f"{method:<12}{h:5.1f}  {row['order']:6.2f}  {off:>18}  {row['energy']:13.1e}  {row['invariant']:16.1e}"
            )
    folder.mkdir(parents=True, exist_ok=True)
    picture(portraits, folder / "phase_portraits.png")
    print(f"wrote {folder / 'phase_portraits.png'}")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
