"""Monte Carlo of a throw: where a ball lands if speed, angle and wind are not known exactly.

The ball of mass m feels its weight and the drag of the air [1], which moves with the wind w along x:

    F = -k |v - w| (v - w).

Speed and angle of the throw are normal, the wind is of Weibull's distribution, as is usual for its speed. Each member
of the ensemble is one throw; the first event of a run is the landing.

[1] J. R. Taylor, Classical Mechanics, 2005, section 2.4.

    python examples/throw_in_wind.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm, weibull_min
from sympy import sqrt

import lagrange as lg

THROWS = 2048
SPEED, ANGLE, WIND = norm(20.0, 0.5), norm(np.radians(45.0), np.radians(2.0)), weibull_min(2.0, scale=4.0)
"""m/s, radians, and m/s with the throw."""

BLUE, RED = "#0b6e99", "#d1495b"

Array = NDArray[np.float64]


def ball() -> lg.System:
    """Return a ball in the air, with the mass of a baseball, which the air slows three times as much as one."""
    x, y = lg.coordinates("x y")
    m, g, k = lg.parameters("m g k")
    wind = lg.parameters("w", positive=False)
    along, up = x.dot - wind, y.dot
    speed = sqrt(along**2 + up**2)
    return lg.System(
        kinetic=lg.kinetic_energy(m, (x, y)),
        potential=lg.gravity(m, (x, y), g),
        forces={x: -k * speed * along, y: -k * speed * up},
        parameters={m: 0.145, g: 9.81, k: 0.004, wind: 0.0},
        initial={y: 1.5},
        name="throw in wind",
    )


def throws(count: int = THROWS, seed: int = 1) -> lg.Ensemble:
    """Return an ensemble of throws, each until it is on the ground."""
    system = ball()
    drawn = lg.sample({"speed": SPEED, "angle": ANGLE, "w": WIND}, count, seed=seed)
    speed, angle = drawn["speed"], drawn["angle"]
    initial = {"x_dot": speed * np.cos(angle), "y_dot": speed * np.sin(angle)}
    ground = lg.event(system.coordinates[1], direction=-1, terminal=True)
    return lg.ensemble(
        system, 10.0, initial, parameters={"w": drawn["w"]}, events=[ground], keep=("end", ("events", 1))
    )


def paths(runs: lg.Ensemble, some: int = 60) -> list[Array]:
    """Return x and y of some throws, (2, 80) each."""
    system = ball()
    found = []
    for i in range(some):
        start = {name: float(runs.given(name)[i]) for name in ("x_dot", "y_dot")}
        end = float(runs.t_events[0][i, 0])
        run = system.run(end, start, parameters={"w": float(runs.given("w")[i])}, t_eval=np.linspace(0.0, end, 80))
        found.append(run.y[:2])
    return found


def picture(runs: lg.Ensemble, path: Path) -> None:
    """Draw some paths, where all throws land, and how much of that is the wind's doing."""
    landed = runs.y_events[0][:, 0, 0]
    levels = np.quantile(landed, [0.05, 0.5, 0.95])
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    places = figure.add_gridspec(2, 2, width_ratios=(1.7, 1.0))
    above, below, beside = (figure.add_subplot(place) for place in (places[0, :], places[1, 0], places[1, 1]))
    for x, y in paths(runs):
        above.plot(x, y, color=BLUE, linewidth=0.8, alpha=0.35)
    above.set(xlabel="distance in m", ylabel="height in m", xlim=(0.0, None), ylim=(0.0, None))
    above.set_title("sixty of the throws: speed, angle and wind vary", loc="left", fontsize=11)
    below.hist(landed, bins=50, color=BLUE, alpha=0.85)
    named = ((1.2, 0.97, "5 %"), (2.0, 1.05, "median"), (1.2, 0.97, "95 %"))
    for level, (width, height, text) in zip(levels, named, strict=True):
        below.axvline(level, color=RED, linewidth=width, linestyle="-" if width > 1.5 else "--")
        below.annotate(
            f"{text}: {level:.1f} m",
            (level, height),
            (4, 0),
            xycoords=below.get_xaxis_transform(),
            textcoords="offset points",
            va="top",
            color=RED,
            fontsize=10,
        )
    below.set(xlabel="distance in m", ylabel=f"throws of {len(runs):,}", ylim=(0.0, 1.12 * below.get_ylim()[1]))
    below.set_title("where they land", loc="left", fontsize=11)
    beside.plot(runs.given("w"), landed, ".", color=BLUE, markersize=3, alpha=0.4)
    beside.set(xlabel="wind in m/s", ylabel="distance in m")
    beside.set_title("it is the wind that decides", loc="left", fontsize=11)
    for axis in (above, below, beside):
        axis.grid(color="#e3e3e3", linewidth=0.7)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def main(folder: Path = Path("out")) -> lg.Ensemble:
    """Print the quantiles and what they owe to each cause, save the picture and return the ensemble."""
    began = perf_counter()
    runs = throws()
    print(f"{len(runs)} throws took {perf_counter() - began:.1f} s, the compilation included.")
    landed = runs.y_events[0][:, 0, 0]
    for level in (0.05, 0.25, 0.5, 0.75, 0.95):
        print(f"{level:>5.0%} land before {np.quantile(landed, level):6.2f} m")
    speed = np.hypot(runs.given("x_dot"), runs.given("y_dot"))
    angle = np.arctan2(runs.given("y_dot"), runs.given("x_dot"))
    for name, values in (("speed", speed), ("angle", angle), ("wind", runs.given("w"))):
        print(f"correlation of the distance with the {name}: {np.corrcoef(landed, values)[0, 1]:+.2f}")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "throw_in_wind.png"
    picture(runs, path)
    print(f"written to {path}")
    return runs


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
