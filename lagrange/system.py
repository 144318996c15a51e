"""`lagrange.System`, with a method for each thing that a user can do with a system, and the library's `scene`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from lagrange.equations.regularity import equations_of, known_statement
from lagrange.errors import StatementError, abridged, shown
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.sections import ShownQuantity
from lagrange.show.notebook.page_writer import EquationList, ExpressionDict
from lagrange.show.notebook.shown_derivation import ShownDerivation, system_page, written_derivation
from lagrange.statement.coordinate import acceleration_of, name_of
from lagrange.statement.declare import declare
from lagrange.statement.display import announced
from lagrange.statement.expression import ByName, flag
from lagrange.statement.given.function import require_values
from lagrange.statement.scene.library import load as library_scene
from lagrange.statement.scene.scene_reader import read_scene, stored_statement
from lagrange.statement.scene.writer import scene_text
from lagrange.statement.statement import Statement

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lagrange.equations.euler_lagrange import Equations
    from lagrange.evidence.report import Report
    from lagrange.export.contents import Exported
    from lagrange.mechanics.conserved import Conserved
    from lagrange.mechanics.equilibria import Equilibrium
    from lagrange.mechanics.grading.comparison import EquationsComparison
    from lagrange.mechanics.hamilton import Hamiltonian
    from lagrange.mechanics.linearization import Linearization
    from lagrange.mechanics.stability import EigenvaluePath
    from lagrange.recipes.model import Model
    from lagrange.show.dynamics import ShownModes
    from lagrange.trajectory.constraints.consistent import Consistent
    from lagrange.trajectory.solution import Solution


class System:
    """A mechanical system: n coordinates, kinetic and potential energy, forces, parameters, initial state.

    Units are the user's own and must be consistent. Raises StatementError, in the user's symbols, for a statement that
    is not a valid system: an undeclared symbol, a coordinate without inertia, a force on an unknown coordinate.
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
        contacts: Mapping[str, Any] | None = None,
        simultaneous: str | None = None,
        surfaces: Mapping[str, Any] | None = None,
    ) -> None:
        """State a system.

        Give `kinetic` and `potential`, or `lagrangian`. `coordinates` are by default all in the expressions, in order
        of declaration. `forces` maps coordinates to generalized forces. `dissipation` is Rayleigh's D, with force
        -dD/dv. `constraints`, a list or a dict by name, are expressions that stay zero, or Eq; without velocities they
        are holonomic. `redundant="allow"` allows constraints that follow from others. `parameters` maps symbols or
        names to default values, `initial` maps coordinates and velocities to numbers, 0 by default. `positions` maps
        names to points (x, y) or (x, y, z) and shapes. `links` are pairs of these names, or triples ("origin", "bob",
        "spring"). `surfaces` maps names to lines such as (2*along, 0), with `lagrange.along` from 0 to 1. `dimensions`
        maps symbols or names to dimensions or units, {m: "mass", l: "m"}; every term is then checked. `contacts` maps
        names to `lagrange.contact(gap, ...)`. `simultaneous` is the rule for joint impacts, "newton" or "sequence".
        """
        with announced("reading", name):
            statement = declare(
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
                contacts=contacts,
                simultaneous=simultaneous,
                surfaces=surfaces,
            )
            self._adopt(statement)

    def _adopt(self, statement: Statement) -> System:
        self.statement = statement
        self._models: dict[str, Model] = {}
        self.laws: Equations = equations_of(statement, _reached)
        return self

    @classmethod
    def from_statement(cls, statement: Statement) -> System:
        """Return the system of a `Statement`, such as `system.statement`. Raises StatementError for another type."""
        if not isinstance(statement, Statement):
            raise StatementError(f"{shown(statement)} is not a statement: give the .statement of a system.")
        return cls.__new__(cls)._adopt(statement)

    @classmethod
    def from_scene(cls, path: str | Path) -> System:
        """Return the system in a scene file. Raises SceneError with file, line and column."""
        return cls.from_statement(read_scene(path))

    def __reduce__(self) -> tuple[Any, ...]:
        return _from_text, (scene_text(self.statement),)

    def __repr__(self) -> str:
        return f"<System {self.statement.name}: {abridged(self.statement.names)}>"

    def _repr_markdown_(self) -> str:
        return system_page(self.derivation(), self.structure)

    def __getattr__(self, name: str) -> Any:
        if name == "page":
            raise AttributeError("a System has no page: use derivation(), or to_page(path), which writes a web page.")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def name(self) -> str:
        """Name of the system."""
        return self.statement.name

    @property
    def coordinates(self) -> tuple[Any, ...]:
        """Coordinates, n SymPy functions of time, in the order of every array."""
        return self.statement.coordinates

    @property
    def parameters(self) -> dict[Any, float]:
        """Default values of the parameters, {name: number}; parameters without a default are left out."""
        return dict(self.statement.defaults)

    @property
    def structure(self) -> list[str]:
        """Properties of the system, in sentences: mass matrix, conserved energy and momenta, unused parameters."""
        return [*self.laws.structure.sentences(), *self.statement.remarks()]

    def derivation(self, detail: str = "full") -> ShownDerivation:
        """Return the textbook derivation, independent of the compiled equations; its attributes are SymPy expressions.

        print() shows text, a notebook shows formulas; `.text()`, `.unicode()`, `.latex()`, `.markdown()` and `.html()`
        return the derivation in that format. `detail` is "full", or "short" without steps; others raise StatementError.
        """
        remarks = (*self.laws.structure.remarks(), *self.statement.remarks())
        return replace(self._derivation, remarks=remarks, detail=detail)

    @cached_property
    def _derivation(self) -> ShownDerivation:
        return written_derivation(self.statement.as_read)

    def equations(self) -> list[Any]:
        """Return the Euler-Lagrange equations, a list of n SymPy Eq, one per coordinate, as in a textbook.

        The right-hand sides are the constraint forces, with their multipliers `lagrange.multiplier(name)`. The
        constraints themselves are `derivation().constraints`. Goldstein, Poole, Safko, 3rd ed., sections 1.4, 2.4.
        """
        with announced("deriving", self.statement.name):
            return EquationList(self._derivation.equations, self.statement.as_read)

    def accelerations(self) -> dict[Any, Any]:
        """Return the accelerations, {coordinate: SymPy expression}, with the multipliers eliminated.

        Raises StatementError for a singular mass matrix and formulas too long to print; compiled models have no limit.
        """
        second = {q: acceleration_of(q) for q in self.statement.as_read.coordinates}
        with announced("deriving", self.statement.name):
            return ExpressionDict(self._derivation.accelerations, self.statement.as_read, second)

    @property
    def constraint_forces(self) -> dict[str, dict[Any, Any]]:
        """Forces of each constraint, {name: {coordinate: SymPy expression in lagrange.multiplier(name)}}.

        The generalized force is lambda dphi/dq for a constraint phi = 0 on positions, and lambda dpsi/dv for a
        constraint psi = 0 on velocities (Chetaev's rule if psi is not linear in the velocities).
        """
        return ByName("constraint", ((name, dict(each)) for name, each in self._derivation.constraint_forces.items()))

    @property
    def kinetic(self) -> Any:
        """Kinetic energy T, with like terms merged; all of L if only a Lagrangian was stated."""
        return self._derivation.kinetic

    @property
    def potential(self) -> Any:
        """Potential energy V, with like terms merged; 0 if only a Lagrangian was stated."""
        return self._derivation.potential

    @property
    def lagrangian(self) -> Any:
        """Lagrangian L = T - V, with like terms merged."""
        return self._derivation.lagrangian

    @property
    def momenta(self) -> dict[Any, Any]:
        """Conjugate momenta dL/dv, {coordinate: SymPy expression}."""
        read = self.statement.as_read
        letters = {q: ShownQuantity("p", (name_of(q),)) for q in read.coordinates}
        return ExpressionDict(self._derivation.momenta, read, letters)

    @property
    def mass_matrix(self) -> Any:
        """Mass matrix d2L/dv2, a SymPy Matrix (n, n)."""
        return self._derivation.mass_matrix

    @property
    def energy(self) -> Any:
        """Energy v.p - L (the Jacobi integral). It is T + V if T is quadratic in the velocities."""
        return self._derivation.energy

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile for a target, "llvm" or "numpy". The model is kept for the next call.

        A quick check compares the compiled accelerations with numerical differentiation of T and V, unless `check` is
        false. Raises RunError if it fails, StatementError for an unknown target or a missing package.
        """
        from lagrange.compiler import compile_model

        check = flag(check, "check")
        if not isinstance(target, str) or target not in self._models:
            self._models[target] = compile_model(self.statement, self.laws, target, check=check)
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
        """Compile, run from `t_start` to `t_end`, and return the Solution; `lagrange.integrate` describes the options.

        Times are in the units of the statement. A scene supplies defaults of the options. Raises StatementError for
        invalid arguments. A run that ends early returns a Solution with a status and a message.
        """
        from lagrange.trajectory.integrator import RunOptions
        from lagrange.trajectory.run import run_stated

        options = RunOptions(method, rtol, atol, step, t_eval, events, max_steps, max_wall, max_memory, parameters)
        return run_stated(self, t_start, t_end, initial, options, target, check=check, progress=progress)

    def check(self, *, target: str = "llvm", points: int | None = None, seed: int = 0) -> Report:
        """Compare all compiled quantities with numerical differentiation of the stated energies, and return a report.

        The textbook derivation and the other target are compared, too. The report prints as a table and is true if all
        agree. `points` random states, by default 5 or fewer, follow from `seed`. Raises StatementError for points < 1.
        """
        from lagrange.evidence.check import check_stated

        require_values(self.statement)
        with announced("checking", self.statement.name):
            return check_stated(self, target, points, seed)

    def consistent(
        self,
        initial: Mapping[Any, Any] | None = None,
        *,
        hold: Iterable[Any] = (),
        parameters: Mapping[Any, Any] | None = None,
        t: float = 0.0,
    ) -> Consistent:
        """Return the nearest state on the constraints: `.initial` is complete, `.moved` the largest change.

        `initial` overlays the stated initial state, `parameters` the stated values; `t` is the time. First the
        coordinates move, by the least distance in the metric of the kinetic energy, then the velocities. Entries in
        `hold`, such as `[x, y.dot]`, do not change. For a rotation R, `R` in `hold` fixes the orientation, `R.body`
        also its rates. Raises StatementError if no such state is nearby, and names the violated constraints.
        """
        from lagrange.compiler import machine, model_of
        from lagrange.trajectory.constraints.consistent import consistent

        return consistent(model_of(self.statement, machine("numpy"), self.laws), initial, hold, parameters, t)

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
        default is rhs and energy. `events` are as for a run. `parameters` overlay the default values; for "main" they
        give each input a constant value, with zero derivatives. The result has `.files`, and `.commands` that run the
        self-test. Raises StatementError for functions that the target lacks, and for parameters without values.
        """
        from lagrange.export.contents import export

        return export(self._model, target, path, contents, events, parameters)

    def to_page(
        self,
        path: str | os.PathLike[str],
        *,
        parameters: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        sliders: Mapping[Any, Any] | None = None,
    ) -> Path:
        """Write a web page on which the system moves: one HTML file that needs no other file. Returns its path.

        JavaScript computes the motion by dop853. `parameters` and `initial` overlay the stated values; each value has a
        slider. `sliders` has the bounds of the first sliders, {l: (0.5, 2), theta.dot: (-3, 3)}. With contacts the page
        plays one run. Raises StatementError for unknown names, functions that JavaScript lacks, and invalid paths.
        """
        from lagrange.page.web_page import page_of, write_recorded_page

        require_values(self.statement)
        if self.statement.contacts:
            return write_recorded_page(lambda: self.run(parameters=parameters, initial=initial), path, sliders)
        page = partial(page_of, self._model, self.derivation(), parameters, initial, sliders)
        return write_atomically(path, lambda file: file.write(page().encode()))

    def to_scene(self, path: str | os.PathLike[str]) -> Path:
        """Write the statement as a scene file, which `System.from_scene` reads back. Returns its path.

        The scene says `evaluate = false`, so that SymPy rearranges nothing. Raises StatementError for a path that
        is not writable, and for parts that a scene cannot state, such as derivatives of functions without a formula.
        """
        return write_atomically(path, lambda file: file.write(scene_text(self.statement).encode()))

    def explore(
        self,
        ranges: Mapping[Any, Any] | None = None,
        *,
        t_end: float | None = None,
        play: bool = True,
        style: str = "light",
        **sliders: Any,
    ) -> Any:
        """Return sliders for parameters and initial values in a notebook, with a picture that follows them.

        `explore(l=(0.1, 2), theta=(0, 3))` has sliders for the parameter l and for theta at t = 0; `ranges` gives
        bounds by symbol, {theta.dot: (-1, 1)}. The notebook shows the page of `to_page`, with these sliders first.
        `t_end` sets the speed of the page; with `play` the motion starts at once; `style` is "light" or "dark". Raises
        StatementError for functions that JavaScript lacks, and for names that are not in the system.
        """
        from lagrange.page.web_page import explore

        return explore(self.statement, lambda: self._model, ranges, sliders, t_end=t_end, play=play, style=style)

    def eliminate(self, *coordinates: Any) -> System:
        """Return a smaller System, without some coordinates and the holonomic constraints that determine them.

        Each of `coordinates` is a coordinate or its name, the name of a constraint, or {coordinate: expression} to
        choose one of several solutions. Energies, forces, dissipation, positions and the initial state of the other
        coordinates are kept. Raises StatementError where a constraint does not determine the coordinate: it must be
        linear in the coordinate, with a coefficient that never vanishes.
        """
        self.statement.check_without_contacts("eliminate()")
        from lagrange.mechanics.reduction import reduced

        return self.from_statement(reduced(self.statement, coordinates))

    def substitute(self, parameters: Mapping[Any, Any]) -> System:
        """Return the System with numbers or expressions for some parameters, such as {l: 1, m2: mu*m1}.

        Keys are symbols or names; {X: sin(t)} or {X: (times, values)} sets a known function of time. New symbols have
        no value. Raises StatementError for a key that is not a parameter, and for expressions that are not constant.
        """
        from lagrange.mechanics.reduction import substituted

        return self.from_statement(substituted(self.statement, parameters))

    def small(self, about: Mapping[Any, Any] | None = None, *, order: int = 2) -> System:
        """Return the System expanded about a point, to an order in changes of coordinates and velocities.

        `about` has values of coordinates and of velocities, numbers or expressions in parameters; the default of each
        is zero. L, the dissipation and the constraints are expanded to `order`, forces to one order less: order 2 gives
        linear equations. The notebook page of the result says whether the point is an equilibrium; otherwise the
        accelerations are exact at the point only. Raises StatementError where no expansion exists: at corners and
        poles, off the constraints, and where a coordinate loses its inertia.
        """
        self.statement.check_without_contacts("small()")
        from lagrange.mechanics.expansion import small

        return self.from_statement(small(self._known, about, order))

    def transform(
        self,
        coordinates: Mapping[Any, Any],
        *,
        positive: Any = (),
        parameters: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
    ) -> System:
        """Return the System in new coordinates, given {x: r*cos(phi), y: r*sin(phi)}; expressions may contain t.

        Energies, forces (by virtual work), dissipation, constraints and positions are transformed. The initial state is
        found numerically, unless `initial` gives it in the new coordinates. Coordinates in `positive`, such as [r], are
        assumed positive, so that sqrt(r**2) is r. `parameters` gives values of parameters that are new in the
        expressions. Raises StatementError where the new coordinates are singular.
        """
        from lagrange.mechanics.transformation import transformed

        model = self._model
        return self.from_statement(transformed(self._known, coordinates, positive, parameters, initial, model))

    def routhian(self, *coordinates: Any) -> System:
        """Return a smaller System without ignorable coordinates; the momentum p_phi of each becomes a parameter.

        The value of p_phi is that of the initial state. The `potential` is the effective one. Points that depend on an
        ignored coordinate are left out. Raises StatementError, with the rate of its momentum, for a coordinate that is
        not ignorable. Goldstein, Poole, Safko, 3rd ed., section 8.3.
        """
        from lagrange.mechanics.transformation import routhian

        return self.from_statement(routhian(self._known, coordinates, self._model))

    def ignored(self, solution: Any) -> dict[Any, Any]:
        """Return the ignored coordinates and their velocities along a run of the Routhian, {symbol: (N,)}.

        The coordinates are integrated along the run from this system's initial values, with an error of 1e-12 of their
        total change. Raises StatementError for a solution of another system, and for outputs too far apart for 1e-12.
        """
        from lagrange.mechanics.transformation import ignored

        return ignored(self.statement, solution)

    def hamiltonian(self) -> Hamiltonian:
        """Return the Hamiltonian form: H, Hamilton's equations, Poisson brackets, and a System with momenta to run.

        Raises StatementError where momenta do not determine the velocities, and for systems with constraints.
        Goldstein, Poole, Safko, 3rd ed., sections 8.1 and 9.5.
        """
        from lagrange.mechanics.hamilton import hamiltonian

        return hamiltonian(self._known, self._model, self.from_statement)

    def conserved(self) -> list[Conserved]:
        """Return the conserved quantities: records with `.name`, `.expression` and `.reason`.

        Candidates are the energy or Jacobi integral, momenta of ignorable coordinates, of shifts and of rotations, and
        the Runge-Lenz vector. Each result is proven as an identity and tested along the compiled motion. A quantity
        that is missing from the list may still be conserved.
        """
        from lagrange.mechanics.conserved import conserved_quantities
        from lagrange.show.notebook.result_pages import ResultList

        require_values(self.statement)
        return ResultList(conserved_quantities(self._model))

    def noether(self, generator: Mapping[Any, Any]) -> Any:
        """Return the conserved quantity of a symmetry, given its generator: {x: -y, y: x} for a rotation.

        Keys are coordinates or t, for a shift in time; values depend on coordinates, parameters and t. The Lagrangian
        may change by a total derivative. Raises StatementError, with the rate of the quantity, for a generator that is
        not a symmetry, and where no proof is found. Goldstein, Poole, Safko, 3rd ed., section 13.7.
        """
        from lagrange.mechanics.conserved import noether_quantity

        require_values(self.statement)
        return noether_quantity(self._model, generator)

    def compare(self, derived: Any) -> EquationsComparison:
        """Compare equations of motion that somebody derived, such as a student, with those of the system.

        Each equation is a text such as "l theta'' + g sin theta = 0", a SymPy expression that is zero, or an Eq. Give a
        list, {coordinate: equation}, or one text with several lines. Equations are right if they are equivalent: in any
        order, multiplied by any factor, combined linearly or solved for the accelerations. The result is true if they
        are right. Its `.message` names the first wrong term, `.read` has the equations as they were understood, and
        `.details` a state at which an equation does not hold. Raises StatementError for a text that cannot be read,
        with all errors and their places, and for equations that are not linear in the accelerations.
        """
        from lagrange.show.notation.graded_answer import graded_answer

        statement = self._known
        derivation = (self.from_statement(statement) if self.statement.given else self).derivation()
        return graded_answer(statement, derivation, derived)

    def equilibria(self, rates: Mapping[Any, Any] | None = None) -> list[Equilibrium]:
        """Return the equilibria, each with `.coordinates`, `.stable`, `.energy` and the `.condition` for it to exist.

        Equations whose factors can be solved are solved exactly, others numerically from many starts. `rates` are
        constant velocities of ignorable coordinates, as {phi: w}. For a rotation R, {R.space[2]: w} gives steady turns,
        and {R: attitude, R.body[2]: w} precessions. Raises StatementError if no equilibrium is found.
        """
        from lagrange.mechanics.equilibria import equilibria
        from lagrange.show.notebook.result_pages import ResultList

        return ResultList(equilibria(self._known, rates))

    def linearize(self, at: Mapping[Any, Any] | None = None, *, inputs: Any = ()) -> Linearization:
        """Return the linear equations of small changes x about a point: M x'' + C x' + K x = 0, and y' = A y + B u.

        `at` has values of coordinates, of velocities of steady motions and of inputs, numbers or expressions in
        parameters; the default of each is zero. `inputs` u are parameters or known functions of time. y is [x, x'].
        With constraints x are independent coordinates. Away from equilibrium the SymPy matrices are valid at that
        instant only, which `.note` reports. They are compared with the Jacobian of the compiled model. Raises
        StatementError off the constraints, and without derivatives. Goldstein, Poole, Safko, 3rd ed., section 6.1.
        """
        self.statement.check_without_contacts("linearize()")
        from lagrange.mechanics.linearization import linearized

        return linearized(self, at, inputs)

    def modes(self, at: Mapping[Any, Any] | None = None) -> ShownModes:
        """Return frequencies, shapes and stability of small oscillations about an equilibrium; `plot()` draws them.

        `at` has the coordinates there, 0 by default, as in `linearize`. Results are symbolic if the frequencies follow
        from quadratic equations, else numbers for the stated parameters. Frequencies are in radians per unit of time.
        Raises StatementError away from equilibrium. Goldstein, Poole, Safko, 3rd ed., section 6.2.
        """
        from lagrange.mechanics.expansion import stated_point
        from lagrange.mechanics.modes import modes
        from lagrange.show.dynamics import ShownModes, shown_as

        return shown_as(ShownModes, modes(self.linearize(at), stated_point(self._known, at)))

    def eigenvalues(self, parameter: Any, values: ArrayLike, at: Mapping[Any, Any] | None = None) -> EigenvaluePath:
        """Return the eigenvalues about an equilibrium at values (k,) of a parameter: `.eigenvalues`, (k, 2n).

        `at` is the equilibrium, as in `linearize`: expressions in the parameters, or decimal numbers at the first
        value, from which the equilibrium is continued. Raises StatementError if it exists at no value.
        """
        self.statement.check_without_contacts("eigenvalues()")
        from lagrange.mechanics.stability import eigenvalue_path

        return eigenvalue_path(self._known, parameter, values, at, self._model)

    def plot_eigenvalues(
        self, parameter: Any, values: ArrayLike, at: Mapping[Any, Any] | None = None, *, style: str = "light"
    ) -> Figure:
        """Return a Matplotlib figure of the eigenvalues about an equilibrium along a parameter.

        `parameter`, `values`, `at` and raised errors are as in `eigenvalues`; `style` is "light" or "dark".
        """
        from lagrange.show.figures.dynamics_figures import plot_eigenvalues

        return plot_eigenvalues(self.eigenvalues(parameter, values, at), style)

    @property
    def _known(self) -> Statement:
        """The statement with all its functions of time known. Raises StatementError for a function without values."""
        require_values(self.statement)
        return known_statement(self.statement)

    @cached_property
    def _model(self) -> Model:
        """The model for numpy, with kernels compiled at first use. Raises StatementError for a system with contacts."""
        from lagrange.compiler import machine, model_of

        self.statement.check_without_contacts("this result")
        return model_of(self.statement, machine("numpy"), self.laws)


def _from_text(text: str) -> System:
    return System.from_statement(stored_statement(text))


def _reached(*given: Any) -> list[Any]:
    """Return `compiler.reached(statement, equations, states, parameters)`: the nearest states on the constraints."""
    from lagrange.compiler import reached

    return reached(*given)


def scene(name: str) -> System:
    """Return a system of the library. Raises StatementError for a name that `lagrange.scenes()` does not list."""
    return System.from_statement(library_scene(name))
