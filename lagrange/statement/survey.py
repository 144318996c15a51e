"""Walk over an expression that collects its symbols and functions, and refuses those that no system may contain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And, BooleanAtom, Not, Or

from lagrange.errors import StatementError, formula, listing
from lagrange.statement.coordinate import check_symbol, constraint_of, name_of, t, velocity_of
from lagrange.statement.given.motion import Motion, motion_of
from lagrange.statement.vocabulary.words import SYMPY_CLASSES, WORDS

_PLAIN = (sympy.Add, sympy.Mul, sympy.Pow, ExprCondPair, Relational, And, Or, Not, ITE, BooleanAtom)


@dataclass
class Survey:
    """The leaves of some expressions, each in order of first appearance (dicts serve as ordered sets)."""

    coordinates: dict[Any, None] = field(default_factory=dict)
    velocities: dict[Any, None] = field(default_factory=dict)
    parameters: dict[Any, None] = field(default_factory=dict)
    multipliers: dict[str, None] = field(default_factory=dict)
    given: dict[Any, int] = field(default_factory=dict)  # given functions of time, with their highest derivatives
    unknown: dict[Any, None] = field(default_factory=dict)  # undefined functions of anything but time
    seen: set[Any] = field(default_factory=set)

    def add(self, expression: Any, what: str, *, accelerations: bool = False, multipliers: bool = False) -> None:
        """Collect the leaves of an expression, named `what` in messages.

        Raises StatementError for functions that the package cannot differentiate or run.
        """
        for node in _distinct(expression, self.seen):
            if isinstance(node, sympy.Symbol):
                if node != t:
                    self._add_symbol(node, what, multipliers)
            elif isinstance(node, AppliedUndef):
                self._add_function(node, what)
            elif isinstance(node, sympy.Derivative):
                self._add_derivative(node, what, accelerations)
            elif isinstance(node, sympy.Subs):
                self._add_unknown(node.expr, what)
            else:
                _check_supported(node, what)

    def _add_symbol(self, node: Any, what: str, multipliers: bool) -> None:
        constraint = constraint_of(node)
        if constraint is None:
            self.parameters[node] = None
        elif multipliers:
            self.multipliers[constraint] = None
        else:
            raise StatementError(
                f"{what} contains {node}, the multiplier of a constraint, which is found from the motion. It may stand "
                "in forces, in events and in solution.evaluate(...)."
            )

    def _add_function(self, node: Any, what: str) -> None:
        if node.args != (t,):
            self._add_unknown(node, what)
        elif (motion := motion_of(node)) is None:
            check_symbol(name_of(node), "coordinate")
            self.coordinates[node] = None
        else:
            self._add_given(node, motion, 0)

    def _add_given(self, node: Any, motion: Motion, order: int) -> None:
        self.given[node] = max(order, self.given.get(node, 0))
        if isinstance(motion.values, sympy.Expr):
            self.add(motion.values, f"the given function {name_of(node)}")

    def _add_unknown(self, node: Any, what: str) -> None:
        """Add an undefined function of coordinates, such as U(r), itself or inside its derivative at a point."""
        function = node.expr if isinstance(node, sympy.Derivative) else node
        if not isinstance(function, AppliedUndef) or motion_of(function) is not None:
            raise StatementError(
                f"{what} contains {node}, a derivative that is not evaluated. Call .doit() on it, or write it out."
            )
        check_symbol(name_of(function), "function")
        self.unknown[function] = None

    def _add_derivative(self, node: Any, what: str, accelerations: bool) -> None:
        inner = node.expr
        if isinstance(inner, AppliedUndef) and inner.args != (t,):
            self._add_unknown(node, what)
            return
        if not isinstance(inner, AppliedUndef) or set(node.variables) != {t}:
            raise StatementError(
                f"{what} contains {node}, a derivative that is not evaluated. Call .doit() on it, or write it out."
            )
        order = len(node.variables)
        motion = motion_of(inner)
        if motion is not None:
            self._add_given(inner, motion, order)
            return
        if order > 2 or (order == 2 and not accelerations):
            leaves = "coordinates, velocities and accelerations" if accelerations else "coordinates and velocities"
            raise StatementError(
                f"{what} contains the derivative of order {order} of {name_of(inner)}. Only {leaves} may stand there: "
                f"write it in terms of {name_of(inner)} and {name_of(inner)}.dot."
            )
        self._add_function(inner, what)
        self.velocities[velocity_of(inner)] = None


def _distinct(expression: Any, seen: set[Any]) -> Iterator[Any]:
    """Yield each distinct subexpression once, parents first, without descending into coordinates or derivatives."""
    stack = [expression]
    while stack:
        node = stack.pop()
        if node in seen:
            continue
        seen.add(node)
        yield node
        stack.extend(reversed(_parts(node)))


def _parts(node: Any) -> tuple[Any, ...]:
    """Return the arguments of a node, none for a function of time or its derivative."""
    if isinstance(node, sympy.Subs):
        return tuple(node.point)
    function = node.expr if isinstance(node, sympy.Derivative) else node
    if isinstance(function, AppliedUndef):
        return () if function.args == (t,) else tuple(function.args)
    return () if isinstance(node, sympy.Derivative) else tuple(node.args)


def _check_supported(node: Any, what: str) -> None:
    if isinstance(node, sympy.Pow) and node.base.is_zero and node.exp.is_negative:
        raise StatementError(f"{what} contains {formula(node, 80)}: check for a division by zero.")
    if isinstance(node, sympy.Pow) and not node.exp.is_number and node.base.is_zero:
        raise StatementError(
            f"{what} contains {formula(node, 80)}: a power of zero jumps where its exponent changes sign and has no "
            "derivative. Write a Piecewise, or another base."
        )
    if isinstance(node, _PLAIN):
        return
    if node is sympy.I:
        raise StatementError(
            f"{what} contains the imaginary unit I. Energies and forces are real: write real expressions."
        )
    if isinstance(node, (sympy.Number, sympy.NumberSymbol)) or node in (sympy.zoo, sympy.nan):
        if not node.is_finite:
            raise StatementError(f"{what} contains {node}, which is not a finite number: check for a division by zero.")
        return
    if type(node) in SYMPY_CLASSES:
        return
    raise StatementError(
        f"{what} contains {type(node).__name__} in {formula(node, 80)!r}, which is not supported. The functions are "
        f"{listing([*WORDS, 'Piecewise'])}, and powers."
    )
