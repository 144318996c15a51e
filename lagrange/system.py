"""The public class of a mechanical system: state it, read it, compile it, run it, check it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from lagrange.compiler import compile_model, equations_of, export, machine, model_of, page, state
from lagrange.errors import StatementError, abridged, listing, shown
from lagrange.evidence.check import check
from lagrange.evidence.independent import solved_statement
from lagrange.evidence.report import Report
from lagrange.formulas import Formulas
from lagrange.recipes.model import Model
from lagrange.run import integrate_since
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notebook.explore_widgets import explore
from lagrange.show.notebook.explored_sliders import explored_sliders
from lagrange.show.notebook.shown_lists import SceneList
from lagrange.show.notebook.system_page import system_page
from lagrange.show.solution import Solution
from lagrange.show.terminal.progress import compiling
from lagrange.statement import scene as scene_files
from lagrange.statement.given import require_values
from lagrange.statement.number import flag, real_number
from lagrange.statement.scene_text import scene_text
from lagrange.statement.statement import RunSettings, Statement
from lagrange.trajectory.constraints.consistent import Consistent, consistent
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.options import RunOptions

if TYPE_CHECKING:
    from lagrange.export.write import Exported


MOST_DERIVED = 100
"""Coordinates up to which a check compares with the textbook derivation, which takes some 10 s for 300."""


class System(Formulas):
    """A mechanical system: n coordinates, kinetic and potential energy, forces, parameters, initial state.

    Units are the user's own, consistent ones. Raises StatementError, in the user's symbols, for anything that
    cannot be meant: an undeclared symbol, a coordinate without inertia, a force on a coordinate that is not there.
    """

    def __init__(
        self,
        kinetic: Any = None,
        potential: Any = None,
        *,
        lagrangian: Any = None,
        coordinates: Sequence[Any] | None = None,
        forces: Mapping[Any, Any] | None = None,
        dissipation: Any = 0,
        constraints: Sequence[Any] | Mapping[str, Any] = (),
        redundant: str = "refuse",
        parameters: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        positions: Mapping[str, Any] | None = None,
        links: Iterable[Sequence[str]] = (),
        name: str = "system",
        dimensions: Mapping[Any, Any] | None = None,
    ) -> None:
        """State a system.

        Give `kinetic` and `potential`, or `lagrangian`. `coordinates`, unless given, are those that appear, in order of
        declaration.
        `forces` maps a coordinate to its generalized force, `dissipation` is Rayleigh's D with force -dD/dv.
        `constraints` are expressions that stay zero, or Eq, in a list or by name; those free of velocities are
        holonomic. With `redundant="allow"` some may follow from others, and share their forces.
        `parameters` maps symbols or names to default values, `initial` coordinates and velocities to numbers; what is
        not named starts at 0. `positions` names points (x, y) or (x, y, z) to draw, `links` pairs of them, or
        triples such as ("origin", "bob", "spring").
        `dimensions` maps symbols or names to dimensions or units, {m: "mass", l: "m"}: every term is then checked, and
        axes have units where units were given.
        """
        self._adopt(
            state(
                kinetic=kinetic,
                potential=potential,
                lagrangian=lagrangian,
                coordinates=coordinates,
                forces=forces,
                dissipation=dissipation,
                constraints=constraints,
                redundant=redundant,
                parameters=parameters,
                initial=initial,
                positions=positions,
                links=links,
                name=name,
                dimensions=dimensions,
            )
        )

    def _adopt(self, statement: Statement) -> None:
        self.statement = statement
        self._models: dict[str, Model] = {}
        self.laws = equations_of(statement)

    @classmethod
    def from_statement(cls, statement: Statement) -> System:
        """Return the system of a checked statement, the `.statement` of another; else StatementError is raised."""
        if not isinstance(statement, Statement):
            raise StatementError(f"{shown(statement)} is no statement: give the .statement of a system.")
        system = cls.__new__(cls)
        system._adopt(statement)
        return system

    @classmethod
    def from_scene(cls, path: str | Path) -> System:
        """Read a scene file. Raises SceneError with file, line and column."""
        return cls.from_statement(scene_files.read_scene(path))

    def __reduce__(self) -> tuple[Any, ...]:
        return System.from_statement, (self.statement,)

    def __repr__(self) -> str:
        return f"<System {self.statement.name}: {abridged(self.statement.names)}>"

    def _repr_markdown_(self) -> str:
        return system_page(self.derivation(), self.structure)

    @property
    def name(self) -> str:
        """The system's name."""
        return self.statement.name

    @property
    def coordinates(self) -> tuple[Any, ...]:
        """The coordinates, n SymPy functions of time, in the order of every array."""
        return self.statement.coordinates

    @property
    def parameters(self) -> dict[Any, float]:
        """The parameters that have a default value, and the values."""
        return dict(self.statement.defaults)

    @property
    def structure(self) -> list[str]:
        """What kind of system it is, in sentences: mass matrix, conserved energy and momenta, unused parameters."""
        return [*self.laws.structure.sentences(), *self.statement.remarks()]

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile for a target, "llvm" or "numpy"; the model is kept for the next call.

        A quick check of the compiled accelerations against numerical differentiation of T and V runs unless `check`
        is false. Raises RunError if it fails, StatementError for another target and one whose package is missing.
        """
        if not isinstance(target, str) or target not in self._models:
            self._models[target] = compile_model(self.statement, self.laws, target, check=flag(check, "check"))
        return self._models[target]

    def run(
        self,
        t_end: float | None = None,
        initial: Mapping[Any, Any] | None = None,
        *,
        t_start: float = 0.0,
        method: Any = None,
        rtol: float | None = None,
        atol: float | None = None,
        t_eval: ArrayLike | None = None,
        events: Any = None,
        step: float | None = None,
        max_steps: int | None = None,
        max_wall: float | None = None,
        max_memory: float | None = None,
        parameters: Mapping[Any, Any] | None = None,
        progress: bool = False,
        target: str = "llvm",
        check: bool = True,
    ) -> Solution:
        """Compile, run from `t_start` to `t_end`, and return the Solution; see `lagrange.integrate` for the options.

        Times are in the units of the statement. What is not given comes from the scene, where there is one. Raises
        StatementError for a request that cannot be meant; what happens along the way is in the Solution.
        """
        began, scene = time.perf_counter(), self.statement.run
        end = scene.t_end if t_end is None else real_number(t_end, "t_end, the time at which the run ends,")
        chosen = scene.method or DEFAULT if method is None else method
        if find(chosen).claims.adaptive:
            rtol = scene.rtol if rtol is None and _is_name(chosen) else rtol
            atol = scene.atol if atol is None and _is_name(chosen) else atol
        elif step is None and _is_name(chosen):
            step = scene.step
        with compiling(self.name, wanted=flag(progress, "progress")):
            model = self.compile(target, check=check)
        return integrate_since(
            began,
            model,
            (t_start, end),
            initial,
            RunOptions(chosen, rtol, atol, step, t_eval, events, max_steps, max_wall, max_memory, parameters),
            progress=progress,
        )

    def explore(
        self,
        ranges: Mapping[Any, Any] | None = None,
        *,
        t_end: float | None = None,
        method: Any = None,
        play: bool = True,
        style: str = "light",
        **sliders: Any,
    ) -> Any:
        """Return sliders for parameters and initial values in a notebook, over a picture that follows them.

        `explore(l=(0.1, 2), theta=(0, 3))` has a slider for the parameter l and one for the value of theta at t = 0;
        `ranges` are those by symbol, {theta.dot: (-1, 1)}. The picture has the named positions, or the coordinates
        where none are stated, beside the energy, from t = 0 to `t_end`; `play` moves through it. A run that fails, or
        takes longer than a second, says so below. Needs ipywidgets, which the extra `notebook` has.
        Raises StatementError for a slider of what is no parameter, coordinate or velocity, and without ipywidgets.
        """
        chosen = explored_sliders(self.statement, ranges, sliders)
        return explore(self.statement, chosen, self.run, t_end=t_end, method=method, play=play, style=style)

    def export(
        self,
        target: str,
        path: str | os.PathLike[str],
        contents: Sequence[str] | None = None,
        *,
        events: Any = None,
        parameters: Mapping[Any, Any] | None = None,
    ) -> Exported:
        """Write the model as source files of a target into a folder, with a self-test; `lagrange.targets()` lists them.

        `contents` are names of quantities ("rhs", "accelerations", "energy", "energies", "jacobian", "mass_matrix",
        "momenta", "multipliers", "positions", "events"), of explicit methods ("rk4": a step, "dop853": a run with error
        control), "main" (a program that runs the initial state and writes CSV) and, for some targets, "taylor"; the
        default is rhs and energy. `events` are expressions as for a run. `parameters` overlay the default values, which
        stand in the file.
        The result has `.files`, and `.commands` that build and run the self-test in that folder. Raises StatementError
        for what a target cannot express, and for a parameter without a value.
        """
        return export(self.compile("numpy", check=False), target, path, contents, events, parameters)

    def to_page(
        self,
        path: str | os.PathLike[str],
        *,
        parameters: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        sliders: Mapping[Any, Any] | None = None,
    ) -> Path:
        """Write a web page on which the system moves: one HTML file that needs nothing else. Returns its path.

        It computes in JavaScript, with the exported right-hand side and dop853. `parameters` and `initial` overlay the
        stated values. Every parameter and initial value has a slider; `sliders` maps those that shall stand first to
        their bounds, {l: (0.5, 2), theta.dot: (-3, 3)}. Raises StatementError for what has no slider, for functions
        that JavaScript has not, and for a path that cannot be written.
        """
        require_values(self.statement)
        return page(self.compile("numpy", check=False), self.derivation(), path, parameters, initial, sliders)

    def to_scene(self, path: str | os.PathLike[str]) -> Path:
        """Write the statement as a scene file, which `System.from_scene` reads as the same one. Returns its path.

        The file holds energies, forces, constraints, values, initial state, points, links, units, given functions, what
        is said of the system, and how it asks to be run; not what SymPy was told of the signs of parameters. Raises
        StatementError for what no scene can hold, such as a parameter without a value or a function without a formula,
        and for a path that cannot be written.
        """
        return write_atomically(path, lambda file: file.write(scene_text(self.statement).encode()))

    def consistent(
        self,
        initial: Mapping[Any, Any] | None = None,
        *,
        hold: Iterable[Any] = (),
        parameters: Mapping[Any, Any] | None = None,
        t: float = 0.0,
    ) -> Consistent:
        """Return the nearest state on the constraints: `.initial` is complete, `.moved` the largest change.

        `initial` overlays the statement's initial state as in `run`. The coordinates move first, by the least amount
        that the kinetic energy measures, then the velocities; those in `hold`, such as `[x, y.dot]`, stay as they are.
        Raises StatementError where no such state is near, with the constraints that are not met.
        """
        return consistent(model_of(self.statement, machine("numpy"), self.laws), initial, hold, parameters, t)

    def check(self, *, target: str = "llvm", points: int = 5, seed: int = 0) -> Report:
        """Compare everything compiled with numerical differentiation of the stated energies, and return a report.

        It also compares with the textbook derivation and with the other machine. The report prints as a table and is
        truthy when everything holds. `points` is the number of random states, which follow from `seed`. Raises
        StatementError for numbers that are none and for another target.
        """
        require_values(self.statement)
        model = self.compile(target, check=False)
        statement = solved_statement(model)
        if statement is not model.statement:
            names = listing(repr(one.name) for one in statement.constraints)
            report = System.from_statement(statement).check(target=target, points=points, seed=seed)
            return replace(report, notes=(*report.notes, f"checked with {names} alone: other constraints follow."))
        other = self.compile("numpy" if target == "llvm" else "llvm", check=False)
        textbook, notes = self._textbook(dict(model.statement.prescribed))
        report = check(model, textbook=textbook, other=other, points=points, seed=seed)
        return replace(report, notes=(*report.notes, *notes))

    def _textbook(self, prescribed: Mapping[Any, Any]) -> tuple[Mapping[Any, Any] | None, tuple[str, ...]]:
        """Return the accelerations of the textbook derivation, or a note that they are too large to be derived.

        `prescribed` are the values of given functions and their derivatives.
        """
        if len(self.coordinates) > MOST_DERIVED:
            limit = f"which is done up to {MOST_DERIVED} coordinates."
            return None, (f"not compared with the textbook derivation, {limit}",)
        try:
            return {q: a.xreplace(prescribed) for q, a in self._derivation.accelerations.items()}, ()
        except StatementError as refusal:
            return None, (f"not compared with the textbook derivation: {refusal}",)


def _is_name(method: Any) -> bool:
    return isinstance(method, str)


def scene(name: str) -> System:
    """Return a system of the scene library; `lagrange.scenes()` lists the names.

    Raises StatementError for a name that is not there, with those that are.
    """
    return System.from_statement(scene_files.load(name))


def scenes() -> list[str]:
    """Return the names of the scene library."""
    entries = scene_files.library()
    return SceneList((entry.name for entry in entries), (entry.about for entry in entries))


__all__ = ["RunSettings", "System", "scene", "scenes"]
