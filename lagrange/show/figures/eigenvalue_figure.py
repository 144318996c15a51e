"""The picture of eigenvalues along a parameter: rates of growth above, frequencies below."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lagrange.mechanics.eigenvalue_path import EigenvaluePath
from lagrange.show.figures.colours import colours
from lagrange.show.figures.shown_figure import new_figure
from lagrange.show.figures.style import dress, on_paper, style_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_eigenvalues(path: EigenvaluePath, style: Any = "light") -> Figure:
    """Return a figure of real and imaginary parts; above the line at zero the equilibrium is unstable."""
    look = style_of(style)
    figure = new_figure(figsize=(7.2, 6.0), layout="constrained")
    growth, frequency = figure.subplots(2, 1, sharex=True)
    dress(growth, look, "The equilibrium is unstable where a real part is positive")
    dress(frequency, look)
    for column, colour in zip(path.eigenvalues.T, colours(path.eigenvalues.shape[1], look.colours), strict=True):
        growth.plot(path.values, column.real, color=colour, linewidth=1.6)
        frequency.plot(path.values, column.imag, color=colour, linewidth=1.6)
    growth.axhline(0.0, color=look.quiet, linewidth=0.7)
    growth.set(ylabel="real part")
    frequency.set(xlabel=str(path.parameter), ylabel="imaginary part")
    return on_paper(figure, look)
