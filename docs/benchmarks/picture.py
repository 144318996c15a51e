"""The picture of error against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from measure import saved

Curve = Sequence[tuple[float, float]]
"""Points (seconds, error)."""

COLOURS = {
    "euler": "#8a8a8a",
    "symplectic-euler": "#8d5b4c",
    "midpoint": "#6a4c93",
    "verlet": "#00798c",
    "rk4": "#a35c00",
    "dopri5": "#3c7d45",
    "dop853": "#0b6e99",
}
RIVAL, INK = "#d1495b", "#222222"


def work_precision(panels: Mapping[str, Mapping[str, Curve]], file: str) -> None:
    """Draw one panel per system, one line per method; SciPy's own solvers are thin and red."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True)
    for axis, (title, curves) in zip(axes, panels.items(), strict=True):
        for name, curve in curves.items():
            rival = name.startswith("scipy")
            colour = RIVAL if rival else COLOURS.get(name, INK)
            seconds, errors = zip(*curve, strict=True)
            axis.loglog(
                seconds,
                errors,
                color=colour,
                marker="o",
                markersize=2.5 if rival else 3.5,
                linewidth=0.9 if rival else 1.6,
                alpha=0.8 if rival else 1.0,
            )
            axis.annotate(
                name, (seconds[-1], errors[-1]), (4, -3), textcoords="offset points", fontsize=8, color=colour
            )
        axis.set_title(title, loc="left", fontsize=10, color=INK)
        axis.set_xlabel("seconds per run")
        axis.grid(color="#e3e3e3", linewidth=0.7)
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0.12)
    axes[0].set_ylabel("error at the end of the run")
    saved(figure, file, 130)
