"""Results about dynamics: records with a card, a picture, and a file of it."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from lagrange.dynamics.branches import BranchesData
from lagrange.dynamics.mode_shapes import ModeShapes, mode_shapes
from lagrange.dynamics.portrait import PortraitData
from lagrange.dynamics.section import SectionData, surface
from lagrange.dynamics.sweep import SweepData
from lagrange.errors import StatementError, counted, listing, shown
from lagrange.mechanics.modes import Modes
from lagrange.show.figures.modes_figure import plot_modes
from lagrange.show.figures.portrait_figure import plot_portrait
from lagrange.show.figures.section_figure import plot_branches, plot_section, plot_sweep
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.picture import picture
from lagrange.show.notebook.html_card import image, pairs, sentences
from lagrange.show.terminal.table import text_table
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_PLACES = 8
"""Most equilibria and branches that a card lists."""


class Drawn(ABC):
    """A record with a card and a picture; `status` says whether it is complete, `message` what is missing."""

    statement: Statement
    status: Status
    message: str

    @abstractmethod
    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure, drawn on Matplotlib's axes `ax` if they are given; `style` is "light" or "dark"."""

    @abstractmethod
    def _lines(self) -> list[tuple[str, str]]:
        """Return the lines of the card, a label and a text each."""

    def to_png(self, path: str | os.PathLike[str], *, dpi: int = FILE_DPI, style: str = "light") -> Path:
        """Write the picture of `plot()`; see `Race.to_png`."""
        return write_atomically(path, picture(lambda: self.plot(style=style), dpi))

    def __repr__(self) -> str:
        return f"{self._heading()}\n{text_table(('', ''), self._card())}"

    def _repr_html_(self) -> str:
        card = pairs(self._heading(), self._card())
        try:
            return card + image(self.plot(), f"plot of {self._heading()}")
        except StatementError as nothing_to_draw:
            return card + sentences([str(nothing_to_draw)])

    def _heading(self) -> str:
        return f"{self.statement.name}: {self.status.value}"

    def _card(self) -> list[tuple[str, str]]:
        return [*self._lines(), *([("message", self.message)] if self.message else [])]


@dataclass(frozen=True, eq=False, repr=False)
class PhasePortrait(Drawn, PortraitData):
    """A phase portrait; see `lagrange.phase_portrait`."""

    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure: the field, nullclines, orbits, separatrices and equilibria."""
        return plot_portrait(self, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        held = listing(f"{name} = {value:g}" for name, value in self.held.items())
        places = [
            (
                place.kind,
                listing(f"{name} = {x:.6g}" for name, x in zip(self.statement.names, place.state, strict=False)),
            )
            for place in self.equilibria[:_MOST_PLACES]
        ]
        return [
            ("plane", listing(f"{one.name} {one.low:.4g} to {one.high:.4g}" for one in self.plane)),
            *([("held", held)] if self.held else []),
            *places,
            ("separatrices", str(len(self.separatrices))),
            ("orbits", f"{len(self.orbits)}, {sum(one.closed for one in self.orbits)} closed"),
        ]


@dataclass(frozen=True, eq=False, repr=False)
class PoincareSection(Drawn, SectionData):
    """A Poincare section; see `lagrange.poincare`."""

    def plot(self, x: Any = None, y: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure: a point for each crossing, a colour for each orbit; `x`, `y` are entries of the state."""
        return plot_section(self, x, y, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        where = f"every {self.period:.6g}" if self.event is None else surface(self.event, self.statement)
        lines = [("section", where), ("orbits", str(len(self.states))), ("points", str(len(self.points)))]
        return lines + ([("energy drift", f"{self.drift:.1e}")] if self.drift is not None else [])


@dataclass(frozen=True, eq=False, repr=False)
class Bifurcation(Drawn, SweepData):
    """A bifurcation diagram of settled motions; see `lagrange.bifurcation`."""

    def plot(self, entry: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure: points of the settled motion against the parameter; `entry` is one of the state."""
        return plot_sweep(self, entry, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        count = Counter(self.cycles.ravel().tolist())
        known = listing(f"{p} at {number}" for p, number in sorted(count.items()) if p)
        return [
            ("parameter", f"{self.parameter}, {_range(self.values)}"),
            ("points", f"{self.states.shape[2]} of {counted(self.states.shape[1], 'orbit')} at each value"),
            ("cycles", f"of length {known}" if known != "none" else known),
            *([("no cycle", f"at {count[0]}")] if count[0] else []),
        ]


@dataclass(frozen=True, eq=False, repr=False)
class EquilibriumBranches(Drawn, BranchesData):
    """Equilibria along a parameter; see `lagrange.bifurcation`."""

    def plot(self, entry: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure: a line for each branch, dashed where it is unstable; `entry` is a coordinate."""
        return plot_branches(self, entry, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        lines = [("parameter", f"{self.parameter}, {_range(self.values)}")]
        for branch in self.branches[:_MOST_PLACES]:
            stated = zip(self.statement.names, branch.formula.values(), strict=True)
            where = listing(f"{name} = {x}" for name, x in stated) if branch.formula else "by number"
            lines.append(("branch", f"{where}; {_stability(branch.values, branch.stable)}"))
        return lines


@dataclass(frozen=True, eq=False, repr=False)
class ShownModes(Modes):
    """The modes of a system with their picture; see `System.modes`."""

    def shapes_in_numbers(self) -> ModeShapes:
        """Return the shapes as numbers, at the values of the parameters: all coordinates, and the stated positions.

        Raises StatementError where a parameter has no value.
        """
        return mode_shapes(self, self.linearization.statement)

    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure: for each mode the bars of its components, and the displaced positions.

        On a user's `ax` the components of all modes are bars side by side. Raises StatementError where a parameter has
        no value.
        """
        return plot_modes(self.shapes_in_numbers(), ax, style)


_Record = TypeVar("_Record")


def shown_as(kind: type[_Record], data: Any) -> _Record:
    """Return a record of data as its subclass with a picture."""
    base = next((base for base in kind.__mro__ if type(data) is base), None)
    if base is None:
        raise StatementError(f"a {kind.__name__} is made of what was computed, not of {shown(data)}.")
    return kind(**{field.name: getattr(data, field.name) for field in fields(data)})


def _stability(values: np.ndarray, stable: np.ndarray) -> str:
    """Return the ranges of the parameter in which no eigenvalue of a branch has a positive real part, as text."""
    within = values[stable == 1]
    if not len(within):
        return "unstable"
    alone = "" if (stable != 0).all() else " alone"
    return f"no growing motion from {within.min():.4g} to {within.max():.4g}{alone}"


def _range(values: np.ndarray) -> str:
    return f"{counted(len(values), 'value')} from {values[0]:g} to {values[-1]:g}"
