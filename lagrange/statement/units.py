"""Units of mechanics that SymPy has no name for, as products of others, and spellings of texts that name units."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

PREFIXES = {"T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}
"""Powers of ten of the prefixes of units."""

PREFIXED = ("m", "s", "g", "N", "J", "W", "Pa", "Hz", "rad", "A", "C", "V", "F", "H", "T", "ohm", "bar", "eV")
"""Units that take prefixes."""

BESIDE_NEWTON = {"m": "m", "cm": "cm", "mm": "mm", "s": "s", "ms": "m*s"}
"""What is written behind N without a sign: Nm is a torque, Ns a momentum and Nms an angular momentum."""

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
    "kgf": "9.80665*N",
    "kp": "9.80665*N",
    "lb": "pound",
    "lbf": "4.4482216152605*N",
    "slug": "14.593902937206365*kg",
    "hp": "745.6998715822702*W",
}
"""Other units. The customary ones of the United States and the electronvolt are defined by these numbers."""

FUNCTIONS_TOO = ("min", "sec")
"""Names of units that name functions in expressions, too."""

SIGNS = {"µ": "u", "μ": "u", "·": "*", "⋅": "*", "²": "**2", "³": "**3", "\u2126": "ohm", "\u03a9": "ohm"}
"""Signs in texts of units, and what stands for them."""


def plain_text(text: str) -> str:
    """Return the text of a unit as an expression in names: "N·min" becomes "N*minute"."""
    spelled = text.strip()
    for sign, plain in SIGNS.items():
        spelled = spelled.replace(sign, plain)
    return re.sub(rf"\b({'|'.join(FUNCTIONS_TOO)})\b(?!\s*\()", lambda found: OTHERS[found.group(1)], spelled)


def _prefixed() -> Iterator[tuple[str, str]]:
    for unit in PREFIXED:
        for prefix, power in PREFIXES.items():
            yield f"{prefix}{unit}", f"{10**power}*{unit}" if power > 0 else f"{unit}/{10**-power}"
    for newton in ("N", *(f"{prefix}N" for prefix in PREFIXES)):
        for beside, factor in BESIDE_NEWTON.items():
            yield f"{newton}{beside}", f"{newton}*{factor}"


UNITS: Mapping[str, str] = dict(_prefixed()) | OTHERS
"""Texts of the units that SymPy has no name for. Where it has one, as for mm, that is meant."""
