"""The record `Statement` with everything that a user stated about a system, and the units of its displayed values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import inf
from types import MappingProxyType
from typing import Any, NamedTuple

from sympy import Expr, Float, S, Symbol, eye, hessian
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, abridged, formula, listing
from lagrange.statement.contact import Contact, along, gap
from lagrange.statement.coordinate import RATE, acceleration_of, multiplier, name_of, t, velocity_of
from lagrange.statement.expression import in_full, is_shorthand
from lagrange.statement.given.motion import motion_of
from lagrange.statement.rotation import in_body_rates, rotation_of
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.units.dimension import Dimension, named, read_dimension

ROD, SPRING, EDGE = "rod", "spring", "edge"
KINDS = (ROD, SPRING, EDGE)

CHORDS = 64  # Number of straight lines that draw a curved surface. They miss a circle by 1.2e-3 of its radius.


class Link(NamedTuple):
    """Line between two named points in pictures, drawn as a rod, a spring, or an edge of a body. It exerts no force."""

    start: str
    end: str
    kind: str = ROD


def corners(links: Sequence[Link]) -> frozenset[str]:
    """Return the names of points at which only edges of shapes end. Pictures show no mark and no path of them."""
    edges = {name for link in links if link.kind == EDGE for name in link[:2]}
    return frozenset(edges.difference(*(link[:2] for link in links if link.kind != EDGE)))


def friction_names(contacts: Sequence[Contact]) -> frozenset[str]:
    """Return the names of the parameters that are coefficients of friction of `contacts`."""
    return frozenset(mu.name for each in contacts for mu in each.friction if mu.is_Symbol)


@dataclass(frozen=True)
class Constraint:
    """Expression that is zero along the motion. `holonomic` is true if it contains no velocity."""

    name: str
    expression: Any
    holonomic: bool

    @property
    def multiplier(self) -> Any:
        """Symbol of the multiplier of this constraint."""
        return multiplier(self.name)


REFUSE, ALLOW = REDUNDANT = ("refuse", "allow")
"""Words for the treatment of constraints that follow from others: refuse them, or let them share the forces."""


@dataclass(frozen=True, eq=False)
class Statement:
    """Mechanical system as stated: n coordinates, their energies, forces, parameters and initial state.

    Expressions are SymPy, in the coordinates q(t), their velocities Derivative(q(t), t), the parameters and t. `forces`
    has one entry per coordinate, in the order of `coordinates`. `initial` has (q, v), 2n numbers.

    - `constraints` are expressions that stay zero. `redundant` refuses or allows constraints that follow from others.
    - `defaults` lacks the parameters without a value.
    - `dimensions` maps coordinates, parameters and t to their dimensions, if these are stated or follow from others.
    - `given` are given functions of time, and `orders` the order of the highest derivative of each.
    - `unknown` are undefined functions of coordinates, such as U(r).
    - `prescribed` pairs each given function and derivative with the values that replaced it, and `open_form` is the
      statement before this replacement. Without a replacement they are empty and None.
    - `inputs` pairs each input, a parameter whose value changes, with its rate, which is an input too or None. Inputs
      are the last parameters.
    - `contacts` have gaps that stay positive. `simultaneous` is the model of several impacts at one instant, or "".
    - `surfaces` are moving points by name. Each point moves along a line or a curve as `along` grows from 0 to 1.
    - `rotations` are the names of rotations, whose quaternions are among the coordinates. `reading` is the same
      statement for derivations: three small rotations about the axes of each body replace its quaternion and are the
      last coordinates, and `entries` has the nine functions R_xx(t) to R_zz(t) of each rotation.
    - `inferred` are the names of undeclared functions of time in the energies, which were taken for coordinates.
    """

    coordinates: tuple[Any, ...]
    kinetic: Any
    potential: Any
    lagrangian: Any
    forces: tuple[Any, ...]
    dissipation: Any
    parameters: tuple[Symbol, ...]
    defaults: Mapping[Symbol, float]
    initial: tuple[float, ...]
    positions: Mapping[str, tuple[Any, ...]]
    links: tuple[Link, ...]
    name: str
    about: str = ""
    source: str = ""
    run: RunSettings = field(default_factory=RunSettings)
    constraints: tuple[Constraint, ...] = ()
    redundant: str = REFUSE
    dimensions: Mapping[Any, Dimension] = field(default_factory=lambda: MappingProxyType({}))
    given: tuple[Any, ...] = ()
    unknown: tuple[Any, ...] = ()
    orders: tuple[int, ...] = ()
    prescribed: tuple[tuple[Any, Any], ...] = ()
    inputs: tuple[tuple[Symbol, Symbol | None], ...] = ()
    inferred: tuple[str, ...] = ()
    contacts: tuple[Contact, ...] = ()
    simultaneous: str = ""
    surfaces: Mapping[str, tuple[Any, ...]] = field(default_factory=lambda: MappingProxyType({}))
    rotations: tuple[str, ...] = ()
    entries: tuple[tuple[Any, ...], ...] = ()
    reading: Statement | None = None
    open_form: Statement | None = None

    def __repr__(self) -> str:
        return f"<Statement of {self.name}: {abridged(self.names)}>"

    def __getstate__(self) -> dict[str, Any]:
        # Cached properties are left out: they are computed again.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def mapped(self, change: Callable[[Any], Any]) -> Statement:
        """Return the statement with the function `change` applied to each of its expressions."""
        return replace(
            self,
            kinetic=change(self.kinetic),
            potential=change(self.potential),
            lagrangian=change(self.lagrangian),
            forces=tuple(map(change, self.forces)),
            dissipation=change(self.dissipation),
            constraints=tuple(
                replace(constraint, expression=change(constraint.expression)) for constraint in self.constraints
            ),
            positions=MappingProxyType({label: tuple(map(change, point)) for label, point in self.positions.items()}),
            contacts=tuple(each.mapped(change) for each in self.contacts),
            surfaces=MappingProxyType({name: tuple(map(change, point)) for name, point in self.surfaces.items()}),
            reading=None if self.reading is None else self.reading.mapped(change),
        )

    @cached_property
    def velocities(self) -> tuple[Any, ...]:
        """The generalized velocities, n of them."""
        return tuple(velocity_of(q) for q in self.coordinates)

    @cached_property
    def as_read(self) -> Statement:
        """The statement in the form that is displayed.

        Quaternions and their velocities are replaced by small rotations and rates about the axes of the bodies. A
        statement without rotations, or with a quaternion entry in a typed expression, is unchanged.
        """
        if self.reading is None:
            return self
        return self.reading.mapped(lambda expression: in_body_rates(expression, self.rotations))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the n coordinates."""
        return tuple(name_of(q) for q in self.coordinates)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the 2n entries of a state: coordinates, then velocities with the suffix ``_dot``."""
        return (*self.names, *(f"{name}_dot" for name in self.names))

    @property
    def applied(self) -> dict[Any, Any]:
        """Forces by coordinate, as the argument `forces` of `lagrange.System` takes them.

        If small rotations replace quaternions, the keys for torques are the rates about the axes of the body.
        """
        return {getattr(q.func, RATE, q): force for q, force in zip(self.coordinates, self.forces, strict=True)}

    @property
    def lagrangian_alone(self) -> bool:
        """True if the user stated the Lagrangian, and not T and V. Then `kinetic` is L, and `potential` is zero."""
        return bool(self.potential == 0 and self.kinetic == self.lagrangian)

    def highest(self, function: Any) -> int:
        """Return the order of the highest derivative of a given function that the equations may contain.

        It is one more than the highest order in the statement, and at least 2.
        """
        return max(2, self.orders[self.given.index(function)] + 1)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which all given functions have values. Both are infinite without tables."""
        spans = [motion.span for motion in map(motion_of, self.given) if motion is not None]
        return max((first for first, _ in spans), default=-inf), min((last for _, last in spans), default=inf)

    def remarks(self) -> list[str]:
        """Return sentences on likely mistakes: unused parameters, and functions that were taken for coordinates.

        If there are contacts, another sentence says that the equations hold between contacts.
        """
        sentences = []
        if unused := [p.name for p in self.unused]:
            subject = "The parameter {} appears" if len(unused) == 1 else "The parameters {} appear"
            sentences.append(f"{subject.format(listing(unused))} in no energy, force, constraint or position.")
        if self.inferred:
            taken = "is taken as a coordinate" if len(self.inferred) == 1 else "are taken as coordinates"
            sentences.append(
                f"{listing(self.inferred)} {taken}, because the energies contain a function of time of this name; "
                "state a given motion by lg.given(name)."
            )
        typed = self.kinetic if self.reading is None else self.reading.kinetic
        for name in self.rotations:
            inertia = hessian(typed, list(rotation_of(name).space))
            # A multiple of the identity, as of a ball, is the same about all axes.
            if not inertia.has(AppliedUndef) and inertia != inertia[0, 0] * eye(3):
                sentences.append(
                    f"The inertia of {name} is constant about the axes of space and differs between them: that of a "
                    f"body is constant about its own axes, {name}.body."
                )
        if self.contacts:
            names = listing(repr(each.name) for each in self.contacts)
            sentences.append(
                f"The equations are those between contacts, while the gaps {names} are open: impacts, friction and "
                "moved surfaces change energy and momenta."
            )
        return sentences

    @cached_property
    def surfaces_move(self) -> bool:
        """True if the surface of a contact moves by itself, such as a belt, and so may do work.

        The gap or the slip of such a contact changes with time even if all velocities are zero.
        """
        at_rest = dict.fromkeys(self.velocities, S.Zero)
        rates = [rate for contact in self.contacts for rate in (contact.gap.diff(t), *contact.slip)]
        return any(rate.xreplace(at_rest) != 0 for rate in rates)

    @property
    def without_values(self) -> list[Symbol]:
        """Parameters that have no default value."""
        return [p for p in self.parameters if p not in self.defaults]

    def require_parameters(self, reason: str) -> None:
        """Raise StatementError if a parameter has no default value. The message begins with `reason`, "..., and"."""
        if names := [p.name for p in self.without_values]:
            raise StatementError(
                f"{reason} {listing(names)} {'has' if len(names) == 1 else 'have'} no value: state {self.name} with "
                f"parameters={{{names[0]!r}: 1.0}}."
            )

    @property
    def unused(self) -> tuple[Symbol, ...]:
        """Parameters that no energy, force, constraint, position or given function contains."""
        stated = [self.kinetic, self.potential, self.dissipation, *self.forces]
        stated += [constraint.expression for constraint in self.constraints]
        stated += [part for each in self.contacts for part in each.expressions]
        stated += [entry for point in (*self.positions.values(), *self.surfaces.values()) for entry in point]
        motions = (motion_of(function) for function in self.given)
        stated += [motion.values for motion in motions if motion and isinstance(motion.values, Expr)]
        used = frozenset().union(*(expression.free_symbols for expression in stated))
        return tuple(p for p in self.parameters if p not in used)

    @cached_property
    def outlines(self) -> dict[str, dict[str, tuple[Any, ...]]]:
        """Points that draw each surface, {surface: {"name[k]": point}}.

        A straight surface has its two ends, a curve points that are close together.
        """
        outlines = {}
        for name, point in self.surfaces.items():
            straight = all(not entry.diff(along, 2) for entry in point)
            shares = [Float(k / CHORDS) for k in range(0, CHORDS + 1, CHORDS if straight else 1)]
            points = (tuple(entry.xreplace({along: share}) for entry in point) for share in shares)
            outlines[name] = {f"{name}[{k}]": sample for k, sample in enumerate(points)}
        return outlines

    @cached_property
    def drawn(self) -> dict[str, tuple[Any, ...]]:
        """Positions to draw, {name: point}: the named points, and the points of the surfaces."""
        return {**self.positions, **{name: point for line in self.outlines.values() for name, point in line.items()}}

    @property
    def multiplier_names(self) -> list[str]:
        """Names of all multipliers: first of constraints, then of contacts, whose multipliers are normal forces."""
        return [*(constraint.name for constraint in self.constraints), *(each.name for each in self.contacts)]

    def require_formulas(self) -> None:
        """Raise StatementError if a function of coordinates, such as U(r), has no formula."""
        if self.unknown:
            raise StatementError(
                f"{listing(map(str, self.unknown))} {'has' if len(self.unknown) == 1 else 'have'} no formula: a "
                "derivation leaves such a function open, but numbers need a formula. State the system with one."
            )

    def check_without_contacts(self, what: str) -> None:
        """Raise StatementError if the system has contacts, because a result is defined only without impacts.

        `what` is the name of this result in the message.
        """
        if self.contacts:
            names = listing(repr(each.name) for each in self.contacts)
            raise StatementError(
                f"the system has contacts ({names}), which {what} leaves out: state the system without contacts=, with "
                "the closed ones as constraints, or run it."
            )

    @property
    def gaps(self) -> dict[Any, Any]:
        """Gap of each contact, {symbol `lagrange.gap(name)`: expression}."""
        return {gap(each.name): each.gap for each in self.contacts}

    @property
    def known_motions(self) -> list[tuple[Any, Any] | str]:
        """Given functions with values, each as a pair (function, formula), or as a sentence if it is a table."""
        motions = [(function, motion_of(function)) for function in self.given]
        pairs = [(function, motion.values) for function, motion in motions if motion and motion.values is not None]
        return [pair if isinstance(pair[1], Expr) else f"{name_of(pair[0])} is given by {pair[1]}." for pair in pairs]

    @cached_property
    def plain(self) -> Mapping[Any, Any]:
        """Replacement {q(t), velocity or acceleration: real symbol `q`, `q_dot` or `q_ddot`}, for differentiation."""
        table: dict[Any, Any] = {}
        for q, name in zip(self.coordinates, self.names, strict=True):
            table[q] = Symbol(name, real=True)
            table[velocity_of(q)] = Symbol(f"{name}_dot", real=True)
            table[acceleration_of(q)] = Symbol(f"{name}_ddot", real=True)
        return MappingProxyType(table)

    def quote(self, expression: Any, most: int = 80) -> str:
        """Return an expression as text for a message, in plain names, cut to `most` characters.

        Entries and rates of rotations are replaced by their names, such as R_zz, if the expression contains them whole.
        """
        for each in map(rotation_of, self.rotations):
            expression = expression.subs({in_full(f): f for f in (*each.matrix, *each.body, *each.space)})
        names = {f: Symbol(name_of(f)) for f in expression.atoms(AppliedUndef) if is_shorthand(f)}
        return formula(expression.xreplace({**self.plain, **names}), most)


