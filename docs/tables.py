"""Write the tables of scenes and methods, and pictures, for the pages of the documentation.

    python docs/tables.py

A test compares the tables with the registered scenes and methods.
"""

from __future__ import annotations

import re
import runpy
from pathlib import Path

from matplotlib.figure import Figure
from sympy import cos

import lagrange as lg
from lagrange.show.files.picture import bounded_png
from lagrange.statement.scene.library import library
from lagrange.trajectory.methods.registry import MARKS

DOCS = Path(__file__).resolve().parent


def scene_table() -> str:
    """Return one row per scene of the library."""
    lines = ["| scene | what it shows |", "|---|---|", *(f"| `{scene.name}` | {scene.about} |" for scene in library())]
    return "\n".join(lines)


def method_table() -> str:
    """Return one row per method, with the claims that hold in one column."""
    lines = ["| method | order | step | claims | dense | about |", "|---|---|---|---|---|---|"]
    for name, claims, about in ((row.name, row.claims, row.about) for row in lg.methods.table()):
        step = "adaptive" if claims.adaptive else "fixed"
        claimed = ", ".join(title for title, holds in MARKS if holds(claims))
        lines.append(f"| `{name}` | {claims.order} | {step} | {claimed} | {claims.dense or ''} | {about} |")
    return "\n".join(lines)


TABLES = {
    "scenes": ("scenes.md", scene_table),
    "methods": ("choosing-an-integrator.md", method_table),
}
"""Each table by the name in its markers: its page, and the function that makes it."""


def filled(page: str, marker: str, table: str) -> str:
    """Return the text of a page with a table between its markers."""
    pattern = rf"(<!-- {marker}:begin -->\n).*?(<!-- {marker}:end -->)"
    return re.sub(pattern, lambda match: f"{match[1]}{table}\n{match[2]}", page, flags=re.DOTALL)


def dynamics() -> Figure:
    """Return the picture of the page on dynamics: a portrait, a section and a bifurcation diagram."""
    x, y, theta = lg.coordinates("x y theta")
    F = lg.parameters("F")
    damped = lg.System(
        kinetic=theta.dot**2 / 2, potential=-cos(theta), forces={theta: -0.3 * theta.dot}, name="pendulum"
    )
    star = lg.System(
        kinetic=lg.kinetic_energy(1, (x, y)), potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3, name="Henon-Heiles"
    )
    force = -0.3 * x.dot + F * cos(1.2 * lg.t)
    duffing = lg.System(
        kinetic=x.dot**2 / 2,
        potential=x**4 / 4 - x**2 / 2,
        forces={x: force},
        parameters={F: 0.2},
        initial={x: 1.0},
        name="Duffing oscillator",
    )
    figure = lg.figure(1, 3, size=(18.0, 5.2))
    portrait, section, bifurcation = figure.axes
    lg.phase_portrait(damped).plot(ax=portrait)
    starts = [{y: start} for start in (-0.36, -0.3, -0.23, -0.15, 0.05, 0.12, 0.2, 0.33, 0.5, 0.64)]
    starts += [{y.dot: speed} for speed in (-0.29, -0.24, 0.24, 0.29)]
    crossings = lg.poincare(star, lg.event(x, direction=1), starts, energy=1 / 8, solve_for=x.dot)
    crossings.plot(ax=section)
    lg.bifurcation(duffing, F, (0.2, 0.65, 500)).plot(ax=bifurcation)
    return figure


def main() -> None:
    """Write the tables and the picture."""
    for marker, (name, make) in TABLES.items():
        path = DOCS / name
        path.write_text(filled(path.read_text("utf-8"), marker, make()), "utf-8")
        print(f"wrote {name}")
    regions = lg.methods.plot_stability("euler", "rk4", "dopri5", "dop853", "radau5", "bdf2")
    regions.savefig(DOCS / "stability.png", dpi=110)
    (DOCS / "dynamics.png").write_bytes(bounded_png(dynamics(), 80))
    print("wrote dynamics.png")
    svg = runpy.run_path(str(DOCS / "site" / "moving.py"))["svg"]
    wild = lg.scene("double-pendulum").run(12.0, {"theta1": 2.0, "theta2": 2.5}, rtol=1e-12)
    (DOCS / "double-pendulum.svg").write_text(svg(wild), "utf-8")
    print("wrote double-pendulum.svg")


if __name__ == "__main__":
    main()
