"""Expand a system about a point (`small`), read the point from `at={...}`, and find corners of the forces near it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy

from lagrange.equations.terms import Direction, Magnitude, Step, printable
from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.mechanics.plain_form import PlainForm, number, simplest, size_of_terms, vanishes
from lagrange.mechanics.reduction import rewritten
from lagrange.statement.coordinate import name_of, rotation_name, velocity_of
from lagrange.statement.expression import entries, expression, whole_number
from lagrange.statement.parameters import Survey, in_own_parameters, label_of, rate_name, table_of
from lagrange.statement.rotation import in_coordinates, is_scalar, rotation_of
from lagrange.statement.statement import Constraint, Statement

_COMPARED = sympy.core.relational.Relational


def edges(expr: Any) -> Sequence[Any]:
    """Return the expressions whose zeros are the corners and jumps of `expr`, such as x for |x|.

    `expr` is a result of `PlainForm.read`: it has symbols in place of functions of time.
    """
    zeros = [node.args[0] for node in sorted(expr.atoms(Magnitude, Direction, Step), key=str)]
    for node in sorted(expr.atoms(sympy.Piecewise), key=str):
        for _, when in node.args:
            zeros += [comparison.lhs - comparison.rhs for comparison in sorted(when.atoms(_COMPARED), key=str)]
    return list(dict.fromkeys(zeros))


def on_side(expr: Any, edge: Any, sign: int) -> Any:
    """Return `expr` without the corner where `edge` = 0: the formula that is valid where `edge` has `sign`, 1 or -1."""
    values = {Magnitude: sign * edge, Direction: sympy.Integer(sign), Step: sympy.Integer(sign > 0)}
    table = {node: values[node.func] for node in expr.atoms(*values) if node.args[0] == edge}
    true = (">", ">=", "!=") if sign > 0 else ("<", "<=", "!=")
    for comparison in sorted(expr.atoms(_COMPARED), key=str):
        if comparison.lhs - comparison.rhs == edge:
            table[comparison] = sympy.true if comparison.rel_op in true else sympy.false
    return expr.xreplace(table)


ROUNDED_PIECES = 2.0**-40
"""Largest difference that counts as rounding, relative to their terms, of two formulas at the point where they meet,
such as two polynomials of a table. It is about 4,000 times the rounding error of a double."""

BALANCED_FORCE = 1e-8  # Largest residual force at an equilibrium in decimals, relative to the stiffness


@dataclass(frozen=True, eq=False)
class StatedPoint:
    """The point about which a system is expanded or linearised. Its values are numbers or expressions in parameters.

    `q` and `v` are the values of the n coordinates and the n velocities. `inputs` maps each input to its value. `form`
    has the formulas of the system.
    """

    form: PlainForm
    q: tuple[Any, ...]
    v: tuple[Any, ...]
    inputs: Mapping[Any, Any]

    @cached_property
    def table(self) -> dict[Any, Any]:
        """Values of coordinates, velocities and inputs at the point, by symbol.

        If the point contains decimals, the values of the parameters are included.
        """
        values = self.numbers if self.decimal else {}
        return {
            **dict(zip(self.form.q, (x.xreplace(values) for x in self.q), strict=True)),
            **dict(zip(self.form.v, (x.xreplace(values) for x in self.v), strict=True)),
            **values,
            **{u: x.xreplace(values) for u, x in self.inputs.items()},
        }

    @property
    def numbers(self) -> dict[Any, Any]:
        """The values of the parameters, {symbol: fraction}. Inputs, and parameters without a value, are left out."""
        return {p: sympy.Rational(x) for p, x in self.form.statement.defaults.items() if p not in self.inputs}

    @cached_property
    def decimal(self) -> bool:
        """True if the point contains decimals, so that it is valid only for the present values of the parameters."""
        return any(x.has(sympy.Float) for x in (*self.q, *self.v, *self.inputs.values()))

    def in_decimals(self) -> StatedPoint:
        """Return the point with decimals in place of expressions, at the values of the parameters. Zeros stay exact."""
        q, v = (
            tuple(x if x == 0 else sympy.N(x.xreplace(self.numbers), 17) for x in part) for part in (self.q, self.v)
        )
        return replace(self, q=q, v=v)

    @property
    def where(self) -> str:
        """Text of the point for messages, such as "x = 0 and x_dot = 2"; velocities that are zero are left out."""
        names = self.form.statement.names
        still = [f"{name} = {shown(x)}" for name, x in zip(names, self.q, strict=True)]
        return listing(still + [f"{name}_dot = {shown(x)}" for name, x in zip(names, self.v, strict=True) if x != 0])

    @cached_property
    def residuals(self) -> tuple[Any, ...]:
        """Residuals of the equations of motion, in a form that is smooth at the point.

        A corner without effect on first derivatives, as of quadratic drag -c v |v|, is removed. Raises StatementError
        if the derivatives on the two sides of a corner differ, as for dry friction at rest.
        """
        return tuple(
            self._smooth(r, name) for r, name in zip(self.form.residuals, self.form.statement.names, strict=True)
        )

    def check_corners(self) -> None:
        """Raise StatementError if forces have a corner or a jump at the point, so that they are not linear near it."""
        if any(edges(x) for x in (self.form.lagrangian, *self.form.forces)):
            _ = self.residuals  # raises the error

    def _smooth(self, residual: Any, name: str) -> Any:
        """Return the residual of the equation of motion of the coordinate `name` in a form without corners."""
        symbols = (*self.form.q, *self.form.v, *self.form.a, *self.inputs)
        for edge in edges(residual):
            if not edge.has(*self.form.q, *self.form.v) or not self.is_zero(edge.xreplace(self.table), ()):
                continue
            sides = [on_side(residual, edge, sign) for sign in (1, -1)]
            branches = [self._branch(side) for side in sides]
            for x in (None, *symbols):
                above, below = (side if x is None else side.diff(x) for side in branches)
                if not self.is_zero((above - below).xreplace(self.table), ()) and not self._are_close(above, below):
                    raise StatementError(
                        f"the forces on {name} have a corner or a jump at {self.where}, where "
                        f"{formula(printable(edge), 60)} is zero, so that they are not linear near it. Choose another "
                        "point."
                    )
            residual = sides[0]
        return residual

    def _branch(self, side: Any) -> Any:
        """Return an expression with each Piecewise replaced by its branch at the point, if it can be determined."""

        def chosen(node: Any) -> Any:
            # A condition such as sin(t) < 1 is neither true nor false: then the branch is unknown.
            branches = ((value, condition.xreplace(self.table)) for value, condition in node.args)
            left = ((value, condition) for value, condition in branches if condition != sympy.false)
            return next((value if condition == sympy.true else node for value, condition in left), node)

        return side.replace(lambda node: node.is_Piecewise, chosen)

    def _are_close(self, above: Any, below: Any) -> bool:
        """Return True if two formulas, valid on the two sides of a corner, differ at the point only by rounding.

        The result is False if the first one has no decimals.
        """
        if not above.has(sympy.Float):
            return False
        values = {**dict.fromkeys(self.form.a, sympy.S.Zero), **self.numbers, **self.table}
        size = max(size_of_terms(side, values) for side in (above, below))
        return abs(number(above - below, values)) <= ROUNDED_PIECES * size

    def is_zero(self, expr: Any, scale: Any) -> bool:
        """Return True if `expr`, the value of an expression at the point, is zero.

        If the point has decimals, a number up to 1e-8 counts as zero, relative to the largest number in the list
        `scale`, or to 1 if that is larger.
        """
        if not self.decimal or expr.free_symbols:
            return vanishes(self.form, expr)
        size = max([1.0, *(abs(complex(printable(x))) for x in scale if not x.free_symbols)])
        return abs(complex(printable(expr))) <= BALANCED_FORCE * size


INPUT_REMEDY = (
    "call linearize(inputs=[{0!r}]) for a matrix B, or "  # Start of the remedy in a message on an input without values
)


def with_inputs_as_parameters(statement: Statement, at: Any, inputs: Any) -> tuple[Statement, Any, tuple[Any, ...]]:
    """Return (statement, point, inputs) with a parameter in place of each input that is a function of time.

    `at` is the user's point, `inputs` the user's list of inputs. Raises StatementError for an input that is neither a
    parameter nor a given function, and for a function whose derivative is in the statement.
    """
    listed = [inputs] if isinstance(inputs, str) else entries(inputs, "inputs")
    named = [label_of(entry) for entry in ([inputs] if listed is None else listed)]
    orders = {name_of(function): order for function, order in zip(statement.given, statement.orders, strict=True)}
    known = [*(p.name for p in statement.parameters), *(name for name, order in orders.items() if not order)]
    for label in named:
        function = next((name for name in orders if label in [rate_name(name, k) for k in range(3)]), "")
        if orders.get(function):
            raise StatementError(
                f"the statement contains derivatives of the input {function}, and in the term B u of linear equations "
                f"there are none: leave {function} out, and state its effect as a force with another input, such as "
                f"-m*a with a = lg.given('a') for the acceleration of {function}."
            )
        if label not in known:
            kind = f"a rate of {function}" if function else "not a parameter of this system"
            kind = "a coordinate or a velocity" if label in statement.state_names else kind
            raise StatementError(
                f"inputs contains {label[:80]!r}, which is {kind}: choose from {listing(known)}, or state the system "
                f"with the input, as in forces={{{statement.names[0]}: u}} with u = lg.given('u')."
            )
    table = {f: sympy.Symbol(name_of(f), real=True) for f in statement.given if name_of(f) in named}
    if table:
        parameters = {p: statement.defaults.get(p) for p in statement.parameters} | dict.fromkeys(table.values())
        statement = rewritten(statement, lambda stated: stated.xreplace(table), parameters=parameters)
        at = {table.get(key, key): x for key, x in at.items()} if isinstance(at, Mapping) else at
    by_name = {p.name: p for p in statement.parameters}
    return statement, at, tuple(by_name[label] for label in named)


def stated_point(
    statement: Statement, at: Any, inputs: Sequence[Any] = (), *, turning: bool = False, table: str = "at"
) -> StatedPoint:
    """Return the expansion point from the user's mapping `at` of coordinates, velocities and `inputs` to their values.

    Symbols without an entry have the value zero; a rotation without an entry is the identity. `turning` permits angular
    velocities of rotations, if no expression of the statement contains an entry of a quaternion. `table` is the name of
    the mapping in messages. Raises StatementError for unknown keys, for values that are not constant, and for angular
    velocities that are not permitted.
    """
    stated = table_of(at, table, f"coordinate or velocity to value, such as {{{statement.names[0]}: 0}}")
    rest = {q: sympy.Integer(is_scalar(q)) for q in statement.coordinates}
    rest |= dict.fromkeys(statement.velocities, sympy.S.Zero)
    rows: dict[Any, Any] = {}
    for q, name in zip(statement.coordinates, statement.names, strict=True):
        rows[q] = rows[name] = q
        rows[velocity_of(q)] = rows[f"{name}_dot"] = velocity_of(q)
    for symbol in inputs:
        rows[symbol] = rows[symbol.name] = symbol
    values = dict(rest)
    for key, value in in_coordinates(stated, rest, table).items():
        known = [label for label in rows if isinstance(label, str)]
        if not isinstance(key, (str, sympy.Basic)) or key not in rows:
            label = label_of(key)
            raise StatementError(
                f"{table} names {shown(label)}, which is not a coordinate, velocity or input; they are "
                f"{listing(known)}." + suggestion(label, known)
            )
        what, survey = f"the value of {key}", Survey()
        constant = expression(value, what)
        survey.add(constant, what)
        if survey.coordinates or survey.velocities:
            names = listing(name_of(q) for q in survey.coordinates)
            raise StatementError(f"{what} contains {names}: give numbers, or expressions in parameters.")
        values[rows[key]] = in_own_parameters(constant, statement.parameters)
    turning = turning and statement.reading is not None
    rotating = (values[velocity_of(q)] != 0 for q in statement.coordinates if rotation_name(q) is not None)
    if not turning and any(rotating):
        raise StatementError(
            "at={...} sets angular velocities of a rotation, but modes and equilibria are those of a body at "
            "rest: leave these velocities out, or call linearize(at) for the linear equations about the spinning body."
        )
    statement = statement if turning else with_lengths(statement)
    return StatedPoint(
        PlainForm(statement),
        tuple(values[q] for q in statement.coordinates),
        tuple(values[v] for v in statement.velocities),
        {symbol: values.get(symbol, sympy.S.Zero) for symbol in inputs},
    )


def with_lengths(statement: Statement) -> Statement:
    """Return the statement without rotations: the entries of a quaternion are four coordinates like any others.

    A constraint keeps the length of each quaternion at one.
    """
    lengths = (
        Constraint(f"{each.name}_length", (sum(q**2 for q in each.quaternion) - 1) / 2, holonomic=True)
        for each in map(rotation_of, statement.rotations)
    )
    return replace(statement, constraints=(*statement.constraints, *lengths), rotations=(), reading=None)


HIGHEST = 8  # Largest order of an expansion: the energy of a double pendulum takes about 1 s to order 8

_SIZE = sympy.Dummy("size", real=True)
"""Symbol for the size of all deviations from the point: expressions are expanded in powers of this symbol."""


def small(statement: Statement, about: Any, order: Any) -> Statement:
    """Return the statement with energies, forces and constraints replaced by Taylor polynomials.

    The polynomials are in deviations from the user's point `about`, of degree `order`, for forces of `order` - 1.
    """
    return _StatementExpansion(stated_point(statement, about), whole_number(order, "order", 2, HIGHEST)).statement()


class _StatementExpansion:
    """Expands the Lagrangian, dissipation and constraints of a statement to degree `order`, forces to `order` - 1."""

    def __init__(self, point: StatedPoint, order: int) -> None:
        self.point, self.form, self.order = point, point.form, order
        self.symbols = (*self.form.q, *self.form.v)
        self.values = tuple(point.table[symbol] for symbol in self.symbols)
        self.changes = tuple(sympy.Dummy(f"d{symbol}", real=True) for symbol in self.symbols)

    def statement(self) -> Statement:
        """Return the expanded statement, whose description `about` has the point and the order of the expansion."""
        stated = self.form.statement
        for constraint in stated.constraints:
            residual = simplest(self.form.read(constraint.expression).xreplace(self.point.table))
            if not self.point.is_zero(residual, ()):
                raise StatementError(
                    f"the point is not on the constraint {constraint.name!r}, which is "
                    f"{formula(printable(residual), 80)} there and not zero: give values of all coordinates in it."
                )
        table = {
            expression: self.expanded(expression, what, self.order)
            for expression, what in (
                (stated.kinetic, "the kinetic energy"),
                (stated.potential, "the potential energy"),
                (stated.lagrangian, "the Lagrangian"),
                (stated.dissipation, "the dissipation"),
                *((constraint.expression, f"the constraint {constraint.name!r}") for constraint in stated.constraints),
            )
        }
        self.check_inertia(table[stated.lagrangian])
        forces = {
            q: self.expanded(force, f"the force on {name}", self.order - 1)
            for q, name, force in zip(stated.coordinates, stated.names, stated.forces, strict=True)
        }
        expansion = rewritten(stated, lambda expression: table.get(expression, expression), forces=forces)
        about = " ".join(part for part in (stated.about, self.note) if part)
        return replace(expansion, positions=stated.positions, about=about)

    def expanded(self, stated: Any, what: str, order: int) -> Any:
        """Return the Taylor polynomial of an expression about the point, up to degree `order`.

        Its variables are the deviations of coordinates and velocities from the point. `what` names the expression in
        errors.
        """
        plain = self.form.read(stated)
        self.check_smooth(plain, what)
        moved = {
            symbol: value + _SIZE * change
            for symbol, value, change in zip(self.symbols, self.values, self.changes, strict=True)
        }
        along = plain.xreplace({**self.point.table, **moved})
        total = sympy.S.Zero
        for power in range(order + 1):
            term = along.xreplace({_SIZE: sympy.S.Zero}) / sympy.factorial(power)
            if term.has(sympy.nan, sympy.zoo, sympy.oo, sympy.AccumBounds):
                raise StatementError(
                    f"{what} has no expansion about {self.point.where}: it, or a derivative up to order {order}, is "
                    "not finite there. Choose another point, or coordinates that are regular at it."
                )
            total += self.collected(term)
            along = along.diff(_SIZE) if power < order else along
        return self.form.written(total)

    def collected(self, term: Any) -> Any:
        """Return `term`, a polynomial in symbols d for deviations from the point, as a sum of powers of (x - x0).

        x are coordinates or velocities, and x0 their values at the point. The coefficients are simplified.
        """
        polynomial = sympy.Poly(sympy.expand(term), *self.changes)
        differences = [symbol - value for symbol, value in zip(self.symbols, self.values, strict=True)]
        return sympy.Add(
            *(
                simplest(factor) * sympy.Mul(*(x**k for x, k in zip(differences, powers, strict=True)))
                for powers, factor in polynomial.terms()
            )
        )

    def check_smooth(self, expr: Any, what: str) -> None:
        """Raise StatementError for an expression with a corner or a jump at the point; `what` names the expression."""
        point = dict(zip(self.symbols, self.values, strict=True))
        for edge in edges(expr):
            if edge.has(*self.symbols) and simplest(edge.xreplace({**self.point.table, **point})) == 0:
                raise StatementError(
                    f"{what} has no expansion about {self.point.where}: it has a corner or a jump where "
                    f"{formula(printable(edge), 60)} is zero, as at this point. Choose a point next to it."
                )

    def check_inertia(self, lagrangian: Any) -> None:
        """Raise StatementError if a velocity in the Lagrangian of the system is not in the expanded `lagrangian`."""
        stated = self.form.statement
        lost = [
            name
            for name, v in zip(stated.names, stated.velocities, strict=True)
            if stated.lagrangian.has(v) and not lagrangian.has(v)
        ]
        if lost:
            raise StatementError(
                f"the inertia of {listing(lost)} vanishes at {self.point.where}, so the Lagrangian to order "
                f"{self.order} does not contain this velocity: choose coordinates that are regular at the point, or "
                "another point."
            )

    @property
    def note(self) -> str:
        """Description of the expansion in sentences; it says so if the point is not an equilibrium."""
        description = (
            f"Expanded about {self.point.where} to order {self.order} in changes of coordinates and velocities."
        )
        if self.balanced:
            return description
        return (
            f"{description} The point is not an equilibrium: terms of first order remain, and accelerations are those "
            "of the system at the point alone."
        )

    @cached_property
    def balanced(self) -> bool:
        """True if the point is an equilibrium, possibly with constraint forces."""
        if any(x != 0 for x in self.values[len(self.form.q) :]):
            return False
        still = {**self.point.table, **dict.fromkeys(self.form.a, sympy.S.Zero)}
        rest = [simplest(r.xreplace(still)) for r in self.form.residuals]
        rows = [
            [
                simplest(self.form.read(constraint.expression).diff(x).xreplace(self.point.table))
                for x in (self.form.q if constraint.holonomic else self.form.v)
            ]
            for constraint in self.form.statement.constraints
        ]
        if not rows:
            return all(self.point.is_zero(r, ()) for r in rest)
        gradients = sympy.Matrix(rows).T
        return bool(gradients.row_join(sympy.Matrix(rest)).rank(simplify=simplest) == gradients.rank(simplify=simplest))
