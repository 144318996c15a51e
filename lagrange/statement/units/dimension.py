"""Read, name, multiply and compare dimensions and units, such as "torque", "N*m" and "kg*m/s**2"."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from typing import Any

import sympy

from lagrange.errors import MANY_PARTS, SceneError, StatementError, formula, has_many_parts, shown, suggestion
from lagrange.statement.coordinate import t
from lagrange.statement.expression import check_once
from lagrange.statement.parameters import label_of
from lagrange.statement.scene.expressions import read_expression

SAME_FACTOR = 1e-9
"""Largest difference of the natural logarithms of two scale factors that count as equal. Factors have twelve digits."""

PREFIXES = {"T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}
"""Prefixes of units, with their powers of ten."""

PREFIXED = ("m", "s", "g", "N", "J", "W", "Pa", "Hz", "rad", "A", "C", "V", "F", "H", "T", "ohm", "bar", "eV")
"""Units before which prefixes are allowed."""

BESIDE_NEWTON = {"m": "m", "cm": "cm", "mm": "mm", "s": "s", "ms": "m*s"}
"""Units that may follow N without a sign between: Nm is a torque, Ns a momentum and Nms an angular momentum."""

OTHERS = {
    "min": "minute",
    "sec": "second",
    "rev": "2*pi*rad",
    "revolution": "2*pi*rad",
    "revolutions": "2*pi*rad",
    "rpm": "2*pi*rad/minute",
    "mph": "mile/hour",
    "kmh": "km/hour",
    "kph": "km/hour",
    "knot": "nautical_mile/hour",
    "knots": "nautical_mile/hour",
    "Ohm": "ohm",
    "Wh": "W*hour",
    "kWh": "1000*W*hour",
    "Ah": "A*hour",
    "eV": "1.602176634e-19*J",
    "erg": "J/10000000",
    "dyn": "N/100000",
    "dyne": "N/100000",
    "gf": "9.80665*N/1000",
    "in": "inch",
    "kgf": "9.80665*N",
    "kp": "9.80665*N",
    "lb": "pound",
    "lbf": "4.4482216152605*N",
    "slug": "14.593902937206365*kg",
    "hp": "745.6998715822702*W",
}
"""Further units as expressions in known units. US customary units and the electronvolt are defined by these numbers."""

KNOWN_EXAMPLES = "dimensions such as 'length' and 'torque', and units such as 'm', 'cm', 'inch', 'kg', 'N*m' and 'rpm'"
"""End of a message on an unknown name of a dimension or unit."""

RESPELLED = ("min", "sec", "in")  # Units whose names are functions or reserved words in expressions

SIGNS = {"^": "**", "µ": "u", "μ": "u", "·": "*", "⋅": "*", "²": "**2", "³": "**3", "\u2126": "ohm", "\u03a9": "ohm"}
"""Signs in texts of units, with their plain spelling."""


def plain_text(text: str) -> str:
    """Return the text of a unit as an expression in ASCII names: "N·min" becomes "N*minute"."""
    spelled = text.strip()
    for sign, plain in SIGNS.items():
        spelled = spelled.replace(sign, plain)
    return re.sub(rf"\b({'|'.join(RESPELLED)})\b(?!\s*\()", lambda match: OTHERS[match.group(1)], spelled)


def _prefixed() -> Iterator[tuple[str, str]]:
    for unit in PREFIXED:
        for prefix, power in PREFIXES.items():
            yield f"{prefix}{unit}", f"{10**power}*{unit}" if power > 0 else f"{unit}/{10**-power}"
    for newton in ("N", *(f"{prefix}N" for prefix in PREFIXES)):
        for beside, factor in BESIDE_NEWTON.items():
            yield f"{newton}{beside}", f"{newton}*{factor}"


UNITS: Mapping[str, str] = dict(_prefixed()) | OTHERS
"""Units by name, as expressions in known units. SymPy's unit of the same name, such as mm, has priority."""


DERIVED: Mapping[str, str] = {
    "angular_velocity": "1/time",
    "angular_acceleration": "1/time**2",
    "angular_momentum": "mass*length**2/time",
    "moment_of_inertia": "mass*length**2",
    "torque": "mass*length**2/time**2",
    "stiffness": "mass/time**2",
    "torsional_stiffness": "mass*length**2/time**2",
    "damping": "mass/time",
    "density": "mass/length**3",
    "magnetic_field": "mass/(current*time**2)",
    "electric_field": "mass*length/(current*time**3)",
    "dimensionless": "1",
}
"""Dimensions of mechanics for which SymPy has no name."""

NAMED_FIRST = ("length", "time", "velocity", "acceleration", "mass", "force", "energy", "power", "momentum", "action")
"""Dimensions that messages call by name."""

BASE = ("mass", "length", "time")  # Base dimensions of mechanics, in the order of messages

