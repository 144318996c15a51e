"""Units of displayed values, if the dimensions of the system were stated with units."""

from __future__ import annotations

from lagrange.equations.euler_lagrange import Equations
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.statement.units.dimension import Dimension, named, read_dimension


def has_units(statement: Statement) -> bool:
    """Return True if any symbol was stated with a unit."""
    return any(dimension.unit for dimension in statement.dimensions.values())


def unit_of(statement: Statement, name: str) -> str:
    """Return the unit of a coordinate, a velocity such as x_dot, a parameter, or t; empty if it is not known."""
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
    """Return the unit of positions: the stated unit of a length, or that of a coordinate which is a length."""
    length = named("length")
    coordinates = (statement.dimensions.get(q) for q in statement.coordinates)
    units = [_unit(statement, length), *(_unit(statement, q) for q in coordinates if q and q.like(length))]
    return next(filter(None, units), "") if has_units(statement) else ""


def energy_unit(statement: Statement) -> str:
    """Return the unit of energies: a stated one, J, or a product of the stated units of mass, length and time."""
    if not has_units(statement):
        return ""
    stated = _unit(statement, named("energy"))
    mass, length, time = _unit(statement, named("mass")), length_unit(statement), unit_of(statement, "t")
    if stated or not (mass and length):
        return stated
    product = read_dimension(f"{mass}*{length}**2/{time}**2", "the unit of energy")
    return "J" if product.fits(named("joule")) else f"{mass}·{length}²/{time}²"


def _unit(statement: Statement, dimension: Dimension | None) -> str:
    """Return the unit of a dimension: the stated one, rad for an angle, else a unit with the same dimension.

    The latter is a unit that was stated for another symbol, or a common one such as cm. "" means that none fits.
    """
    if dimension is None or dimension.unit:
        return "" if dimension is None else dimension.unit
    if not dimension.exponents:
        return "rad"
    stated = [known.unit for known in statement.dimensions.values() if known.unit and known.fits(dimension)]
    if stated or dimension.factor is None:
        return next(iter(stated), "")
    # A unit that follows from others, such as cm from cm/s**2.
    return next((name for name in ("m", "cm", "mm", "km", "ft", "kg", "g", "s") if named(name).fits(dimension)), "")


def energy_letter(equations: Equations) -> str:
    """Return the letter of the energy v.p - L: J for a Jacobi integral that differs from T + V, else E."""
    return "J" if equations.structure.energy_name == "Jacobi integral" else "E"


def with_unit(label: str, unit: str) -> str:
    """Return a label followed by its unit in parentheses."""
    return f"{label} ({unit})" if unit else label
