"""Units of displayed values, if the dimensions of the system were stated with units."""

from __future__ import annotations

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
    parameter = next((one for one in statement.parameters if one.name == name), None)
    if parameter is not None:
        return _unit(statement, statement.dimensions.get(parameter))
    by_name = dict(zip(statement.names, statement.coordinates, strict=True))
    base = name.removesuffix("_dot")
    unit = _unit(statement, statement.dimensions.get(by_name.get(base, t)) if base in by_name else None)
    return f"{unit}/{unit_of(statement, 't')}" if unit and base != name else unit


def length_unit(statement: Statement) -> str:
    """Return the unit of positions: the stated unit of a length."""
    return _unit(statement, named("length")) if has_units(statement) else ""


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
    """Return the unit of a dimension: the unit stated with it, rad for an angle, or the first stated unit that fits."""
    if dimension is None or dimension.unit:
        return "" if dimension is None else dimension.unit
    if not dimension.exponents:
        return "rad"
    return next(
        (
            known_unit.unit
            for known_unit in statement.dimensions.values()
            if known_unit.unit and known_unit.fits(dimension)
        ),
        "",
    )


def with_unit(label: str, unit: str) -> str:
    """Return a label followed by its unit in parentheses."""
    return f"{label} ({unit})" if unit else label
