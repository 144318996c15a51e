"""Numbers beside the marks of an axis: each whole in itself, without a power or an offset that stands elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.ticker import Formatter

_LARGEST, _SMALLEST = 5, -4
"""Powers of ten from which on, and up to which, numbers are written with their power."""

_MOST_DIGITS = 15
"""Digits behind the point: more than a double has."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number_labels(values: Sequence[float]) -> list[str]:
    """Return numbers as text, with as many digits as tell neighbours apart: -0.5, 0.0, 0.5 or −2·10⁻⁹, 0, 2·10⁻⁹."""
    finite = sorted({float(value) for value in values if isfinite(value)})
    size = max(map(abs, finite), default=0.0)
    if size == 0.0:
        return ["0" if isfinite(value) else "" for value in values]
    gaps = [b - a for a, b in pairwise(finite)]
    digits = _digits(min(gaps, default=size))
    power = floor(log10(size) + 1e-9)
    if _SMALLEST < power < _LARGEST:
        return [_decimal(value, digits) for value in values]
    return [_decimal(value / 10.0**power, digits + power) + (_ten(power) if value else "") for value in values]


def ten_to(power: int) -> str:
    """Return a power of ten as text, 10⁻⁹."""
    return "10" + str(power).translate(_RAISED)


def _ten(power: int) -> str:
    return "·" + ten_to(power)


def _digits(gap: float) -> int:
    """Return how many digits behind the point a multiple of a gap has, which is 1, 2, 2.5 or 5 times a power of ten."""
    digits = -floor(log10(gap) + 1e-9)
    return digits + (abs(gap * 10.0**digits - round(gap * 10.0**digits)) > 1e-3)


def _decimal(value: float, digits: int) -> str:
    if not isfinite(value):
        return ""
    if value == 0:
        return "0"
    text = f"{value:.{min(max(digits, 0), _MOST_DIGITS)}f}"
    return text.replace("-", "−")


def number_formatter() -> Formatter:
    """Return what labels the marks of one axis of Matplotlib."""
    return _formatter_class()()


@cache
def _formatter_class() -> type[Formatter]:
    """Return the class, made with the first figure: Matplotlib takes 0.2 s to import."""
    from matplotlib.ticker import Formatter

    class NumberFormatter(Formatter):
        """Labels of the marks of an axis, which are told apart by their digits alone."""

        __qualname__ = "NumberFormatter"  # by which pickle finds it in this module

        def __call__(self, x: float, pos: int | None = None) -> str:
            if pos is None:  # the position of a pointer, which is no mark
                return f"{x:.6g}"
            return self.format_ticks([*self.locs])[pos] if pos < len(self.locs) else ""

        def format_ticks(self, values: Any) -> list[str]:
            self.set_locs(values)
            return number_labels([float(value) for value in values])

    return NumberFormatter


def __getattr__(name: str) -> Any:
    """Return the class to pickle, which looks for it by name (PEP 562)."""
    if name == "NumberFormatter":
        return _formatter_class()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
