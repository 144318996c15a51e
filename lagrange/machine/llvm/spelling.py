"""How LLVM spells each operation: the table of the target, complete for every operation of a program."""

from __future__ import annotations

from collections.abc import Callable

from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.program.program import ARITY

LIBRARY = frozenset(
    ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "sinh", "cosh", "tanh", "power")
)
"""Operations that call the C library, or its vector twin for a batch."""

BOOLEAN = frozenset(("less", "less_equal", "equal", "and", "or", "not"))
"""Operations that give true or false."""

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARE = {"less": "olt", "less_equal": "ole", "equal": "oeq"}
_INTRINSIC = {"fma": "fma", "min": "minimum", "max": "maximum", "sqrt": "sqrt", "abs": "fabs"}
_LOGIC = {"and": "and", "or": "or"}


def number(value: float, lanes: int) -> str:
    """Return a constant as an operand of that many lanes."""
    if lanes == 1:
        return literal(value)
    return "<" + ", ".join([f"double {literal(value)}"] * lanes) + ">"


def element(lanes: int) -> str:
    """Return the type of a number."""
    return "double" if lanes == 1 else f"<{lanes} x double>"


def flag_type(lanes: int) -> str:
    """Return the type of a condition."""
    return "i1" if lanes == 1 else f"<{lanes} x i1>"


def c_name(op: str) -> str:
    """Return what the C library calls an operation."""
    return "pow" if op == "power" else op


def intrinsics(lanes: int) -> list[str]:
    """Return the declarations of LLVM's own functions that operations on that many lanes become."""
    kind = element(lanes)
    return [declaration(f"llvm.{name}.{suffix(kind)}", op, lanes) for op, name in _INTRINSIC.items()]


def library_functions() -> list[str]:
    """Return the declarations of the C library's functions."""
    return ["declare void @sincos(double, ptr, ptr)", *(declaration(c_name(op), op, 1) for op in sorted(LIBRARY))]


def declaration(name: str, op: str, lanes: int) -> str:
    """Return the declaration of the function that computes an operation on that many lanes."""
    kind = element(lanes)
    return f"declare {kind} @{name}({', '.join([kind] * (ARITY[op] or 0))})"


def spell(emitter: Emitter, op: str, args: list[str], lanes: int) -> str:
    """Emit one operation that is neither a leaf, nor a library call, nor of a linear system."""
    kind = element(lanes)
    if op in _ARITHMETIC:
        return emitter.value(f"{_ARITHMETIC[op]} {kind} {args[0]}, {args[1]}")
    if op in _INTRINSIC:
        operands = ", ".join(f"{kind} {arg}" for arg in args)
        return emitter.value(f"call {kind} @llvm.{_INTRINSIC[op]}.{suffix(kind)}({operands})")
    if op in _COMPARE:
        return emitter.value(f"fcmp {_COMPARE[op]} {kind} {args[0]}, {args[1]}")
    if op in _LOGIC:
        return emitter.value(f"{_LOGIC[op]} {flag_type(lanes)} {args[0]}, {args[1]}")
    return _OTHERS[op](emitter, args, lanes)


def _neg(emitter: Emitter, args: list[str], lanes: int) -> str:
    return emitter.value(f"fneg {element(lanes)} {args[0]}")


def _not(emitter: Emitter, args: list[str], lanes: int) -> str:
    every = "true" if lanes == 1 else "<" + ", ".join(["i1 true"] * lanes) + ">"
    return emitter.value(f"xor {flag_type(lanes)} {args[0]}, {every}")


def _select(emitter: Emitter, args: list[str], lanes: int) -> str:
    kind = element(lanes)
    return emitter.value(f"select {flag_type(lanes)} {args[0]}, {kind} {args[1]}, {kind} {args[2]}")


def _sign(emitter: Emitter, args: list[str], lanes: int) -> str:
    """Emit a for a zero or NaN, else 1 or -1."""
    kind = element(lanes)
    above = emitter.value(f"fcmp ogt {kind} {args[0]}, {number(0.0, lanes)}")
    below = emitter.value(f"fcmp olt {kind} {args[0]}, {number(0.0, lanes)}")
    negative = _select(emitter, [below, number(-1.0, lanes), args[0]], lanes)
    return _select(emitter, [above, number(1.0, lanes), negative], lanes)


_OTHERS: dict[str, Callable[[Emitter, list[str], int], str]] = {
    "neg": _neg,
    "not": _not,
    "select": _select,
    "sign": _sign,
}

SPELLED = frozenset((*_ARITHMETIC, *_INTRINSIC, *_COMPARE, *_LOGIC, *_OTHERS))
"""Every operation that `spell` knows."""
