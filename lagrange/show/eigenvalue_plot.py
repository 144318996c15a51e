"""The picture of eigenvalues along a parameter: rates of growth above, frequencies below."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lagrange.mechanics.eigenvalue_path import EigenvaluePath
from lagrange.show.colours import colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_eigenvalues(path: EigenvaluePath) -> Figure:
    """Return a figure of real and imaginary parts; above the line at zero the equilibrium is unstable."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 6.0), layout="constrained")
    growth, frequency = figure.subplots(2, 1, sharex=True)
    count = path.eigenvalues.shape[1]
    for column, colour in zip(path.eigenvalues.T, colours(count), strict=True):
        growth.plot(path.values, column.real, color=colour, linewidth=1.6)
        frequency.plot(path.values, column.imag, color=colour, linewidth=1.6)
    growth.axhline(0.0, color="#8a8a8a", linewidth=0.7)
    growth.set(ylabel="real part")
    frequency.set(xlabel=str(path.parameter), ylabel="imaginary part")
    growth.set_title("The equilibrium is unstable where a real part is positive")
    return figure