Exponents = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Dimension:
    """Dimension of a quantity, and its unit if known.

    `exponents` are pairs (base dimension, exponent), sorted by name, without zeros. `factor` is the natural logarithm
    of the scale factor of the unit; None if no unit is known. `unit` is the stated unit, or "".
    """

    exponents: Exponents
    factor: float | None = None
    unit: str = ""

    @classmethod
    def of(cls, exponents: Mapping[str, Any], factor: float | None = None) -> Dimension:
        """Return the Dimension with the exponents {base dimension: exponent}, of which zeros are left out.

        `factor` is the natural logarithm of the scale factor of its unit, or None.
        """
        return cls(tuple(sorted((name, power) for name, power in exponents.items() if power)), factor)

    def __mul__(self, other: Dimension) -> Dimension:
        names = dict(self.exponents)
        for name, power in other.exponents:
            names[name] = names.get(name, Fraction(0)) + power
        return Dimension.of(names, None if self.factor is None or other.factor is None else self.factor + other.factor)

    def __pow__(self, power: Fraction) -> Dimension:
        factor = None if self.factor is None else self.factor * float(power)
        return Dimension.of({name: exponent * power for name, exponent in self.exponents}, factor)

    def like(self, other: Dimension) -> bool:
        """Return True if this dimension and `other` are equal, whatever their units."""
        return self.exponents == other.exponents

    def fits(self, other: Dimension) -> bool:
        """Return True if quantities of these two dimensions may be added.

        Then the dimensions are equal, and so are the scale factors of their units if both are known.
        """
        if not self.like(other):
            return False
        if self.factor is None or other.factor is None:
            return True
        return abs(self.factor - other.factor) <= SAME_FACTOR

    @property
    def in_words(self) -> str:
        """Stated unit as text, or the dimension as text if no unit was stated."""
        return self.unit or str(self)

    def __str__(self) -> str:
        listed = sorted(
            self.exponents, key=lambda entry: (BASE.index(entry[0]) if entry[0] in BASE else len(BASE), entry)
        )
        above = "*".join(power_text(name, power) for name, power in listed if power > 0)
        below = [power_text(name, -power) for name, power in listed if power < 0]
        if not below:
            text = above or "a number"
        else:
            text = f"{above or 1}/{below[0] if len(below) == 1 else '(' + '*'.join(below) + ')'}"
        known = next((name for name in NAMED_FIRST if named(name).exponents == self.exponents), "")
        return text if known in ("", text) else f"{known} ({text})"


def power_text(name: str, power: Any) -> str:
    """Return a positive power of a dimension or unit as a user types it, such as m**2."""
    return name if power == 1 else f"{name}**{power}" if power.denominator == 1 else f"{name}**({power})"


DIMENSIONLESS = Dimension((), 0.0)  # Dimension of a number, and of an angle in radians


@cache
def named(name: str) -> Dimension:
    """Return the dimension with this name, or the dimension of the unit with this name."""
    meaning = known_names()[name]
    return read_dimension(meaning, name) if isinstance(meaning, str) else _measured(meaning)


@cache
def known_names() -> Mapping[str, Any]:
    """Return {name: dimension or unit}: `UNITS`, `DERIVED`, and those of SymPy without physical constants."""
    from sympy.physics import units
    from sympy.physics.units.definitions import dimension_definitions

    dimensions = {
        name: entry for name, entry in vars(dimension_definitions).items() if isinstance(entry, units.Dimension)
    }
    measures = {
        name: entry
        for name, entry in vars(units).items()
        if isinstance(entry, units.Quantity) and not isinstance(entry, units.quantities.PhysicalConstant)
    }
    return {**UNITS, **measures, "g": units.gram, **dimensions, **DERIVED}


def _measured(quantity: Any) -> Dimension:
    """Return the `Dimension` of a SymPy object `quantity`, which is a dimension or a unit."""
    from sympy.physics.units import Quantity
    from sympy.physics.units.systems.si import SI

    unit = isinstance(quantity, Quantity)
    parts = SI.get_dimension_system().get_dimensional_dependencies(
        SI.get_quantity_dimension(quantity) if unit else quantity
    )
    exponents = {str(base.name): Fraction(str(power)) for base, power in parts.items()}
    exponents.pop("angle", None)
    factor = math.log(float(SI.get_quantity_scale_factor(quantity))) if unit else None
    return Dimension.of(exponents, factor)


def read_dimension(value: Any, what: str) -> Dimension:
    """Return the `Dimension` that a user states: "mass", "kg*m/s**2", 1, or a dimension or unit of SymPy.

    `what` is the name of the value in messages. Raises StatementError for an unknown name and for another type.
    """
    if isinstance(value, str):
        stated = _from_text(value, what)
        names = [symbol.name for symbol in stated.free_symbols]
        is_unit = bool(names) and all(name not in DERIVED and named(name).factor is not None for name in names)
        return replace(_dimension_of(stated, what), unit=value.strip() if is_unit else "")
    if isinstance(value, (int, float)) and not isinstance(value, bool) and value == 1:
        return DIMENSIONLESS
    if isinstance(value, sympy.Expr):
        dimension = _dimension_of(value, what)
        return replace(dimension, unit="" if dimension.factor is None else str(value))
    raise StatementError(
        f"{what} is {shown(value)}: give a dimension or a unit, such as 'length', 'm/s**2' or "
        "sympy.physics.units.meter."
    )


