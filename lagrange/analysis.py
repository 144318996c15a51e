"""What can be asked of a stated system: other forms of it, and findings about it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

from lagrange.equations.derivation import Derivation
from lagrange.mechanics.comparison import EquationsComparison, compare_equations
from lagrange.mechanics.reduction import reduced
from lagrange.mechanics.student_equations import equations_of_text, read_equations
from lagrange.mechanics.substitution import substituted
from lagrange.statement.statement import Statement


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

        Keys are symbols or names. What only the expressions contain becomes a parameter without a value. Raises
        StatementError for what is no parameter, and for expressions that are not constant.
        """
        return self.from_statement(substituted(self.statement, parameters))

    def compare(self, derived: Any) -> EquationsComparison:
        """Compare equations of motion that somebody derived, such as a student, with those of the system.

        Each is a text such as "l*theta_ddot + g*sin(theta) = 0", a SymPy expression that is zero, or an Eq; give a list
        or {coordinate: equation}. They are right if they are equivalent: in any order, multiplied by anything, combined
        linearly or solved for the accelerations. The result is truthy if so; its `.message` names the first wrong term
        with a state at which the equation does not hold. Raises StatementError for what cannot be read, and for
        equations that are not linear in the accelerations.
        """
        return compare_equations(self.statement, self.derivation(), read_equations(derived, self.statement))

    def compare_text(self, text: str) -> EquationsComparison:
        """Compare equations of motion in a text, one a line, as `compare` does; # begins a comment.

        A refusal names the line and the column.
        """
        return compare_equations(self.statement, self.derivation(), equations_of_text(text, self.statement))