# --- units of displayed values, if the dimensions of the system were stated with units


def has_units(statement: Statement) -> bool:
    """Return True if the dimension of any symbol was stated as a unit."""
    return any(dimension.unit for dimension in statement.dimensions.values())


def unit_of(statement: Statement, name: str) -> str:
    """Return the unit of `name`: a coordinate, a velocity such as x_dot, a parameter, or t. It is "" if not known."""
    if not has_units(statement):
        return ""
    if name == "t":
        return statement.dimensions[t].unit or "s"
    symbols = {symbol.name: symbol for symbol in statement.parameters}
    symbols |= dict(zip(statement.names, statement.coordinates, strict=True))
    base = name if name in symbols else name.removesuffix("_dot")
    unit = _unit(statement, statement.dimensions.get(symbols[base]) if base in symbols else None)
    return f"{unit}/{unit_of(statement, 't')}" if unit and base != name else unit


def length_unit(statement: Statement) -> str:
    """Return the unit of positions: the stated unit of a length, or of a coordinate that is a length, or ""."""
    if not has_units(statement):
        return ""
    length = named("length")
    coordinates = (statement.dimensions.get(q) for q in statement.coordinates)
    units = [_unit(statement, length), *(_unit(statement, q) for q in coordinates if q and q.like(length))]
    return next(filter(None, units), "")