def units_in(text: str) -> list[str]:
    """Return the sorted names of the units in the text of a unit, such as m and s for "m/s**2"."""
    return sorted(symbol.name for symbol in _from_text(text, "the unit").free_symbols)


def _from_text(text: str, what: str) -> Any:
    """Return a text such as "kg*m/s**2" as a SymPy expression whose symbols are names of dimensions and units.

    `what` is the name of the text in messages. Raises StatementError for an unknown name.
    """
    spelled = plain_text(text)
    name = spelled.replace(" ", "_")
    known = known_names()
    if name in known:
        return sympy.Symbol(name, positive=True)
    try:
        return read_expression(spelled, {word: sympy.Symbol(word, positive=True) for word in known})
    except SceneError as error:
        words = [name] if name.isidentifier() else re.findall(r"[^\W\d]\w*", spelled)
        if unknown := [w for w in words if w == name or error.reason.startswith(f"{w!r} is not declared")]:
            which = "which" if unknown == words else f"and {unknown[0][:60]!r}"
            hint = suggestion(unknown[0], list(known)) or f" Known are {KNOWN_EXAMPLES}."
            raise StatementError(
                f"{what} is {spelled[:60]!r}, {which} is neither a dimension nor a unit.{hint}"
            ) from None
        raise StatementError(
            f"{what} is {spelled[:60]!r}, which is not a product of dimensions or units: {error.reason}"
        ) from None


def _dimension_of(expression: Any, what: str) -> Dimension:
    """Return the Dimension of an expression that is a product of powers of dimensions and units.

    `what` is the name of the expression in messages. Raises StatementError for other expressions.
    """
    from sympy.physics import units

    if has_many_parts(expression):
        raise StatementError(f"{what} is {MANY_PARTS}: give a product of powers of dimensions or units.")
    dimension = DIMENSIONLESS
    for base, power in sympy.Mul(expression, evaluate=True).as_powers_dict().items():
        if not power.is_Rational:
            raise StatementError(f"{what} is {formula(expression, 60)!r}: powers of dimensions must be numbers.")
        if base.is_number and base.is_positive:
            factor = Dimension((), float(sympy.log(base)))
        elif isinstance(base, sympy.Symbol) and base.name in known_names():
            factor = named(base.name)
        elif isinstance(base, (units.Dimension, units.Quantity)):
            factor = _measured(base)
        else:
            raise StatementError(
                f"{what} is {formula(expression, 60)!r}, which is not a product of powers of dimensions or units: give "
                "one, such as 'mass*length/time**2' or 'N'."
            )
        dimension = dimension * factor ** Fraction(int(power.p), int(power.q))
    return dimension


def read_dimensions(table: Any, known: Mapping[str, Any]) -> dict[Any, Dimension]:
    """Return {symbol: dimension} from a user's table. `known` are the system's symbols by name.

    Keys of the table are symbols or names. Entries for symbols of other systems are checked and left out. Raises
    StatementError for a value that is not a dimension or unit.
    """
    if not isinstance(table, Mapping):
        raise StatementError(
            f"dimensions is {shown(table)}: give a dict from symbols to dimensions, such as {{m: 'mass', l: 'length'}}."
        )
    names = [label_of(key) for key in table]
    check_once(names, "dimensions")
    named_by = dict(zip(names, table.values(), strict=True))
    dimensions = {name: read_dimension(value, f"the dimension of {name}") for name, value in named_by.items()}
    return {known[name]: dimension for name, dimension in dimensions.items() if name in known}


def with_dimensions_of_rates(stated: Mapping[Any, Dimension]) -> dict[Any, Dimension]:
    """Return {symbol: dimension}, in which an entry of a derivative x.dot becomes an entry of the function x.

    The dimension of x is that of x.dot times a time. Raises StatementError if the stated dimensions of x and x.dot
    contradict each other.
    """
    dimensions = {symbol: dimension for symbol, dimension in stated.items() if not isinstance(symbol, sympy.Derivative)}
    time = dimensions.get(t, named("second"))
    for rate, dimension in stated.items():
        if isinstance(rate, sympy.Derivative):
            function, order = rate.expr, len(rate.variables)
            integrated = _times(dimension, time, order)
            base = dimensions.setdefault(function, integrated)
            if not base.fits(integrated):
                expected = _times(base, time, -order)
                raise StatementError(
                    f"dimensions has {label_of(rate)} in {dimension.in_words} and {label_of(function)} in "
                    f"{base.in_words}, with {t} in {time.unit or 's'}: state {label_of(rate)} in {expected.in_words}, "
                    "or leave it out."
                )
            if base.factor is None:
                dimensions[function] = integrated
    return dimensions


def _times(dimension: Dimension, time: Dimension, power: int) -> Dimension:
    """Return `dimension` times a power of `time`, the dimension of t. A stated unit is multiplied too."""
    product = dimension * time ** Fraction(power)
    if not dimension.unit:
        return product
    text = _from_text(dimension.unit, "the unit") * _from_text(time.unit or "s", "the unit of time") ** power
    return replace(product, unit=str(text) if text.free_symbols else "")
