"""Several runs in one figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError, shown
from lagrange.show.figures.run_figure import plot_runs
from lagrange.statement.expression import entries
from lagrange.trajectory.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(
    solutions: Sequence[Solution],
    what: Any = None,
    *,
    labels: Sequence[str] | None = None,
    of: Any = None,
    ax: Any = None,
    size: Any = None,
    style: str = "light",
    dpi: int | None = None,
) -> Figure:
    """Return a Matplotlib figure of several runs of systems with the same coordinates, as `Solution.plot` draws one.

    `labels` are the names of the runs, one text each; by default their methods, or a parameter or a first value that
    differs. In a panel with one row each run has a colour, else a kind of line. Raises StatementError for arguments
    that are not solutions, and for those that `Solution.plot` refuses.
    """
    given = [solutions] if isinstance(solutions, Solution) else entries(solutions, "the solutions")
    if not given or not all(isinstance(one, Solution) for one in given):
        raise StatementError(
            f"{shown(solutions)} is nothing to plot: give solutions, such as lg.plot([first, second])."
        )
    return plot_runs(given, what, of=of, ax=ax, size=size, style=style, labels=labels, dpi=dpi)