def energy_unit(statement: Statement) -> str:
    """Return the unit of energies: a stated one, J, or a product of units of mass, length and time, or ""."""
    if not has_units(statement):
        return ""
    stated = _unit(statement, named("energy"))
    mass, length, time = _unit(statement, named("mass")), length_unit(statement), unit_of(statement, "t")
    if stated or not (mass and length):
        return stated
    product = read_dimension(f"{mass}*{length}**2/{time}**2", "the unit of energy")
    return "J" if product.fits(named("joule")) else f"{mass}·{length}²/{time}²"


def _unit(statement: Statement, dimension: Dimension | None) -> str:
    """Return the unit of a dimension: its stated unit, rad for an angle, or another unit of the same dimension.

    The other unit is one that was stated for another symbol, or a common one such as cm. "" means that none fits.
    """
    if dimension is None or dimension.unit:
        return "" if dimension is None else dimension.unit
    if not dimension.exponents:
        return "rad"
    stated = [known.unit for known in statement.dimensions.values() if known.unit and known.fits(dimension)]
    if stated or dimension.factor is None:
        return next(iter(stated), "")
    # A common unit may follow from a stated one, such as cm from cm/s**2.
    return next((name for name in ("m", "cm", "mm", "km", "ft", "kg", "g", "s") if named(name).fits(dimension)), "")
