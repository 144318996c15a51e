"""The formulas of a system, in SymPy, for people to read."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from functools import cached_property
from typing import Any

from lagrange.analysis import Analysis
from lagrange.show.notation.sections import ShownQuantity
from lagrange.show.notebook.shown_derivation import ShownDerivation, written_derivation
from lagrange.show.notebook.shown_lists import EquationList, ExpressionDict
from lagrange.show.terminal.languages import DETAILS
from lagrange.statement.choice import ByName, one_of
from lagrange.statement.coordinate import acceleration_of, name_of


class Formulas(Analysis):
    """The formulas of a system; `lagrange.System` has them. Each is a part of the textbook derivation.

    Those that are too large to be written out raise StatementError.
    """

    @property
    @abstractmethod
    def structure(self) -> list[str]:
        """What kind of system it is, in sentences."""

    def derivation(self, detail: str = "full") -> ShownDerivation:
        """Return the textbook derivation in SymPy, independent of the compiled equations.

        Its parts are expressions. It prints as text, has `.text()`, `.unicode()`, `.latex()`, `.markdown()` and
        `.html()`, and a notebook shows it. `detail` is "full" or "short", which leaves out the steps for each
        coordinate. Raises StatementError for another detail.
        """
        chosen = one_of(detail, DETAILS, "detail = {given}: choose one of {known}.")
        return replace(self._derivation, findings=tuple(self.structure), detail=chosen)

    @cached_property
    def _derivation(self) -> ShownDerivation:
        return written_derivation(self.statement)

    def __getattr__(self, name: str) -> Any:
        if name == "page":
            raise AttributeError(
                "a System has no page: derivation() is the derivation, to_page(path) writes a web page."
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def equations(self) -> list[Any]:
        """Return the Euler-Lagrange equations, a list of n SymPy Eq, one per coordinate, as in a textbook.

        Goldstein, Poole, Safko, Classical Mechanics, 3rd ed., sections 1.4 and 1.5, with constraints section 2.4.
        The forces of constraints stand on the right, with their multipliers `lagrange.multiplier(name)`. The
        constraints themselves are `derivation().constraints`.
        """
        return EquationList(self._derivation.equations, self.statement)

    def accelerations(self) -> dict[Any, Any]:
        """Return the accelerations, {coordinate: SymPy expression}; the multipliers are solved for and gone.

        Raises StatementError for a singular mass matrix, and where the formulas would be too long to print; the
        compiled model has no such bound.
        """
        second = {q: acceleration_of(q) for q in self.statement.coordinates}
        return ExpressionDict(self._derivation.accelerations, self.statement, second)

    @property
    def constraint_forces(self) -> dict[str, dict[Any, Any]]:
        """What each constraint exerts, {name: {coordinate: SymPy expression in lagrange.multiplier(name)}}.

        These are generalized forces, G^T lambda: lambda dphi/dq of a constraint phi = 0 on positions, lambda dpsi/dv of
        a constraint psi = 0 on velocities (Chetaev's rule where psi is not linear in them).
        """
        found = self._derivation.constraint_forces.items()
        return ByName("constraint", ((name, dict(forces)) for name, forces in found))

    @property
    def kinetic(self) -> Any:
        """T, with like terms merged; the whole of L where a Lagrangian was stated alone."""
        return self._derivation.kinetic

    @property
    def potential(self) -> Any:
        """V, with like terms merged; 0 where a Lagrangian was stated alone."""
        return self._derivation.potential

    @property
    def lagrangian(self) -> Any:
        """L = T - V, with like terms merged."""
        return self._derivation.lagrangian

    @property
    def momenta(self) -> dict[Any, Any]:
        """The conjugate momenta dL/dv, {coordinate: SymPy expression}."""
        letters = {q: ShownQuantity("p", (name_of(q),)) for q in self.statement.coordinates}
        return ExpressionDict(self._derivation.momenta, self.statement, letters)

    @property
    def mass_matrix(self) -> Any:
        """The mass matrix d2L/dv2, a SymPy Matrix (n, n)."""
        return self._derivation.mass_matrix

    @property
    def energy(self) -> Any:
        """The energy v.p - L (the Jacobi integral), which is T + V where T is quadratic in the velocities."""
        return self._derivation.energy
