"""Driving: does the system depend on time, and with which period."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Any

import sympy

from lagrange.errors import StatementError, listing
from lagrange.mechanics.plain_form import PlainForm
from lagrange.statement.coordinate import t
from lagrange.statement.given import with_values
from lagrange.statement.statement import Statement

MOST_MULTIPLE = 64
"""Frequencies are commensurate if their ratios are fractions of whole numbers up to this."""


def depends_on_time(statement: Statement) -> bool:
    """Return whether the Lagrangian, a force, the dissipation or a constraint contains time."""
    return any(part.has(t) for part in _parts(statement))


def _parts(statement: Statement) -> list[Any]:
    known = with_values(statement)
    form = PlainForm(known)
    return [form.lagrangian, *form.forces, *(form.read(one.expression) for one in known.constraints)]


@lru_cache(maxsize=64)
def _rates(statement: Statement) -> tuple[Any, ...]:
    """Return the frequencies of the sines and cosines of time, as expressions."""
    parts = _parts(statement)
    waves = sorted(
        {
            wave
            for part in parts
            for wave in part.atoms(sympy.sin, sympy.cos)
            if wave.args[0].has(t) and wave.args[0].diff(t, 2) == 0
        },
        key=str,
    )
    silent = {wave: sympy.Dummy() for wave in waves}
    if not waves or any(part.xreplace(silent).has(t) for part in parts):
        raise StatementError(
            f"the period of the driving of {statement.name} is not found: time stands outside of sines and cosines. "
            "Give section=..., the period in the unit of time."
        )
    return tuple(dict.fromkeys(wave.args[0].diff(t) for wave in waves))


def driving_period(statement: Statement, values: Mapping[Any, float]) -> float:
    """Return the period of the driving at values of the parameters, from the sines and cosines of time.

    Raises StatementError where time also occurs elsewhere, or frequencies have no common period.
    """
    known = {symbol: sympy.Float(value, 17) for symbol, value in values.items()}
    rates = sorted({rate for rate in (abs(float(one.xreplace(known))) for one in _rates(statement)) if rate > 0})
    if not rates:
        raise StatementError(
            f"the driving of {statement.name} has the frequency zero: give section=..., the period in the unit of time."
        )
    ratios = [Fraction(rate / rates[0]).limit_denominator(MOST_MULTIPLE) for rate in rates]
    if any(
        abs(float(ratio) - rate / rates[0]) > 1e-9 * rate / rates[0] for ratio, rate in zip(ratios, rates, strict=True)
    ):
        raise StatementError(
            f"the driving of {statement.name} has the frequencies {listing(f'{rate:g}' for rate in rates)}, which have "
            "no common period: give section=..., the period in the unit of time."
        )
    whole = math.lcm(*(ratio.denominator for ratio in ratios))
    step = math.gcd(*(ratio.numerator * (whole // ratio.denominator) for ratio in ratios))
    return 2 * math.pi / (rates[0] * step / whole)
