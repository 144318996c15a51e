"""The picture of energies along a run, a line for each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lagrange.dynamics.energy_exchange import MODES, ExchangeData
from lagrange.show.figures.panel import legend_beside, panel_on, say_below
from lagrange.show.figures.style import colours, dress, style_of
from lagrange.show.notation.names import letters
from lagrange.show.units import unit_of, with_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POTENTIAL = "potential"
"""What is drawn above its least value: its zero is arbitrary, and may be far from the kinetic energy."""

TITLES = {"energies": "motion and of position", "modes": "each mode", "coordinates": "each coordinate"}
"""What the title says of each kind of exchange."""


def plot_exchange(found: ExchangeData, ax: Any, style: Any) -> Figure:
    """Return the figure of the energies, and their sum in dashes."""
    look = style_of(style)
    figure, axis = panel_on(ax, look, (8.6, 4.4))
    known = letters(found.statement.names)
    for k, (name, colour) in enumerate(zip(found.parts, colours(len(found.parts), look.colours), strict=True)):
        label = f"${known[name]}$" if name in known else name
        if found.by == MODES:
            label = f"{name}: $\\omega$ = {abs(found.frequencies[k]):.4g}"
        least = float(found.parts[name].min()) if name == POTENTIAL else 0.0
        label += f" above {least:.4g}" if least else ""
        axis.plot(found.t, found.parts[name] - least, color=colour, linewidth=1.3, label=label)
    lowest = float(found.parts[POTENTIAL].min()) if POTENTIAL in found.parts else 0.0
    axis.plot(found.t, found.total - lowest, color=look.ink, linewidth=1.0, linestyle="--", label="sum")
    dress(axis, look, f"{found.statement.name}: energy of {TITLES[found.by]}")
    axis.set_xlabel(with_unit("t", unit_of(found.statement, "t")))
    axis.set_ylabel("energy")
    axis.margins(x=0)
    legend_beside(axis, ax, look)
    say_below(figure, ax, look, found.message if found.by != "energies" or not found.status.complete else "")
    return figure
