"""What a plot of runs can show, and the panels that each of it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.show.figures import quantities
from lagrange.show.figures.path_panel import PathPanel
from lagrange.show.figures.paths import common_view
from lagrange.show.figures.phase_panel import PhasePanel
from lagrange.show.figures.quantities import Quantity
from lagrange.show.figures.time_panel import TimePanel
from lagrange.statement.coordinate import row_label
from lagrange.trajectory.solution import Solution

Panel = TimePanel | PhasePanel | PathPanel

_MOST_PHASES = 9
"""Phase planes in one figure."""


class Contents:
    """The panels of some runs: `chosen` are coordinates by name, and in one panel stands what is `merged`."""

    def __init__(
        self, solutions: Sequence[Solution], labels: Sequence[str], chosen: Sequence[str] | None, *, merged: bool
    ) -> None:
        self.solutions, self.labels = tuple(solutions), tuple(labels)
        self.chosen = list(solutions[0].model.statement.names if chosen is None else chosen)
        self.merged = merged

    def overview(self) -> list[Panel]:
        """Return the panels of the coordinates, of what should be constant, and of the paths where points are named."""
        return [
            *self.coordinates(),
            *self.drift(),
            *self._over_time(quantities.momenta, wide=True),
            *self._paths(),
        ]

    def of(self, what: Any) -> list[Panel]:
        """Return the panels of one thing to show. Raises StatementError for what is none."""
        if isinstance(what, str):
            if what in WHAT:
                return WHAT[what](self)
            names = self.solutions[0].names
            if what not in names and (other := OTHER_NAMES.get(" ".join(what.replace("_", " ").split()))):
                return WHAT[other](self)
            if what not in names:
                raise StatementError(
                    f"what = {shown(what)} is nothing to plot: give {listing(WHAT)}, a coordinate or a velocity "
                    f"({listing(names[:8])}), or a SymPy expression.{suggestion(what, [*WHAT, *names])}"
                )
        return self._over_time(lambda run: quantities.expression(run, what))

    def coordinates(self) -> list[Panel]:
        """Return panels of the chosen coordinates."""
        return self._each(lambda run: quantities.coordinates(run, self.chosen, merged=self.merged))

    def velocities(self) -> list[Panel]:
        """Return panels of the velocities of the chosen coordinates."""
        return self._each(lambda run: quantities.velocities(run, self.chosen, merged=self.merged))

    def phase(self) -> list[Panel]:
        """Return the phase planes of the chosen coordinates."""
        if len(self.chosen) > _MOST_PHASES:
            raise StatementError(
                f"there are {len(self.chosen)} phase planes, and a figure has up to {_MOST_PHASES}: choose coordinates "
                f"with of=, such as of={self.chosen[0]!r}."
            )
        return [PhasePanel(name, self.solutions, self.labels) for name in self.chosen]

    def energies(self) -> list[Panel]:
        """Return a panel with T, V and E."""
        return self._over_time(quantities.energies, wide=True)

    def drift(self) -> list[Panel]:
        """Return a panel of the drift of a conserved energy, or of the energy."""
        return self._over_time(quantities.energy, wide=True)

    def invariants(self) -> list[Panel]:
        """Return panels of the drifts of all that is conserved."""
        found = self._each(quantities.invariants)
        if not found:
            name = self.solutions[0].model.statement.name
            raise StatementError(f"nothing was found that {name} conserves: there are no invariants to plot.")
        return found

    def multipliers(self) -> list[Panel]:
        """Return panels of the multipliers of all constraints."""
        return self._each(quantities.multipliers)

    def violation(self) -> list[Panel]:
        """Return a panel of the largest violation of the constraints."""
        return self._over_time(quantities.violation, wide=True)

    def path(self) -> list[Panel]:
        """Return the panel of the paths of named points. Raises StatementError where there are none."""
        found = self._paths()
        if not found:
            name = self.solutions[0].model.statement.name
            raise StatementError(
                f"{name} has no named points: state positions={{'bob': (x, y)}} to see their paths, or draw its "
                "coordinates with what='coordinates'."
            )
        return found

    def _paths(self) -> list[Panel]:
        view = common_view(self.solutions)
        return [] if view is None else [PathPanel(self.solutions, self.labels, view)]

    def _over_time(self, of: Callable[[Solution], Quantity | None], *, wide: bool = False) -> list[Panel]:
        """Return one panel of a quantity of each run; none where a run has none."""
        found = [of(run) for run in self.solutions]
        kept = [one for one in found if one is not None]
        return [TimePanel(tuple(kept), self.solutions, self.labels, wide)] if len(kept) == len(found) else []

    def _each(self, of: Callable[[Solution], list[Quantity]]) -> list[Panel]:
        """Return a panel for each of the quantities of runs."""
        rows = zip(*(of(run) for run in self.solutions), strict=True)
        return [TimePanel(row, self.solutions, self.labels) for row in rows]


WHAT: Mapping[str, Callable[[Contents], list[Panel]]] = {
    "coordinates": Contents.coordinates,
    "velocities": Contents.velocities,
    "phase": Contents.phase,
    "energies": Contents.energies,
    "drift": Contents.drift,
    "invariants": Contents.invariants,
    "path": Contents.path,
    "multipliers": Contents.multipliers,
    "violation": Contents.violation,
}
"""What can be shown by name."""

OTHER_NAMES = {"phase plane": "phase", "phase planes": "phase", "energy": "energies", "paths": "path"}
"""Other words for them, where no coordinate has that name."""


def chosen_coordinates(of: Any, names: Sequence[str]) -> list[str] | None:
    """Return coordinates by name that were given as one or several. Raises StatementError for what is none."""
    if of is None:
        return None
    given = list(of) if isinstance(of, (list, tuple)) else [of]
    found = [row_label(one) for one in given]
    for name in found:
        if name not in names:
            raise StatementError(
                f"of = {name[:80]!r} is no coordinate of this system; they are {listing(names)}."
                + suggestion(name, names)
            )
    if not found:
        raise StatementError(f"of = [] chooses no coordinate; they are {listing(names)}.")
    return found
