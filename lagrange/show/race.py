"""Race integration methods on a system: `lagrange.race`, its table, its figure of error against time, and its files."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from itertools import groupby
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from numpy.typing import ArrayLike

from lagrange.errors import StatementError, counted, listing, shown
from lagrange.evidence import work_precision
from lagrange.evidence.work_precision import TOLERANCES, Entry, Result
from lagrange.machine.model import Model, Stated, stated
from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.style import FigureStyle, LineStyle, dress, line_styles, new_figure, on_paper, style_of
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import write_atomically, write_rows, write_together
from lagrange.show.files.picture import picture
from lagrange.show.notebook.html_card import folded, image, sentences, table
from lagrange.statement.display import text_table
from lagrange.statement.expression import positive_number, real_number
from lagrange.trajectory.run import compiled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ROWS = 15  # Largest number of methods in a column of the legend. With more columns the legend shows no settings

_WIDTH = 125  # Characters per line of the text below the figure


def _below(race: Race, shown: list[Entry]) -> list[str]:
    """Return the sentences below the figure of a race: the accuracy of the reference, failed runs, and notes.

    `shown` are the runs that the figure shows.
    """
    failed = len(race) - len(shown)
    below = [f"Reference: {race.result.reference.about}, known to {race.uncertainty:.1e}."]
    below += [f"{failed} of {len(race)} runs did not reach the end and are not shown."] if failed else []
    if not all(entry.resolved for entry in shown):
        below.append("A mark without a line to it is an upper bound: the error is smaller than that of the reference.")
    return below + [note for note in race.notes if "does not take part" not in note]


def _draw(axis: Axes, label: str, entries: list[Entry], look: LineStyle, style: FigureStyle) -> None:
    """Draw the curve of one method: error against computing time of its runs `entries`.

    `label` is the method's name in the legend, and `look` its colour, marker and line style. `style` has the colours of
    the figure. Methods of other libraries have open markers. An error smaller than the uncertainty of the reference has
    an open marker, to which no line leads.
    """
    rival = entries[0].method.startswith(("scipy-", "cvode"))
    common: dict[str, Any] = {"color": look.colour, "marker": look.marker, "markersize": 5.5, "markeredgewidth": 1.0}
    common["linewidth"] = widths.MANY if rival else widths.BOLD
    for resolved, group in groupby(entries, key=lambda entry: entry.resolved):
        part = list(group)
        axis.plot(
            [entry.time for entry in part],
            [entry.error for entry in part],
            markerfacecolor=look.colour if resolved and not rival else style.paper,
            linestyle=look.line if resolved else "none",
            **common,
        )
    face = style.paper if rival else look.colour
    axis.plot([], [], markerfacecolor=face, linestyle=look.line, label=label, **common)


def _settings(entries: list[Entry]) -> str:
    """Return the range of settings of `entries`, from the coarsest to the finest, such as "tol = 1e-3 to 1e-9"."""
    sizes = [entry.setting for entry in entries]
    letter = "tol" if entries[0].adaptive else "h"
    ends = dict.fromkeys(_short(size) for size in (max(sizes), min(sizes)))
    return f"{letter} = {' to '.join(ends)}"


def _short(size: float) -> str:
    """Return a step size or a tolerance as text with two digits, such as 0.025 or 1e-9."""
    mantissa, _, exponent = f"{size:.1e}".partition("e")
    return f"{size:.2g}" if 1e-2 < size < 1e3 else f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def _mark_limits(axis: Axes, race: Race, style: FigureStyle) -> None:
    """Shade errors below `race.floor`, which no method in double precision reaches except by chance.

    Nothing is shaded if `race.floor` is below the lower end of the axis.
    """
    low, high = axis.get_ylim()
    if low < race.floor < float("inf"):
        axis.axhspan(low, min(race.floor, high), color=style.grid, alpha=0.55, zorder=0, linewidth=0)
        top = min(race.floor, high)
        under = math.log(top / low) > math.log(high / low) / 2  # in a narrow shade a text would cover the axis
        axis.annotate(
            "shaded: rounding one state moves the end further",
            (0.01, top),
            (0, -3 if under else 3),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="top" if under else "bottom",
            fontsize=8,
            color=style.quiet,
        )
        axis.set_ylim(low, high)


COLUMNS = tuple(field.name for field in fields(Entry))
"""Columns of the CSV file and keys of a record: the fields of an `Entry`."""

GOALS = tuple(10.0**-k for k in (3, 6, 9, 12))  # Errors for which the table gives the fastest method
_FOLDED = 12  # Largest number of runs in a table that a notebook shows unfolded

_HEADINGS = ("method", "setting", "error", "time / ms", "steps", "evaluations", "status")


@dataclass(frozen=True, eq=False, repr=False)
class Race:
    """Errors and computing times of integration methods on one system; iterating over it yields an `Entry` per run.

    An `Entry` has the method, its step or tolerance, the error and the time of one run; `records` has the same data as
    dicts. The error is that of the state at the end of the run, or the largest one at its output times. Errors are in
    the units of the state, or relative to the size of each entry of the state if `relative`. Computing times are in
    seconds. `span` is the time span of the runs, and `result` has the entries and the reference run.
    """

    result: Result
    system: str
    span: tuple[float, float]
    relative: bool = False

    def __len__(self) -> int:
        return len(self.result.entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self.result.entries)

    def __getitem__(self, index: int) -> Entry:
        if not isinstance(index, Integral) or not -len(self) <= index < len(self):
            raise StatementError(
                f"{shown(index)} is not the index of a run of this race: give a whole number below {len(self)}."
            )
        return self.result.entries[int(index)]

    @property
    def records(self) -> list[dict[str, Any]]:
        """One dict per run: its method, step or tolerance, error, time and the other fields of `Entry`."""
        return [asdict(entry) for entry in self]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods that took part."""
        return tuple(dict.fromkeys(entry.method for entry in self))

    @property
    def uncertainty(self) -> float:
        """Bound on the error of the reference run, in the same units as the errors; smaller errors are not reported."""
        return self.result.reference.uncertainty

    @property
    def floor(self) -> float:
        """Smallest error that rounding allows, in the same units as the errors.

        It is the change of the final state that results if the state is rounded to a double once, at the time of the
        run at which this has the largest effect.
        """
        return self.result.sensitivity.floor

    @property
    def growth(self) -> float:
        """Largest factor by which a relative error of the state grows between some time of the run and its end.

        It measures how sensitive the final state is to rounding.
        """
        return self.result.sensitivity.growth

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the race, for example on methods that do not take part, and on sensitive motions."""
        return self.result.notes

    def fastest(self, error: float) -> Entry | None:
        """Return the fastest run whose error is at most `error`, as an `Entry`, or None if there is no such run.

        Raises StatementError for an error that is not positive.
        """
        goal = positive_number(error, "error", "give the largest allowed error, a positive number such as 1e-6")
        within = [entry for entry in self if entry.complete and entry.error <= goal]
        return min(within, key=lambda entry: entry.time, default=None)

    def measure(self) -> str:
        """Return a phrase that says how errors are measured, such as "largest error of the state at t = 10"."""
        count = len(self.result.reference.times)
        where = f"t = {self.span[1]:g}" if count == 1 else f"{count} times"
        return f"largest error of the state at {where}" + (", relative to each entry's size" if self.relative else "")

    def to_dict(self) -> dict[str, Any]:
        """Return the race as a dict of plain data, ready for JSON; numbers that are not finite are None.

        It has the system, the time span, the reference, the notes and, as "entries", a dict for each run.
        """
        return {
            "system": self.system,
            "t_start": self.span[0],
            "t_end": self.span[1],
            "measure": self.measure(),
            "relative": self.relative,
            "reference": self.result.reference.about,
            "uncertainty": _finite(self.uncertainty),
            "growth": _finite(self.growth),
            "floor": _finite(self.floor),
            "notes": list(self.notes),
            "entries": [{key: _finite(value) for key, value in record.items()} for record in self.records],
        }

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write a CSV file with one line per run, failed runs too, and return its path.

        The columns are the fields of `Entry`. Numbers have enough digits to be read back unchanged. Raises
        StatementError for a path that cannot be written, RunError if the disk is full.
        """
        return write_atomically(path, self._csv)

    def to_png(self, path: str | os.PathLike[str], *, dpi: int = FILE_DPI) -> Path:
        """Write the figure that `plot()` returns as a PNG file with `dpi` dots per inch, and return its path.

        Raises StatementError for a path that cannot be written or without a run that reached its end, RunError if the
        disk is full.
        """
        return write_atomically(path, picture(self.plot, dpi))

    def to_folder(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write table.csv and, last, plot.png into a folder, and return their paths.

        The folder must exist, and its other files stay. If no run reached its end there is no picture, and the picture
        of an earlier race is removed. Raises StatementError for a folder that cannot be written to, RunError if the
        disk is full.
        """
        drawn = picture(self.plot) if any(entry.complete for entry in self) else None
        return write_together(folder, {"table.csv": self._csv, "plot.png": drawn})

    def _csv(self, file: BinaryIO) -> None:
        records = self.records
        write_rows(file, COLUMNS, [[record[name] for record in records] for name in COLUMNS])

    def plot(self, *, style: str = "light") -> Figure:
        """Return a Matplotlib figure of error against time, one line per method, both axes logarithmic.

        `style` is "light" or "dark". Raises StatementError for another style, and if no run reached the end.
        """
        look = style_of(style)
        shown = [entry for entry in self if entry.complete and 0 < entry.error < float("inf")]
        if not shown:
            raise StatementError("there is nothing to plot: no run of the race reached its end with a finite error.")
        groups = {name: [entry for entry in shown if entry.method == name] for name in self.methods}
        drawn = {name: entries for name, entries in groups.items() if entries}
        columns = -(-len(drawn) // _ROWS)
        figure = new_figure(figsize=(6.6 + 2.2 * columns, 5.8), layout="constrained")
        axis = figure.add_subplot()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for (name, entries), line_style in zip(drawn.items(), line_styles(len(drawn), look), strict=True):
            _draw(axis, f"{name}\n{_settings(entries)}" if columns == 1 else name, entries, line_style, look)
        _mark_limits(axis, self, look)
        start, end = self.span
        dress(axis, look)
        axis.set_title(f"{self.system}, t = {start:g} to {end:g}", loc="left", fontsize=11, color=look.ink)
        unit = "in parts of each entry's size" if self.relative else "in the state's units"
        count = len(self.result.reference.times)
        where = "at the end" if count == 1 else f"at {count} times"
        axis.set_xlabel("time of one run / s")
        axis.set_ylabel(f"largest error {where}, {unit}")
        axis.legend(
            fontsize=8,
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
            ncols=columns,
            labelspacing=0.9 if columns == 1 else 0.5,
            labelcolor=look.ink,
            handlelength=3.0,
        )
        text = "\n".join(line for sentence in _below(self, shown) for line in textwrap.wrap(sentence, _WIDTH))
        figure.supxlabel(text, x=0.01, ha="left", fontsize=8, color=look.quiet)
        return on_paper(figure, look)

    def __repr__(self) -> str:
        table = text_table(_HEADINGS, [_cells(entry) for entry in self], right=range(2, 6))
        return "\n".join([self._title(), "", table, "", *self._remarks()])

    def _repr_html_(self) -> str:
        rows = table(_HEADINGS, [_cells(entry) for entry in self])
        shown = folded(f"table of {counted(len(self), 'run')}", rows) if len(self) > _FOLDED else rows
        drawn = any(entry.complete and 0 < entry.error < math.inf for entry in self)
        picture = image(self.plot(), f"error against time: {self._title()}") if drawn else ""
        return sentences([self._title(), *self._remarks()]) + picture + shown

    def _title(self) -> str:
        return f"{self.system}, t = {self.span[0]:g} to {self.span[1]:g}: {self.measure()}"

    def _remarks(self) -> list[str]:
        lines = [f"Errors are measured against {self.result.reference.about}, with an error of {self.uncertainty:.1e}."]
        for goal in GOALS:
            best, winner = self.fastest(goal), "no run."
            if best is not None:
                winner = f"{best.method} at {setting(best)} is the fastest, in {_milliseconds(best.time)} ms."
            lines.append(f"Within {goal:.0e}: {winner}")
        lines += self.notes
        failed: dict[tuple[str, str], list[str]] = {}
        for entry in self:
            if not entry.complete:
                failed.setdefault((entry.method, entry.message), []).append(setting(entry))
        for (method, message), settings in failed.items():
            where = listing(settings) if len(settings) < 3 else f"{settings[0]} to {settings[-1]}"
            lines.append(f"{method} at {where}: {message}")
        return lines


def setting(entry: Entry) -> str:
    """Return the tolerance or the step of the run `entry` as text, such as "tol = 1e-06" or "h = 0.01"."""
    return f"{'tol' if entry.adaptive else 'h'} = {entry.setting:.3g}"


def _cells(entry: Entry) -> tuple[str, ...]:
    error, time = f"{'' if entry.resolved else '< '}{entry.error:.1e}", _milliseconds(entry.time)
    measured = (error, time) if entry.complete else ("-", "-")
    return (entry.method, setting(entry), *measured, str(entry.steps), str(entry.evaluations), entry.status)


def _milliseconds(seconds: float) -> str:
    value = 1e3 * seconds
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def race(
    system: Stated | Model,
    t_end: float | None = None,
    initial: Mapping[Any, Any] | None = None,
    *,
    methods: Iterable[Any] | None = None,
    tolerances: Iterable[float] = TOLERANCES,
    steps: Iterable[float] | None = None,
    parameters: Mapping[Any, Any] | None = None,
    reference: ArrayLike | str | Any = None,
    digits: int | None = None,
    outputs: int | None = None,
    relative: bool = False,
    repeats: int = 5,
    max_wall: float = 10.0,
) -> Race:
    """Measure error against time for integration methods, and return the Race: a table, a plot, a CSV file.

    Each run of `system` starts at `initial` and ends at `t_end`; missing values and parameters are the stated ones.
    `methods` are registered names or instances. The default is ten methods of lagrange and two of SciPy, one or two of
    each kind; methods that do not suit the system are left out with a note. Adaptive methods run at each of
    `tolerances` (rtol; the absolute tolerance follows the scale), other methods at each of `steps`, whose default fits
    the motion. The error of a run is the largest error of an entry of the final state, in the units of that entry. With
    `relative` each entry is divided by its largest magnitude along the run. With `outputs`, a number of equally spaced
    times, errors are measured at these times instead of the end; the runs then have the argument `t_eval`. The time of
    a run is the shortest of `repeats` warm runs, in seconds. Without `outputs` it is the time of `lg.flow`. A run that
    takes longer than `max_wall` seconds is stopped, and finer settings are left out.

    Errors are differences from a reference run with `digits` digits, 22 by default, that shares nothing with the
    compiled code. A second reference run bounds the error of the first; smaller errors are not reported. `reference`
    replaces the reference run by a final state (2n,), states (2n, outputs), or a method. Raises StatementError for
    invalid arguments, RunError if the run has no end to compare, and without a reference.
    """
    statement = stated(system, "kepler")
    statement.check_without_contacts("a race")
    end = real_number(statement.run.t_end if t_end is None else t_end, "t_end")
    span = (0.0, end)
    settings = work_precision.race_settings(
        span,
        tolerances=tolerances,
        steps=steps,
        repeats=repeats,
        max_wall=max_wall,
        outputs=outputs,
        relative=relative,
        digits=digits,
    )
    model = compiled(system, "kepler")
    result = work_precision.race(model, span, initial, parameters, methods, settings, reference)
    return Race(result, model.statement.name, span, relative=relative)
