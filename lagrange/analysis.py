"""What can be asked of a stated system: other forms of it, and findings about it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Self

from numpy.typing import ArrayLike

from lagrange.equations.derivation import Derivation
from lagrange.machine.model import Model
from lagrange.mechanics.comparison import EquationsComparison, compare_equations
from lagrange.mechanics.conserved import Conserved, conserved_quantities
from lagrange.mechanics.eigenvalue_path import EigenvaluePath, eigenvalue_path
from lagrange.mechanics.equilibria import Equilibrium, equilibria
from lagrange.mechanics.hamilton import Hamiltonian, hamiltonian
from lagrange.mechanics.ignored import ignored
from lagrange.mechanics.linearization import Linearization, linearized_at
from lagrange.mechanics.linearization_check import check as check_linearization
from lagrange.mechanics.modes import modes
from lagrange.mechanics.noether import noether_quantity
from lagrange.mechanics.point import stated_point, with_inputs_as_parameters
from lagrange.mechanics.reduction import reduced
from lagrange.mechanics.routh import routhian
from lagrange.mechanics.small import small
from lagrange.mechanics.student_equations import read_equations
from lagrange.mechanics.substitution import substituted
from lagrange.mechanics.transformation import transformed
from lagrange.show.dynamics import ShownModes, shown_as
from lagrange.show.figures.eigenvalue_figure import plot_eigenvalues
from lagrange.show.notebook.shown_lists import ConservedList, EquilibriumList
from lagrange.statement.choice import text as checked_text
from lagrange.statement.given import require_values, with_values
from lagrange.statement.statement import Statement

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Analysis(ABC):
    """The analysis of a system; `lagrange.System` is one. Each method calls what `lagrange.mechanics` has for it."""

    statement: Statement

    @classmethod
    @abstractmethod
    def from_statement(cls, statement: Statement) -> Self:
        """Return the system of a checked statement."""

    @abstractmethod
    def derivation(self) -> Derivation:
        """Return the textbook derivation."""

    @abstractmethod
    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile for a target; numbers of the model test what is found."""

    def eliminate(self, *coordinates: Any) -> Self:
        """Return a smaller System: holonomic constraints solved for coordinates, and both left out.

        Each of `coordinates` is a coordinate or its name, the name of a constraint, or {coordinate: expression} where
        the constraint has several solutions and one is meant. Energies, forces, dissipation, positions and the initial
        state of the other coordinates are carried over. Raises StatementError where a constraint does not determine the
        coordinate: it must be linear in it, with a coefficient that never vanishes.
        """
        return self.from_statement(reduced(self.statement, coordinates))

    def substitute(self, parameters: Mapping[Any, Any]) -> Self:
        """Return the System with numbers or expressions for some parameters, such as {l: 1, m2: mu*m1}.

        Keys are symbols or names. A given function of time is replaced too, as in {X: sin(t)}. What only the
        expressions contain becomes a parameter without a value. Raises StatementError for what is no parameter, and for
        expressions that are not constant.
        """
        return self.from_statement(substituted(self.statement, parameters))

    @property
    def _known(self) -> Statement:
        """The statement with values for its given functions; StatementError where one is open."""
        require_values(self.statement)
        return with_values(self.statement)

    @property
    def _known_derivation(self) -> Derivation:
        return self.from_statement(self._known).derivation() if self.statement.given else self.derivation()

    def small(self, about: Mapping[Any, Any] | None = None, *, order: int = 2) -> Self:
        """Return the System expanded about a point, to an order in changes of coordinates and velocities.

        `about` has values of coordinates and of velocities, numbers or expressions in parameters; what it does not name
        is zero. L, the dissipation and the constraints are expanded to that order, forces to one less: order 2 gives
        linear equations. The coordinates stay what they are. The point need not be an equilibrium; the description on
        the page says whether it is, since elsewhere the accelerations are right at the point alone. Raises
        StatementError where there is no expansion: at corners and poles, off the constraints, and where a coordinate
        loses its inertia.
        """
        return self.from_statement(small(self._known, about, order))

    def compare(self, derived: Any) -> EquationsComparison:
        """Compare equations of motion that somebody derived, such as a student, with those of the system.

        Each is a text as people type it, such as "l theta'' + g sin theta = 0", a SymPy expression that is zero, or an
        Eq; give a list, {coordinate: equation}, or one text with several lines. Equations are right if they are
        equivalent: in any order, multiplied by anything, combined linearly or solved for the accelerations. The result
        is truthy if so. Its `.message` names the first wrong term, `.read` has the equations as they were understood,
        `.details` a state at which one does not hold. Raises StatementError for what cannot be read, with all faults
        and their places, and for equations that are not linear in the accelerations.
        """
        return compare_equations(self._known, self._known_derivation, read_equations(derived, self._known))

    def compare_text(self, text: str) -> EquationsComparison:
        """Compare equations of motion in one text: `compare`, for text only."""
        return self.compare(checked_text(text, "the text of the equations"))

    def conserved(self) -> list[Conserved]:
        """Return what is found to be conserved: records with `.name`, `.expression` and `.reason`.

        The energy or Jacobi integral, momenta of ignorable coordinates and of point symmetries, which are solved for,
        and the Runge-Lenz vector. Each is proven as an identity and tested along the compiled motion. What is not in
        the list was not found; nothing is said of it.
        """
        require_values(self.statement)
        return ConservedList(conserved_quantities(self.compile("numpy", check=False)))

    def noether(self, generator: Mapping[Any, Any]) -> Any:
        """Return the conserved quantity of a symmetry that moves coordinates so: {x: -y, y: x}.

        Keys are coordinates, their names, or t for a shift in time; values depend on coordinates, parameters and t. The
        Lagrangian may change by a total derivative. Raises StatementError, with the rate of the quantity, for what is
        no symmetry, and where no proof is found. Goldstein, Poole, Safko, 3rd ed., section 13.7.
        """
        require_values(self.statement)
        return noether_quantity(self.compile("numpy", check=False), generator)

    def hamiltonian(self) -> Hamiltonian:
        """Return Hamilton's form: H in momenta, Hamilton's equations, Poisson brackets, and a System that runs.

        Raises StatementError where momenta do not determine the velocities, and for systems with constraints.
        Goldstein, Poole, Safko, 3rd ed., sections 8.1 and 9.5.
        """
        return hamiltonian(self._known, self.compile("numpy", check=False), self.from_statement)

    def routhian(self, *coordinates: Any) -> Self:
        """Return a smaller System without ignorable coordinates; the momentum p_phi of each is a parameter.

        Its value is that of the initial state. The `potential` is the effective one. Points that an ignored coordinate
        places are left out. Raises StatementError, with the rate of its momentum, for one that is not ignorable.
        Goldstein, Poole, Safko, 3rd ed., section 8.3.
        """
        return self.from_statement(routhian(self._known, coordinates, self.compile("numpy", check=False)))

    def ignored(self, solution: Any) -> dict[Any, Any]:
        """Return the ignored coordinates and their velocities along a run of the Routhian, {symbol: (N,)}.

        They are integrated over the path of the run, to 1e-12 of what they go through, from the initial values here.
        Raises StatementError for a solution of another system, and where the outputs are too far apart for 1e-12.
        """
        return ignored(self.statement, solution)

    def transform(
        self,
        coordinates: Mapping[Any, Any],
        *,
        positive: Any = (),
        parameters: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
    ) -> Self:
        """Return the System in new coordinates, given {x: r*cos(phi), y: r*sin(phi)}; t may stand there too.

        Energies, forces by virtual work, dissipation, constraints and positions are carried over; the initial state is
        solved for by number, unless `initial` gives it in the new coordinates. Those in `positive`, such as [r], are
        taken for positive, so that sqrt(r**2) is r. `parameters` has values of those that only the expressions contain.
        Raises StatementError where the new coordinates are singular.
        """
        model = self.compile("numpy", check=False)
        return self.from_statement(transformed(self._known, coordinates, positive, parameters, initial, model))

    def linearize(self, at: Mapping[Any, Any] | None = None, *, inputs: Any = ()) -> Linearization:
        """Return M, C, K and A, B of small changes about a point, SymPy matrices.

        `at` has values of coordinates, of velocities of steady motions and of inputs, numbers or expressions in
        parameters; what it does not name is zero. `inputs` are parameters or given functions of time. With constraints
        the equations are those of independent coordinates. Away from equilibrium the matrices hold at that instant, and
        `.note` says so. Tested against the Jacobian of the compiled model. Raises StatementError for a point that is
        off the constraints or has no derivatives. Goldstein, Poole, Safko, 3rd ed., section 6.1.
        """
        statement, at, inputs = with_inputs_as_parameters(self.statement, at, inputs)
        system = self if statement is self.statement else self.from_statement(statement)
        model, point = system.compile("numpy", check=False), stated_point(system._known, at, inputs)
        found = linearized_at(point)
        check_linearization(found, point, model)
        return found

    def modes(self, at: Mapping[Any, Any] | None = None) -> ShownModes:
        """Return frequencies, shapes and stability of small oscillations about an equilibrium; `plot()` draws them.

        They are symbolic while roots of degree two give them, else numbers at the values of the parameters, in radians
        per unit of time. Raises StatementError away from equilibrium. Goldstein, Poole, Safko, 3rd ed., section 6.2.
        """
        found = modes(self.linearize(at), stated_point(self._known, at))
        return shown_as(ShownModes, found)

    def equilibria(self, rates: Mapping[Any, Any] | None = None) -> list[Equilibrium]:
        """Return the equilibria, each with `.coordinates`, `.stable`, `.energy` and the `.condition` for it to exist.

        They are found in symbols where factors of the forces give them, else by number from many starts, at the values
        of the parameters. `rates` gives ignorable coordinates steady velocities, as {phi: w}: the others rest then.
        Raises StatementError where none is found, with what was tried.
        """
        return EquilibriumList(equilibria(self._known, rates, self.compile("numpy", check=False)))

    def eigenvalues(self, parameter: Any, values: ArrayLike, at: Mapping[Any, Any] | None = None) -> EigenvaluePath:
        """Return the eigenvalues about an equilibrium at values (k,) of a parameter: `.eigenvalues`, (k, 2n).

        `at` is the equilibrium, as `linearize` takes it: an expression in the parameters, or decimals for one at the
        first value, which is followed. Raises StatementError where there is none at any value.
        """
        return eigenvalue_path(self._known, parameter, values, at, self.compile("numpy", check=False))

    def plot_eigenvalues(
        self, parameter: Any, values: ArrayLike, at: Mapping[Any, Any] | None = None, *, style: str = "light"
    ) -> Figure:
        """Return a Matplotlib figure of the eigenvalues about an equilibrium along a parameter.

        The arguments, and what is raised, are those of `System.eigenvalues`; `style` is "light" or "dark".
        """
        return plot_eigenvalues(self.eigenvalues(parameter, values, at), style)
