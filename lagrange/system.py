"""The public class of a mechanical system: state it, read it, compile it, run it, check it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from lagrange.analysis import Analysis
from lagrange.compiler import compile_model, equations_of, machine, model_of, state
from lagrange.errors import StatementError, listing, shown
from lagrange.evidence.check import check
from lagrange.evidence.independent import solved_statement
from lagrange.evidence.report import Report
from lagrange.export.write import Exported, export
from lagrange.recipes.model import Model
from lagrange.run import integrate_since
from lagrange.show.derivation import ShownDerivation, equations_latex, render, written_derivation
from lagrange.show.progress import compiling
from lagrange.show.solution import Solution
from lagrange.show.styles import terminal_style
from lagrange.statement import scene as scene_files
from lagrange.statement.number import flag, real_number
from lagrange.statement.statement import RunSettings, Statement
from lagrange.trajectory.constraints.consistent import Consistent, consistent
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.options import RunOptions


class System(Analysis):
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
        not named starts at 0. `positions` names points (x, y) or (x, y, z) to draw, `links` pairs of them.
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
        """Return the system of a checked statement."""
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
        return f"<System {self.statement.name}: {', '.join(self.statement.names)}>"

    def _repr_latex_(self) -> str:
        return equations_latex(self.derivation())

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

    def derivation(self) -> ShownDerivation:
        """Return the textbook derivation in SymPy, independent of the compiled equations.

        Its parts are expressions; it prints as a page, and a notebook shows it.
        """
        return self._derivation

    @cached_property
    def _derivation(self) -> ShownDerivation:
        return written_derivation(self.statement)

    def page(self, style: str | None = None) -> str:
        """Return the derivation as `lagrange derive` prints it: "text", "unicode", "latex", "markdown" or "html".

        Without a style it is Unicode where standard output is a terminal that has it, else text, plain ASCII in the
        spelling of scene files.
        """
        return render(self.derivation(), terminal_style() if style is None else style, self.structure)

    def equations(self) -> list[Any]:
        """Return the Euler-Lagrange equations, a list of SymPy Eq, one per coordinate, as in a textbook.

        The forces of constraints stand on the right, with their multipliers `lagrange.multiplier(name)`. The
        constraints themselves are `derivation().constraints`.
        """
        return list(self._derivation.equations)

    def accelerations(self) -> dict[Any, Any]:
        """Return the accelerations, {coordinate: SymPy expression}; the multipliers are solved for and gone."""
        return dict(self._derivation.accelerations)

    @property
    def constraint_forces(self) -> dict[str, dict[Any, Any]]:
        """What each constraint exerts, {name: {coordinate: SymPy expression in lagrange.multiplier(name)}}.

        These are generalized forces, G^T lambda: lambda dphi/dq of a constraint phi = 0 on positions, lambda dpsi/dv of
        a constraint psi = 0 on velocities (Chetaev's rule where psi is not linear in them).
        """
        return {name: dict(forces) for name, forces in self._derivation.constraint_forces.items()}

    @property
    def lagrangian(self) -> Any:
        """L = T - V, with like terms merged."""
        return self._derivation.lagrangian

    @property
    def momenta(self) -> dict[Any, Any]:
        """The conjugate momenta dL/dv, {coordinate: SymPy expression}."""
        return dict(self._derivation.momenta)

    @property
    def mass_matrix(self) -> Any:
        """The mass matrix d2L/dv2, a SymPy Matrix (n, n)."""
        return self._derivation.mass_matrix

    @property
    def energy(self) -> Any:
        """The energy v.p - L (the Jacobi integral), which is T + V where T is quadratic in the velocities."""
        return self._derivation.energy

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile for a target, "llvm" or "numpy"; the model is kept for the next call.

        A quick check of the compiled accelerations against numerical differentiation of T and V runs unless `check`
        is false. Raises RunError if it fails.
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

        What is not given comes from the scene, where there is one.
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

        `contents` are names of quantities ("rhs", "accelerations", "energy", "jacobian", "mass_matrix", "momenta",
        "multipliers", "events"), of explicit methods ("rk4": a step, "dop853": a run with error control), "main" (a
        program that runs the initial state and writes CSV) and, for some targets, "taylor"; the default is rhs and
        energy. `events` are expressions as for a run. `parameters` overlay the default values, which stand in the file.
        The result has `.files`, and `.commands` that build and run the self-test in that folder. All files are written
        or none. Raises StatementError for what a target cannot express, and for a parameter without a value.
        """
        return export(self.compile("numpy", check=False), target, path, contents, events, parameters)

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
        truthy when everything holds.
        """
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
        try:
            return {q: a.xreplace(prescribed) for q, a in self._derivation.accelerations.items()}, ()
        except StatementError as refusal:
            return None, (f"not compared with the textbook derivation: {refusal}",)


def _is_name(method: Any) -> bool:
    return isinstance(method, str)


def scene(name: str) -> System:
    """Return a system of the scene library; `lagrange.scenes()` lists the names."""
    return System.from_statement(scene_files.load(name))


def scenes() -> list[str]:
    """Return the names of the scene library."""
    return [entry.name for entry in scene_files.library()]


__all__ = ["RunSettings", "System", "scene", "scenes"]
