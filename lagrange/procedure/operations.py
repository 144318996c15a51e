"""The operations of procedures, with the kinds of their operands and results."""

from __future__ import annotations

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.statement.vocabulary.elementary import ELEMENTARY

Signature = tuple[tuple[Kind, ...], Kind]


def _functions(names: str, *signatures: Signature) -> dict[str, tuple[Signature, ...]]:
    return dict.fromkeys(names.split(), signatures)


_UNARY: Signature = ((REAL,), REAL)
_BINARY: Signature = ((REAL, REAL), REAL)
_WHOLES: Signature = ((WHOLE, WHOLE), WHOLE)
_COMPARED: tuple[Signature, Signature] = ((REAL, REAL), FLAG), ((WHOLE, WHOLE), FLAG)

ANGLES = ("sin", "cos")
"""The operations that are computed as a pair, in the order of the results."""

OPERATIONS: dict[str, tuple[Signature, ...]] = {
    **_functions("add sub mul min max", _BINARY, _WHOLES),
    **_functions("div power atan2 copysign magnitude", _BINARY),
    **_functions("neg", _UNARY, ((WHOLE,), WHOLE)),
    **_functions("quotient", _WHOLES),
    **_functions(" ".join(("abs sqrt sign round", *ELEMENTARY)), _UNARY),
    **_functions("fma fnma", ((REAL, REAL, REAL), REAL)),
    **_functions("less less_equal equal", *_COMPARED),
    **_functions("and or", ((FLAG, FLAG), FLAG)),
    **_functions("not", ((FLAG,), FLAG)),
    **_functions("select", *(((FLAG, kind, kind), kind) for kind in Kind)),
    **_functions("real", ((WHOLE,), REAL), ((FLAG,), REAL)),
    **_functions("whole", ((REAL,), WHOLE), ((FLAG,), WHOLE)),
    **_functions("two_to", ((WHOLE,), REAL)),
    **_functions("exponent", ((REAL,), WHOLE)),
    **_functions("mantissa", ((REAL,), REAL)),
}
"""Every operation with the kinds of its operands and results.

Comparisons with NaN are false. `min`, `max` and `magnitude` of NaN are NaN; `magnitude`, the larger of |a| and |b|,
costs processors less than `max`. `fma` is a*b + c rounded once, `fnma` c - a*b. `round` gives the nearest integer, ties
to even. `quotient` rounds towards zero, and so does `whole` of a real in the range of wholes. A normal |x| is
mantissa * 2**exponent with 1 <= mantissa < 2. The exponent of infinity and NaN is 1024, that of zero and subnormal
numbers -1023. `two_to` k is 2**k for a normal result.
"""


ENTRYWISE = frozenset(OPERATIONS) - frozenset(ELEMENTARY) - {"atan2", "power"}
"""Operations on vectors: all that processors compute without a library."""

_RESULTS = {(op, taken): result for op, signatures in OPERATIONS.items() for taken, result in signatures}


def result_kind(op: str, kinds: tuple[Kind, ...]) -> Kind | None:
    """Return the kind of an operation's result for operand kinds, or None if they do not fit."""
    return _RESULTS.get((op, kinds))
