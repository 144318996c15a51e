"""Declare contacts between bodies by gap, slip, restitution and friction, and check these expressions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, formula, listing, located, shown
from lagrange.statement.coordinate import check_name, multiplier, t, velocity_of
from lagrange.statement.expression import expression, one_of, vector
from lagrange.statement.parameters import Survey, table_of

NEWTON, SEQUENCE = LAWS = ("newton", "sequence")
"""Models of impacts of several contacts at one instant: "newton" applies Newton's law of restitution to all contacts
together, and "sequence" treats the contacts one after the other."""

LARGEST_FRICTION = 1e100  # Largest coefficient of friction, so that squares of forces do not overflow

impact_speed = sympy.Symbol("impact_speed", real=True, nonnegative=True)
"""Symbol of the speed -dgap/dt just before an impact, for a restitution that depends on this speed."""

along = sympy.Symbol("along", real=True)
"""Parameter of a drawn surface: 0 at its start and 1 at its end. The surface from (0, 0) to (2, 1) is (2*along,
along)."""


@dataclass(frozen=True)
class Contact:
    """Contact of two bodies. All its fields but `name` are SymPy expressions.

    `gap` is the distance of the surfaces, which stays zero or positive. `slip` has the components of the relative
    velocity along the surface: none without friction, one in a plane, two in space. `restitution` is the speed dgap/dt
    after an impact divided by the speed -dgap/dt before it, between 0 and 1. `friction` has the static and the kinetic
    coefficient of Coulomb's law. `name` is the key of the contact in the table of contacts.
    """

    gap: Any
    slip: tuple[Any, ...]
    restitution: Any
    friction: tuple[Any, Any]
    name: str = ""

    def __post_init__(self) -> None:
        limits: list[tuple[Any, float, str, str]] = [(self.restitution, 1, "restitution", "between 0 and 1")]
        bounds = f"zero or positive, at most {LARGEST_FRICTION:g}"
        limits += [(coefficient, LARGEST_FRICTION, "friction", bounds) for coefficient in self.friction]
        for value, largest, what, bounds in limits:
            is_real = value.is_real is not False  # infinity is not real
            if value.is_number and (value is sympy.nan or not (is_real and 0 <= value <= largest)):
                value_text = formula(value, 40) if value.is_Rational or not is_real else f"{float(value):.10g}"
                raise StatementError(f"{what} is {value_text}: give a number {bounds}.")
        static, kinetic = self.friction
        if static.is_number and kinetic.is_number and static < kinetic:
            pair = f"({float(static):.10g}, {float(kinetic):.10g})"
            raise StatementError(f"friction is {pair}: give (static, kinetic), the static at least the kinetic one.")

    def __repr__(self) -> str:
        slip = f", slip {listing(map(formula, self.slip))}" if self.slip else ""
        numbers = f"restitution {formula(self.restitution)}, friction {listing(map(formula, self.friction))}"
        return f"<Contact: gap {formula(self.gap)}{slip}, {numbers}>"

    @property
    def slip_names(self) -> tuple[str, ...]:
        """Names of the constraints slip = 0 that hold while the contact sticks, one for each component of the slip."""
        if len(self.slip) == 1:
            return (f"{self.name}_slip",)
        return tuple(f"{self.name}_slip_{i}" for i in range(1, len(self.slip) + 1))

    @property
    def normal(self) -> Any:
        """Symbol of the normal force, which is the multiplier of the constraint gap = 0."""
        return multiplier(self.name)

    @property
    def slip_speed(self) -> Any:
        """Expression of the magnitude of the relative velocity along the surface."""
        return sympy.sqrt(sympy.Add(*(slip**2 for slip in self.slip)))

    @property
    def expressions(self) -> tuple[Any, ...]:
        """All expressions of the contact: gap, components of the slip, restitution, static and kinetic friction."""
        return (self.gap, *self.slip, self.restitution, *self.friction)

    def mapped(self, change: Any) -> Contact:
        """Return the contact with the function `change` applied to each of its expressions."""
        slip, (static, kinetic) = tuple(map(change, self.slip)), map(change, self.friction)
        return Contact(change(self.gap), slip, change(self.restitution), (static, kinetic), self.name)


def contact(gap: Any, slip: Any = None, restitution: Any = 0, friction: Any = 0) -> Contact:
    """Return a contact for `contacts={"floor": ...}` of a System.

    `gap` is the distance of two surfaces, an expression in coordinates and t. It stays positive or zero. `slip` is the
    relative velocity of the surfaces along each other: one expression, or two perpendicular ones in space. Without
    `slip` the contact has no friction. `restitution` is a number, a parameter, or an expression in parameters and
    `lagrange.impact_speed`. `friction` is the coefficient of friction, or a pair of the static and the kinetic one.

    Raises StatementError for other types, for numbers that are out of range, and for friction without `slip`.
    """
    components = () if slip is None else tuple(slip) if isinstance(slip, (tuple, list, sympy.MatrixBase)) else (slip,)
    if len(components) > 2:
        raise StatementError(f"slip has {len(components)} components: give one expression, or two in space.")
    pair = tuple(friction) if isinstance(friction, (tuple, list)) else (friction, friction)
    if len(pair) != 2:
        raise StatementError(f"friction is {shown(friction)}: give one coefficient, or (static, kinetic).")
    stated = Contact(
        expression(gap, "the gap of a contact"),
        tuple(expression(component, "the slip of a contact") for component in components),
        expression(restitution, "the restitution of a contact"),
        (expression(pair[0], "the friction of a contact"), expression(pair[1], "the friction of a contact")),
    )
    if not components and not all(coefficient.is_zero for coefficient in stated.friction):
        raise StatementError(
            f"friction is {shown(friction)} without a slip: give slip=, the relative velocity of the surfaces, such as "
            "x.dot."
        )
    return stated


def contacts_between(balls: Any, radius: Any, restitution: Any = 0) -> dict[str, Contact]:
    """Return frictionless contacts between all pairs of balls, as a dict by name for `contacts=` of a System.

    The contact of the balls "a" and "b" is named "a_b". `balls` maps the name of each ball to its centre: (x, y), (x,
    y, z), or one coordinate if all balls are in a row. Balls in a row are listed in their order. `radius` is one radius
    for all balls, or a dict by name. `restitution` is the same for all contacts.

    Raises StatementError for fewer than two balls, for centres of different dimensions, for names that are not
    identifiers, and for two pairs with the same name.
    """
    stated = table_of(balls, "balls", "name to centre")
    centres = {check_name(name, "ball"): vector(at, f"the centre of {name!r}") for name, at in stated.items()}
    if len(centres) < 2 or len({len(at) for at in centres.values()}) != 1:
        raise StatementError(
            f"balls has the centres {shown(balls)}: give two or more, of the same dimension, such as "
            "{'a': (x1, y1), 'b': (x2, y2)}."
        )
    radii = radius if isinstance(radius, Mapping) else dict.fromkeys(centres, radius)
    if missing := [name for name in centres if name not in radii]:
        raise StatementError(f"radius has no entry for {listing(map(repr, missing))}: give each ball a radius.")
    radii = {name: expression(radii[name], f"the radius of {name!r}") for name in centres}
    contacts = {}
    for (a, at), (b, to) in combinations(centres.items(), 2):
        across = [y - x for x, y in zip(at, to, strict=True)]
        distance = across[0] if len(across) == 1 else sympy.sqrt(sympy.Add(*(part**2 for part in across)))
        if (name := f"{a}_{b}") in contacts:
            raise StatementError(f"two pairs of balls have the name {name!r}: leave underscores out of names of balls.")
        contacts[name] = contact(distance - radii[a] - radii[b], restitution=restitution)
    return contacts


def gap(name: str) -> Any:
    """Return the symbol of the gap of the contact `name`, for events and `solution.evaluate`.

    Raises StatementError for a name that is not an identifier.
    """
    return sympy.Symbol(f"gap[{check_name(name, 'contact')}]", real=True)


def declare_contacts(table: Any, simultaneous: Any, survey: Survey, constraints: tuple[Any, ...]) -> dict[str, Any]:
    """Check the contacts of a system. Return {field: value} for `contacts` and `simultaneous` of its Statement.

    `table` maps names to contacts. `simultaneous` is a word of `LAWS`, or None. The symbols and functions of the
    contacts are added to `survey`. `constraints` are the constraints of the statement. Raises StatementError for a gap
    without coordinates, a slip that is not linear in velocities, and a contact that has the name of a constraint.
    """
    contacts, taken = [], [constraint.name for constraint in constraints]
    for key, stated in table_of(table, "contacts", "name to lg.contact(...)").items():
        with located("contacts", key):
            check_name(key, "contact")
            if not isinstance(stated, Contact):
                raise StatementError(f"the contact {key!r} is {shown(stated)}: give lg.contact(gap, ...).")
            each = replace(stated, name=key)
            contacts.append(each)
            _check(each, survey)
            for name in (each.name, *each.slip_names):
                if name in taken:
                    raise StatementError(f"the contact {key!r} has the name of a constraint: choose another name.")
                taken.append(name)
    law = ""
    if simultaneous is not None and not (isinstance(simultaneous, str) and not simultaneous):
        with located("simultaneous"):
            law = one_of(simultaneous, LAWS, "simultaneous is {given}: give one of {known}.")
    return {"contacts": tuple(contacts), "simultaneous": law}


def _check(stated: Contact, survey: Survey) -> None:
    """Add the symbols of a contact's expressions to `survey`. Raises StatementError for symbols that do not belong."""
    what = f"the gap of the contact {stated.name!r}"
    leaves = Survey().add(stated.gap, what)
    if not leaves.coordinates or leaves.velocities:
        reason = "contains a velocity" if leaves.velocities else "contains no coordinate"
        raise StatementError(
            f"{what} is {formula(stated.gap, 60)}, which {reason}: give the distance of the surfaces in coordinates "
            "and t, such as y - R."
        )
    for component in stated.slip:
        what = f"the slip of the contact {stated.name!r}"
        leaves = Survey().add(component, what)
        if not leaves.velocities:
            raise StatementError(
                f"{what} is {formula(component, 60)}, which contains no velocity: give the relative velocity of the "
                "surfaces, such as x.dot."
            )
        rates = [velocity_of(q) for q in leaves.coordinates]
        for rate in rates:
            if component.diff(rate).has(*rates):
                raise StatementError(f"{what} is not linear in {formula(rate, 40)}: give a relative velocity.")
    if len(stated.slip) == 2:
        first, second = stated.slip
        rates = second.atoms(sympy.Derivative) or second.atoms(AppliedUndef)
        if all(sympy.expand(first * second.diff(rate) - second * first.diff(rate)) == 0 for rate in rates):
            raise StatementError(
                f"the two components of the slip of the contact {stated.name!r} are multiples of each other: give one, "
                "or two at right angles in the surface."
            )
    for number, part in ((stated.restitution, "restitution"), *((mu, "friction") for mu in stated.friction)):
        what, symbols, plain = f"the {part} of the contact {stated.name!r}", "parameters", number
        if part == "restitution":
            symbols, plain = "parameters and lg.impact_speed", number.xreplace({impact_speed: sympy.S.One})
        leaves = Survey().add(plain, what)
        if leaves.coordinates or plain.has(t):
            raise StatementError(f"{what} is {formula(number, 60)}: give an expression in {symbols}.")
        survey.add(plain, what)
    for expressed in (stated.gap, *stated.slip):
        survey.add(expressed, f"the contact {stated.name!r}")
