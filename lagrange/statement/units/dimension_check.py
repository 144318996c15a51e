"""Check the dimensions and units of all terms of a statement and its events. Infer dimensions that were not stated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import product
from types import MappingProxyType
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.functions.elementary.trigonometric import TrigonometricFunction

from lagrange.errors import StatementError, located
from lagrange.statement.contact import Contact, along, impact_speed
from lagrange.statement.coordinate import RATE, name_of, t
from lagrange.statement.expression import one_of
from lagrange.statement.given.motion import motion_of, table_range
from lagrange.statement.parameters import in_own_parameters, label_of, rate_name
from lagrange.statement.rotation import rotation_of
from lagrange.statement.statement import Statement
from lagrange.statement.units.dimension import (
    BASE,
    DIMENSIONLESS,
    SAME_FACTOR,
    Dimension,
    named,
    power_text,
    read_dimension,
    read_dimensions,
    units_in,
    with_dimensions_of_rates,
)
from lagrange.statement.units.unit_equations import (
    SAME_DIMENSION,
    CheckedPart,
    UnitEquations,
    UnitFactor,
    UnitProduct,
    in_short,
    inner_parts,
    number_of,
)

NO_UNIT = (
    " The numbers of a table have no unit: with parameters for the units of its points and values write "
    "value*lg.table(x/point, points, values)."
)
"""End of a message on a table, or its argument, with a wrong dimension. It says how to give the numbers units."""


NUMBER_REMEDY = " A number has no unit: put a parameter in its place, such as d with dimensions={'d': 'm'}."
"""End of a message on a number that should have a dimension."""


class WrongTermError(Exception):
    """Error: a `term` of an expression has another `unit` than `expected`.

    `context` says where the term is: "whole" if it is the expression itself, or in a "sum", a "power" or a "function".
    `within` is this function.
    """

    def __init__(self, term: Any, unit: UnitProduct, expected: UnitProduct, context: str, within: Any = None) -> None:
        super().__init__()
        self.term, self.unit, self.expected, self.context, self.within = term, unit, expected, context, within


@located("dimensions")
def with_dimensions(statement: Statement, table: Mapping[Any, Any]) -> Statement:
    """Return the statement with the dimensions of its symbols, stated in the user's `table` or inferred.

    Raises StatementError that names the first term with a wrong dimension.
    """
    known = {"t": t, **dict(zip(statement.names, statement.coordinates, strict=True))}
    known |= {symbol.name: symbol for symbol in statement.parameters}
    known |= {name_of(function): function for function in statement.given}
    functions = (*statement.coordinates, *statement.given)
    rates = {rate_name(name_of(q), order): q.diff(t, order) for q in functions for order in (1, 2)}
    stated = with_dimensions_of_rates(read_dimensions(table, known | rates))
    for rotation in map(rotation_of, statement.rotations):
        stated |= dict.fromkeys((*rotation.quaternion, *rotation.matrix, *rotation.turns), DIMENSIONLESS)
        rate = stated.get(t, named("second")) ** Fraction(-1)
        stated |= dict.fromkeys((*rotation.body, *rotation.space), rate)
    parts = _parts(statement, stated)
    dimensions = check_dimensions(parts, stated, statement.plain)
    check_dimensions(parts, dimensions | dict(multiplier_dimensions(statement, dimensions)), statement.plain)
    for key in table:  # A symbol of SymPy may belong to another system
        if not isinstance(key, sympy.Basic) and key not in rates:
            one_of(
                label_of(key),
                known,
                "dimensions names {given}, which this system does not have; its symbols are {known}.",
            )
    return replace(statement, dimensions=MappingProxyType(dimensions))


def _parts(statement: Statement, known: Mapping[Any, Dimension]) -> list[CheckedPart]:
    """Return all expressions of a statement with their required dimensions, such as energy over q for the force on q.

    `known` are the stated dimensions by symbol.
    """
    read = statement.reading or statement  # With torques about the axes of bodies instead of forces on quaternions
    energies = {"the Lagrangian": read.lagrangian}
    if not read.lagrangian_alone:
        energies = {"the kinetic energy": read.kinetic, "the potential energy": read.potential}
    parts = [CheckedPart(what, expression, "energy") for what, expression in energies.items()]
    # Terms of an equation of first order may have any dimension, such as voltage, if it is the same for all.
    inertial = (read.lagrangian, *(constraint.expression for constraint in read.constraints))
    torqued = {q: getattr(q.func, RATE) for q in read.coordinates if hasattr(q.func, RATE)}
    rates = zip(read.coordinates, read.velocities, strict=True)
    first_order = {q: rate for q, rate in rates if q not in torqued and not any(part.has(q, rate) for part in inertial)}
    for name, q, force in zip(read.names, read.coordinates, read.forces, strict=True):
        if q in first_order:
            equation = sympy.Add(force, -read.dissipation.diff(first_order[q]), evaluate=False)
            parts.append(CheckedPart(f"the equation of {name}", equation, None))
        elif force != 0:
            what = f"the torque on {name_of(torqued[q])}" if q in torqued else f"the force on {name}"
            parts.append(CheckedPart(what, force, "energy", q))
    dissipation = read.dissipation.xreplace(dict.fromkeys(first_order.values(), sympy.S.Zero))
    parts += [CheckedPart("the dissipation", dissipation, "energy", t)]
    parts += [
        CheckedPart(f"the constraint {constraint.name}", constraint.expression, None) for constraint in read.constraints
    ]
    for label, point in (*statement.positions.items(), *statement.surfaces.items()):
        what = f"the position of {label}" if label in statement.positions else f"the surface of {label}"
        parts += [CheckedPart(what, entry, "length") for entry in point if not entry.has(along)]
    for contact in statement.contacts:
        parts += _contact_parts(contact)
    motions = {function: motion_of(function) for function in statement.given}
    for function, motion in motions.items():
        if motion is not None and motion.expression is not None:
            values = _without_own_numbers(in_own_parameters(motion.expression, statement.parameters), function, known)
            parts.append(CheckedPart(f"the given function {name_of(function)}", values, function))
    return parts


def _contact_parts(contact: Contact) -> Iterator[CheckedPart]:
    """Yield the expressions of a contact to check: slips are rates of the gap, restitution and friction are numbers."""
    what, speed = f"the contact {contact.name}", contact.gap.diff(t)
    yield CheckedPart(f"the gap of {what}", contact.gap, None)
    for component in contact.slip:
        yield CheckedPart(
            f"the slip of {what}, like the gap's rate,", sympy.Add(component, speed, evaluate=False), None
        )
    restitution = contact.restitution.xreplace({impact_speed: speed})
    yield CheckedPart(f"the restitution of {what}", restitution, "dimensionless")
    for coefficient in contact.friction:
        yield CheckedPart(f"the friction of {what}", coefficient, "dimensionless")


def multiplier_dimensions(statement: Statement, known: Mapping[Any, Dimension]) -> Iterator[tuple[Any, Dimension]]:
    """Yield (multiplier, dimension) for each constraint.

    A multiplier times a holonomic constraint is an energy. A multiplier times a constraint on velocities, times a time,
    is an energy. `known` are the dimensions of the other symbols.
    """
    energy = dimension_of(statement.lagrangian, known) or named("energy")
    for constraint in statement.constraints:
        dimension = dimension_of(constraint.expression, known)
        if dimension is not None:
            over = dimension if constraint.holonomic else dimension * known[t]
            yield constraint.multiplier, energy * over ** Fraction(-1)


def check_dimensions(
    parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], symbols: Mapping[Any, Any]
) -> dict[Any, Dimension]:
    """Return the dimensions of all symbols, stated or inferred, with the scale factors of their units if any is stated.

    `parts` are the expressions to check, and `dimensions` the stated dimensions. `symbols` maps functions of time to
    symbols for messages. Raises StatementError for the first term with a wrong dimension, else for the first one in a
    wrong unit, and for a symbol whose unit would not be a product of the stated base units.
    """
    known = {t: named("second"), **dimensions}
    inferred = UnitEquations(known, parts)
    for symbol in [node for node in inferred.units if isinstance(node, (sympy.Symbol, AppliedUndef))]:
        dimension = None if symbol in known else inferred.dimension(symbol)
        if dimension is not None:
            # A root of a length is not the dimension of a quantity of mechanics. A symbol with such a dimension is
            # taken for an angle, so that the check below names the wrong term.
            whole = dimension.exponents and all(power.denominator == 1 for _, power in dimension.exponents)
            known[symbol] = Dimension(dimension.exponents) if whole else DIMENSIONLESS
    equations = UnitEquations(known, parts)
    if (wrong := _first_wrong(parts, equations, scales=False)) is not None:
        raise StatementError(_wrong_dimension(*wrong, equations, symbols))
    stated = [dimension for dimension in known.values() if dimension.unit]
    if not stated:
        return known
    if (wrong := _first_wrong(parts, equations, scales=True)) is not None:
        raise StatementError(_wrong_unit(*wrong, equations, symbols) + _remedy(parts, known, wrong[1].term))
    completed = {symbol: _completed(equations, symbol, dimension) for symbol, dimension in known.items()}
    _check_inferred(stated, completed)
    return completed


def _first_wrong(
    parts: Sequence[CheckedPart], equations: UnitEquations, *, scales: bool
) -> tuple[CheckedPart, WrongTermError] | None:
    """Return the first part with a wrong term, and the error that names the term. Return None if all parts are right.

    If `scales` is true, the scale factors of units are compared too, not only dimensions.
    """
    checker = _Checker(equations, scales)
    for part in parts:
        try:
            checker.check(part.expression, equations.required(part))
        except WrongTermError as wrong:
            return part, wrong
    return None


def dimension_of(expression: Any, known: Mapping[Any, Dimension]) -> Dimension | None:
    """Return the dimension of an expression from `known`, those of its symbols, or None if it is undetermined."""
    return UnitEquations(known).dimension(expression)


def _wrong_dimension(
    part: CheckedPart, wrong: WrongTermError, equations: UnitEquations, plain: Mapping[Any, Any]
) -> str:
    """Return the message for a term with a wrong dimension. `plain` maps functions of time to symbols for messages."""
    term = in_short(wrong.term, plain)
    contexts = {"whole": "", "sum": "like the other terms ", "power": "under a power that is not a number "}
    where = contexts[wrong.context] if wrong.context in contexts else f"in {in_short(wrong.within, plain)} "
    terms = sympy.Add.make_args(part.expression)
    outer = next((candidate for candidate in terms if wrong.term not in terms and candidate.has(wrong.term)), None)
    inside = (
        "" if outer is None or wrong.term.is_number or wrong.context == "function" else f", in {in_short(outer, plain)}"
    )
    dimension, expected = map(equations.dimension_of_unit, (wrong.unit, wrong.expected))
    has = f"{part.what} has the term {term}{inside}, whose dimension is {dimension}"
    tables = any(map(table_range, (wrong.term, wrong.within)))
    remedy = NO_UNIT if tables else NUMBER_REMEDY if wrong.term.is_number else ""
    return f"{has}; {where}it should be {expected}.{remedy}"


def _wrong_unit(part: CheckedPart, wrong: WrongTermError, equations: UnitEquations, plain: Mapping[Any, Any]) -> str:
    """Return the message for a term in a wrong unit, without the remedy at its end.

    `part` is the expression with this term. `plain` maps functions of time to symbols for the message.
    """
    term, unit = in_short(wrong.term, plain), "times that of the other terms"
    if wrong.within is not None:
        term = f"{term} in {in_short(wrong.within, plain)}"
        unit = "rad" if isinstance(wrong.within, TrigonometricFunction) else "instead of a number"
    ratio = equations.reduced(wrong.unit.times(wrong.expected, Fraction(-1)))
    return f"{part.what} has the term {term}, whose unit is {_factor(ratio.logarithm)} {unit}: "


class _Checker:
    """Checker of the unit of every term: its dimension and, if `scales` is true, the scale factor.

    In its methods `expected` is the required unit of an expression, or None if any unit is accepted. An undetermined
    unit is accepted too.
    """

    def __init__(self, equations: UnitEquations, scales: bool) -> None:
        self.equations, self.scales, self.unit = equations, scales, equations.unit

    def fits(self, unit: UnitProduct | None, other: UnitProduct | None) -> bool:
        """Return True if quantities in two units may be added. None is the unit of zero, which fits every unit."""
        if unit is None or other is None:
            return True
        ratio = self.equations.reduced(unit.times(other, Fraction(-1)))
        if ratio.unknown(sympy.Basic) is not None:
            return True
        same_scale = ratio.unknown(UnitFactor) is not None or abs(ratio.logarithm) <= SAME_FACTOR
        return ratio.unknown(str) is None and (same_scale or not self.scales)

    def check(self, expression: Any, expected: UnitProduct | None) -> UnitProduct | None:
        """Return the unit of an expression. Raises WrongTermError for the first term in a wrong unit."""
        if expression.is_Add or isinstance(expression, SAME_DIMENSION):
            return self._sum(expression, expected)
        unit = self._single(expression, expected)
        if unit is not None and expected is not None and not self.fits(unit, expected):
            raise WrongTermError(expression, unit, expected, "whole")
        return unit

    def _sum(self, expression: Any, expected: UnitProduct | None) -> UnitProduct | None:
        """Return the unit of a sum. Raises WrongTermError if units of terms differ, or if their unit is not `expected`.

        All terms must have one unit: `expected` if some term has it, else the most frequent one.
        """
        units = list[tuple[Any, UnitProduct]]()
        for term in expression.args:
            # A term that is a sum has no required unit.
            is_sum = term.is_Add or isinstance(term, SAME_DIMENSION)
            unit = self.check(term, None) if is_sum else self._single(term, expected)
            units += [] if unit is None else [(term, unit)]
        groups = list[list[UnitProduct]]()
        for _, unit in units:
            group = next((group for group in groups if self.fits(unit, group[0])), None)
            groups.append([unit]) if group is None else group.append(unit)
        if not groups:
            return None
        right = max(groups, key=len)[0]
        if expected is not None and any(self.fits(group[0], expected) for group in groups):
            right = expected
        for term, unit in units:
            if not self.fits(unit, right):
                raise WrongTermError(term, unit, right, "sum")
        if expected is not None and not self.fits(right, expected):
            raise WrongTermError(units[0][0], right, expected, "whole")
        return right

    def _single(self, expression: Any, expected: UnitProduct | None) -> UnitProduct | None:
        if expression.is_Mul:
            self._product(expression, expected)
        elif expression.is_Pow:
            self._power(expression.base, expression.exp, expected)
        else:
            for argument, required in inner_parts(expression, expected):
                try:
                    self.check(argument, required)
                except WrongTermError as wrong:
                    if wrong.context != "whole":
                        raise
                    raise WrongTermError(wrong.term, wrong.unit, wrong.expected, "function", expression) from None
        return self.unit(expression)

    def _product(self, expression: Any, expected: UnitProduct | None) -> None:
        """Check the factors of a product. Raises WrongTermError for a wrong factor.

        A factor that is a sum of terms in different units should have `expected` divided by the other factors.
        """
        for factor in expression.args:
            others = self.unit(sympy.Mul(*(other for other in expression.args if other is not factor)))
            left = None if expected is None or others is None else expected.times(others, Fraction(-1))
            if factor.is_Pow:
                self._power(factor.base, factor.exp, left)
            else:
                self.check(factor, left if self._differs(factor) else None)

    def _power(self, base: Any, exponent: Any, expected: UnitProduct | None) -> None:
        """Check the base and the exponent of a power. Raises WrongTermError for a wrong term.

        A base that is a sum of terms in different units should have the root of `expected`. An exponent that is not
        a number must be dimensionless, and so must its base.
        """
        power = number_of(exponent)
        if power is None:
            self.check(exponent, UnitProduct())
            unit = self.unit(base)
            if unit is not None and not self.fits(unit, UnitProduct()):
                raise WrongTermError(base, unit, UnitProduct(), "power")
        root = UnitProduct().times(expected, 1 / power) if power and expected is not None else None
        self.check(base, root if self._differs(base) else None)

    def _differs(self, expression: Any) -> bool:
        """Return True if an expression is a sum of terms in different units."""
        units = list(map(self.unit, expression.args)) if expression.is_Add else []
        return any(not self.fits(unit, units[0]) for unit in units)


@lru_cache(maxsize=64)
def check_event_dimensions(index: int, zero: Any, resets: tuple[tuple[Any, Any], ...], statement: Statement) -> None:
    """Raise StatementError for terms of an event, or of its reset, that differ in dimension or unit.

    `index` is the number of the event, `zero` its expression, and `resets` are pairs (reset variable, new value).
    """
    known = dict(statement.dimensions) | dict(multiplier_dimensions(statement, statement.dimensions))
    known |= {symbol: dimension for symbol, _ in resets if (dimension := dimension_of(symbol, known)) is not None}
    parts = [CheckedPart(f"event {index}", _without_own_numbers(zero, None, known), None)]
    parts += [
        CheckedPart(f"the reset of event {index}", _without_own_numbers(value, symbol, known), symbol)
        for symbol, value in resets
    ]
    check_dimensions(parts, known, statement.plain)


def _without_own_numbers(value: Any, like: Any, known: Mapping[Any, Dimension]) -> Any:
    """Return an expression without parts that contain only numbers and t: the units of such numbers are not stated.

    Such terms are left out, and such factors are replaced by 1: `a*sin(2*t) + 0.1` becomes a, and an event `x - 3`
    becomes x. Some of these terms need no unit, and stay. Multiples of t stay beside terms that are times, as in `t -
    a`, and alone if the expression should have the dimension of `like` and this is a time. Numbers stay beside ratios
    of quantities, as in `x/a - 1`. `known` are the dimensions of symbols.
    """
    all_known = {t: named("second"), **known}

    def is_time(term: Any) -> bool:
        dimension = dimension_of(term, all_known)
        return dimension is not None and dimension.like(all_known[t])

    def is_ratio(term: Any) -> bool:
        dimension = dimension_of(term, all_known)
        measured = [all_known[symbol] for symbol in term.atoms(sympy.Symbol, AppliedUndef) if symbol in all_known]
        return dimension is not None and not dimension.exponents and any(entry.exponents for entry in measured)

    def is_own(node: Any) -> bool:
        return node.free_symbols <= {t} and not node.has(AppliedUndef)

    def without(node: Any) -> Any:
        left = [term for term in node.args if not is_own(term)] if node.is_Add else []
        if any(map(is_time, left)):
            left += [term for term in node.args if (term / t).is_number]
        elif any(map(is_ratio, left)):
            left += [term for term in node.args if term.is_number]
        return sympy.Add(*left) if left else sympy.S.One

    multiples = [term for term in sympy.Add.make_args(value) if (term / t).is_number]
    if multiples and like is not None and is_time(like) and value.free_symbols == {t}:
        return sympy.Add(*multiples)
    functions = (sympy.Function, sympy.Piecewise)
    replaced = value.replace(lambda node: node.is_Add or (isinstance(node, functions) and is_own(node)), without)
    return sympy.S.Zero if is_own(value) else replaced


COHERENT = {"mass": "kg", "length": "m", "time": "s"}  # Base units of N, J, W and other SI units

DERIVED = ("N", "N*m", "N/m", "N*s/m", "N*m*s", "W", "kg*m**2", "A", "V", "ohm", "H", "F", "C", "N*m/A")
"""Units that a remedy writes in place of products of kg, m, s and A."""

LARGEST = 700.0  # Largest logarithm of a factor that is printed as a number, since doubles overflow at 709

FIT = "state all symbols in units that fit together, such as kg, m and s, and angles in rad."
"""End of a message on units that do not fit together: the remedy."""

MOST_TRIED = 12  # Largest number of symbols for which another unit is tried. Each takes the time of one check.
MOST_REMEDIES, MOST_NAMED = 2, 4  # Largest numbers of remedies and of stated units in a message


def _remedy(parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], wrong_term: Any) -> str:
    """Return the remedy for a term in a wrong unit, such as "state x in cm instead of m.".

    `parts` are the checked expressions, and `dimensions` those of all symbols. Other units are tried for one symbol
    after another. Symbols in the term `wrong_term` come first.
    """
    stated = [symbol for symbol, dimension in dimensions.items() if dimension.unit]
    # Symbols of the term come first, since one of them is more often the wrong one.
    stated.sort(key=lambda symbol: not wrong_term.has(symbol))
    mended = [
        f"{label_of(symbol)} in {unit} instead of {dimensions[symbol].unit}"
        for symbol in stated[:MOST_TRIED]
        if (unit := _fitting_unit(parts, dimensions, symbol))
    ]
    if mended:
        return f"state {', or '.join(mended[:MOST_REMEDIES])}."
    units = ", ".join(f"{label_of(symbol)} in {dimensions[symbol].unit}" for symbol in stated[:MOST_NAMED])
    return f"{FIT} Stated are {units}."


def _fitting_unit(parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], symbol: Any) -> str:
    """Return the unit of a symbol that fits the units of all other symbols, or "" if there is none.

    `parts` are the checked expressions, and `dimensions` those of all symbols.
    """
    others = {**dimensions, symbol: Dimension(dimensions[symbol].exponents)}
    equations = UnitEquations(others, parts)
    if _first_wrong(parts, equations, scales=True) is not None:
        return ""
    factor = _completed(equations, symbol, others[symbol]).factor
    exponents = dimensions[symbol].exponents
    if not exponents:
        return "rad"
    derived = next((unit for unit in DERIVED if Dimension(exponents, factor).fits(read_dimension(unit, unit))), "")
    if factor is not None and derived:
        return derived
    bases = _base_units([dimension for dimension in others.values() if dimension.unit])
    if factor is None or not all(name in bases for name, _ in exponents):
        return ""
    deviation, text = min(((abs(factor - scale), text) for scale, text in _made(bases, dimensions[symbol])))
    return text if deviation <= SAME_FACTOR else ""


def _completed(equations: UnitEquations, symbol: Any, dimension: Dimension) -> Dimension:
    """Return `dimension` with the scale factor of the unit of `symbol` that follows from the unit equations.

    The factor is None if `equations` do not determine it.
    """
    unit_dimension = equations.dimension(symbol)
    return replace(dimension, factor=None if unit_dimension is None else unit_dimension.factor)


def _factor(logarithm: float) -> str:
    """Return the scale factor of a unit as text, from its natural logarithm."""
    if abs(logarithm) < LARGEST:
        return f"{math.exp(logarithm):.6g}"
    return f"10**{logarithm / math.log(10):.0f}"


def _check_inferred(stated: Sequence[Dimension], inferred: Mapping[Any, Dimension]) -> None:
    """Raise StatementError for an inferred unit that is not a product of powers of the stated base units.

    `stated` are the stated dimensions, and `inferred` maps symbols to dimensions.
    """
    bases = _base_units(stated)
    for symbol, dimension in inferred.items():
        factor = dimension.factor
        if dimension.unit or factor is None or not all(name in bases for name, _ in dimension.exponents):
            continue
        excess, text = min(
            ((factor - scale, text) for scale, text in _made(bases, dimension)), key=lambda candidate: abs(candidate[0])
        )
        if abs(excess) > SAME_FACTOR:
            name = name_of(symbol) if isinstance(symbol, AppliedUndef) else symbol
            raise StatementError(
                f"no unit was stated for {name}. From its terms follows {_factor(excess)} {text}, so the stated units "
                f"do not fit together: state the unit of {name}, or {FIT}"
            )


def _base_units(stated: Sequence[Dimension]) -> dict[str, dict[str, tuple[float, Fraction]]]:
    """Return {base dimension: {unit: (logarithm of its factor, power)}} for the base units in the stated units.

    The power is the exponent of the base dimension in the unit, such as -1 for Hz. Derived units such as N and J add
    kg, m and s.
    """
    bases: dict[str, dict[str, tuple[float, Fraction]]] = {"time": {"s": (0.0, Fraction(1))}}
    for name in (name for dimension in stated for name in units_in(dimension.unit)):
        measure = named(name)
        if len(measure.exponents) == 1 and measure.factor is not None:
            ((base, power),) = measure.exponents
            bases.setdefault(base, {})[name] = measure.factor, power
            continue
        for base, _ in measure.exponents:
            if base in COHERENT:
                bases.setdefault(base, {})[COHERENT[base]] = named(COHERENT[base]).factor or 0.0, Fraction(1)
    return {base: units for base, units in bases.items() if base in BASE}


def _made(
    bases: Mapping[str, Mapping[str, tuple[float, Fraction]]], dimension: Dimension
) -> Iterator[tuple[float, str]]:
    """Yield (logarithm of the scale factor, text) of each unit with this dimension that is made of base units.

    An example of a text is "cm/s**2". `bases` are the base units, as `_base_units` returns them.
    """
    for choice in product(*(bases[base].items() for base, _ in dimension.exponents)):
        pairs = zip(choice, dimension.exponents, strict=True)
        powers = [(text, factor, power / of_unit) for (text, (factor, of_unit)), (_, power) in pairs]
        scale = math.fsum(factor * float(power) for _, factor, power in powers)
        above = [power_text(text, power) for text, _, power in powers if power > 0]
        below = [f"/{power_text(text, -power)}" for text, _, power in powers if power < 0]
        yield scale, ("*".join(above) or "1") + "".join(below)
