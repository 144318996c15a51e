"""Operations of procedures in LLVM IR, on numbers and vectors, and calls of the C library and its vector routines."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Iterator, Sequence
from functools import cache

import llvmlite.binding as llvm

from lagrange.machine.llvm import processor
from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.procedure import form
from lagrange.procedure.form import FLAG, OPERATIONS, REAL, WHOLE, WIDTHS, Kind, Type, Vector
from lagrange.program.program import ARITY
from lagrange.statement.vocabulary.functions import ELEMENTARY

KINDS = {REAL: "double", WHOLE: "i64", FLAG: "i1"}
"""LLVM's type for each kind of value of a procedure: real, whole number, flag."""

_REALS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
INTRINSICS = {
    "fma": "fma",
    "min": "minimum",
    "max": "maximum",
    "sqrt": "sqrt",
    "abs": "fabs",
    "copysign": "copysign",
    "round": "rint",
}
_WHOLES = {"add": "add nsw", "sub": "sub nsw", "mul": "mul nsw", "quotient": "sdiv"}
_WHOLE_INTRINSICS = {"min": "smin", "max": "smax"}
_COMPARED = {"less": ("olt", "slt"), "less_equal": ("ole", "sle"), "equal": ("oeq", "eq")}
LIBRARY = {**{name: name for name in ELEMENTARY}, "atan2": "atan2", "power": "pow"}
"""Name of the C library's function for each operation that needs one. For some there are also vector routines."""

_CONVERTED = {("real", WHOLE): "sitofp", ("real", FLAG): "uitofp", ("whole", REAL): "fptosi", ("whole", FLAG): "zext"}


def type_of(kind: Kind, lanes: int = 1) -> str:
    """Return LLVM's type of a real, a whole number or a flag (`kind`), or of a vector of `lanes` such values."""
    return KINDS[kind] if lanes == 1 else f"<{lanes} x {KINDS[kind]}>"


def declarations() -> str:
    """Return the IR declarations of all external functions (LLVM's intrinsics, C library) that procedures call."""
    lines = []
    for lanes in WIDTHS:
        kind = type_of(REAL, lanes)
        if lanes > 1:
            mask = f"<{lanes} x i1>"
            for vector in (kind, type_of(WHOLE, lanes)):
                name = suffix(vector)
                lines.append(f"declare void @llvm.masked.store.{name}.p0({vector}, ptr, i32, {mask})")
                at = f"{name}.v{lanes}p0", f"<{lanes} x ptr>"
                lines.append(f"declare {vector} @llvm.masked.gather.{at[0]}({at[1]}, i32, {mask}, {vector})")
                lines.append(f"declare void @llvm.masked.scatter.{at[0]}({vector}, {at[1]}, i32, {mask})")
        for op, name in INTRINSICS.items():
            lines.append(declaration(f"llvm.{name}.{suffix(kind)}", op, lanes))
    for lanes in WIDTHS:
        vector = type_of(WHOLE, lanes)
        for name in (*_WHOLE_INTRINSICS.values(), "umax"):
            lines.append(f"declare {vector} @llvm.{name}.{suffix(type_of(WHOLE, lanes))}({vector}, {vector})")
        if lanes > 1:
            lines.append(f"declare i64 @llvm.vector.reduce.umax.v{lanes}i64({vector})")
    lines += [declaration(name, op) for op, name in LIBRARY.items()]
    lines += ["declare void @sincos(double, ptr, ptr)", "declare ptr @malloc(i64)", "declare void @free(ptr)"]
    return "\n".join(lines)


def declaration(name: str, op: str, lanes: int = 1) -> str:
    """Return the IR declaration of the external function `name`, which computes the operation `op`.

    Its arguments and results are vectors of `lanes` reals, or single reals if `lanes` is 1.
    """
    kind = type_of(REAL, lanes)
    return f"declare {kind} @{name}({', '.join([kind] * len(OPERATIONS[op][0][0]))})"


def constant(let: form.Let) -> str:
    """Return the IR operand of the constant that the statement `let` defines."""
    if let.kind is REAL:
        return literal(0.0 if let.data is None else float(let.data))
    return str(bool(let.data)).lower() if let.kind is FLAG else str(int(let.data or 0))


def splat(e: Emitter, value: str, kind: Kind, lanes: int) -> str:
    """Emit a vector of `lanes` entries that are all `value`, and return its operand; for 1 lane, return `value`."""
    if lanes == 1:
        return value
    if not value.startswith("%"):
        return "<" + ", ".join([f"{KINDS[kind]} {value}"] * lanes) + ">"
    vector = type_of(kind, lanes)
    inserted = e.value(f"insertelement {vector} poison, {KINDS[kind]} {value}, i64 0")
    return e.value(f"shufflevector {vector} {inserted}, {vector} poison, <{lanes} x i32> zeroinitializer")


def spell(e: Emitter, op: str, kinds: Sequence[Kind], args: Sequence[str], lanes: int = 1) -> str:
    """Emit the operation `op` as LLVM IR, and return the operand of its result.

    `args` are its operands, and `kinds` their kinds (real, whole number or flag). If `lanes` is above 1, the operands
    are vectors with `lanes` entries.
    """
    types = [type_of(kind, lanes) for kind in kinds]
    kind = types[-1]
    typed = ", ".join(f"{operand_type} {arg}" for operand_type, arg in zip(types, args, strict=True))
    real = kinds[-1] is REAL
    if op in ("and", "or"):
        return e.value(f"{op} {kind} {args[0]}, {args[1]}")
    if op == "not":
        return e.value(f"xor {typed}, {splat(e, 'true', FLAG, lanes)}")
    if op == "select":
        return e.value(f"select {typed}")
    if op == "neg":
        return e.value(f"fneg {typed}" if real else f"sub nsw {kind} {splat(e, '0', WHOLE, lanes)}, {args[0]}")
    if op in _COMPARED:
        return e.value(f"{'fcmp' if real else 'icmp'} {_COMPARED[op][not real]} {kind} {args[0]}, {args[1]}")
    if real and op in _REALS:
        return e.value(f"{_REALS[op]} {kind} {args[0]}, {args[1]}")
    if real and op in INTRINSICS:
        return e.value(f"call {kind} @llvm.{INTRINSICS[op]}.{suffix(kind)}({typed})")
    if op == "fnma":
        minus = e.value(f"fneg {kind} {args[0]}")
        return e.fma(minus, args[1], args[2], kind)
    if op == "magnitude":
        return _magnitude(e, args, lanes)
    if op == "sign":
        return _sign(e, typed, lanes)
    if op in _WHOLES:
        return e.value(f"{_WHOLES[op]} {kind} {args[0]}, {args[1]}")
    if op in _WHOLE_INTRINSICS:
        return e.value(f"call {kind} @llvm.{_WHOLE_INTRINSICS[op]}.{suffix(type_of(WHOLE, lanes))}({typed})")
    if (op, kinds[0]) in _CONVERTED:
        return e.value(f"{_CONVERTED[op, kinds[0]]} {typed} to {type_of(REAL if op == 'real' else WHOLE, lanes)}")
    if op in _BITS:
        return _BITS[op](e, args[0], lanes)
    if lanes > 1:
        raise NotImplementedError(f"{op} has no form for several numbers at once")
    return e.value(f"call double @{LIBRARY[op]}({', '.join(f'double {arg}' for arg in args)})")


def _sign(e: Emitter, typed: str, lanes: int) -> str:
    """Emit the sign of x, and return its operand: the sign is 1 or -1, or x itself if x is zero or NaN.

    `typed` is the LLVM type of x, then its operand. x is a number, or a vector of `lanes` numbers.
    """
    real, flag = type_of(REAL, lanes), type_of(FLAG, lanes)
    zero, one, minus = (splat(e, literal(value), REAL, lanes) for value in (0.0, 1.0, -1.0))
    above, below = (e.value(f"fcmp {how} {typed}, {zero}") for how in ("ogt", "olt"))
    negative = e.value(f"select {flag} {below}, {real} {minus}, {typed}")
    return e.value(f"select {flag} {above}, {real} {one}, {real} {negative}")


def _magnitude(e: Emitter, args: Sequence[str], lanes: int) -> str:
    """Emit the larger of two absolute values, NaN if one is NaN, and return its operand.

    The bits are compared as integers, which is faster than to compare doubles that may be NaN. For doubles that are not
    negative the order is the same, with NaN last.
    """
    kind, bits = type_of(REAL, lanes), type_of(WHOLE, lanes)
    first, second = (e.value(f"bitcast {kind} {e.fabs(arg, kind)} to {bits}") for arg in args)
    larger = e.value(f"call {bits} @llvm.umax.{suffix(type_of(WHOLE, lanes))}({bits} {first}, {bits} {second})")
    return e.value(f"bitcast {bits} {larger} to {kind}")


def largest_magnitude(e: Emitter, vector: str, lanes: int) -> str:
    """Emit the largest entry of a vector, and return its operand.

    The vector has `lanes` numbers that are not negative. NaN counts as the largest.
    """
    bits = e.value(f"bitcast {type_of(REAL, lanes)} {vector} to {type_of(WHOLE, lanes)}")
    largest = e.value(f"call i64 @llvm.vector.reduce.umax.v{lanes}i64({type_of(WHOLE, lanes)} {bits})")
    return e.value(f"bitcast i64 {largest} to double")


def _two_to(e: Emitter, k: str, lanes: int) -> str:
    whole, bias = type_of(WHOLE, lanes), splat(e, "1023", WHOLE, lanes)
    shifted = e.value(f"shl {whole} {e.value(f'add {whole} {k}, {bias}')}, {splat(e, '52', WHOLE, lanes)}")
    return e.value(f"bitcast {whole} {shifted} to {type_of(REAL, lanes)}")


def _exponent(e: Emitter, x: str, lanes: int) -> str:
    whole = type_of(WHOLE, lanes)
    shift, low, bias = (splat(e, value, WHOLE, lanes) for value in ("52", "2047", "1023"))
    bits = e.value(f"bitcast {type_of(REAL, lanes)} {x} to {whole}")
    biased = e.value(f"and {whole} {e.value(f'lshr {whole} {bits}, {shift}')}, {low}")
    return e.value(f"sub {whole} {biased}, {bias}")


def _mantissa(e: Emitter, x: str, lanes: int) -> str:
    real, whole = type_of(REAL, lanes), type_of(WHOLE, lanes)
    low, one = (splat(e, str(value), WHOLE, lanes) for value in (2**52 - 1, 1023 << 52))
    bits = e.value(f"bitcast {real} {x} to {whole}")
    mantissa = e.value(f"or {whole} {e.value(f'and {whole} {bits}, {low}')}, {one}")
    return e.value(f"bitcast {whole} {mantissa} to {real}")


_BITS = {"two_to": _two_to, "exponent": _exponent, "mantissa": _mantissa}


def result_type(results: Sequence[Type]) -> str:
    """Return LLVM's return type of a function with results of these types: void, one type or a structure."""
    return together([argument_type(kind) for kind in results])


def foreign_type(kind: Type) -> str:
    """Return LLVM's type of a result of a function that other code, such as C, calls: a flag is C's int there."""
    return "i32" if kind is FLAG else argument_type(kind)


def convention(results: Sequence[Type]) -> str:
    """Return LLVM's keyword for the calling convention of a callback, or of a function that other code calls.

    `results` are the types of its results. The keyword is "swiftcc " for several results, which are then
    returned in registers, and "" (C's convention) for one result or none.
    """
    return "swiftcc " if len(results) > 1 else ""


def together(types: Sequence[str]) -> str:
    """Return the LLVM type in which a function returns results of several `types`: a structure.

    For one result it is the type of the result, and for none it is void.
    """
    return types[0] if len(types) == 1 else "{" + ", ".join(types) + "}" if types else "void"


def separated(e: Emitter, types: Sequence[str], value: str) -> Iterator[str]:
    """Emit the extraction of all results from `value`, of the type `together(types)`, and yield their operands."""
    for i in range(len(types)):
        yield value if len(types) == 1 else e.value(f"extractvalue {together(types)} {value}, {i}")


def give(e: Emitter, types: Sequence[str], values: Sequence[str]) -> None:
    """Emit the return of the operands `values`, of the LLVM `types`, as one value of the type `together(types)`."""
    kind = together(types)
    if len(types) < 2:
        e.do(f"ret {kind} {values[0]}" if types else "ret void")
        return
    made = "poison"
    for i, (kind_of_value, value) in enumerate(zip(types, values, strict=True)):
        made = e.value(f"insertvalue {kind} {made}, {kind_of_value} {value}, {i}")
    e.do(f"ret {kind} {made}")


def phi(e: Emitter, kind: str, ways: Sequence[tuple[str, str]]) -> str:
    """Emit a phi, which takes the value that belongs to the block from which control came, and return its operand.

    `kind` is the LLVM type. `ways` are pairs (preceding block, operand). If all operands are equal, no phi is needed.
    """
    if all(value == ways[0][1] for _, value in ways):
        return ways[0][1]
    return e.value(f"phi {kind} {', '.join(f'[ {value}, %{block} ]' for block, value in ways)}")


def argument_type(kind: Type) -> str:
    """Return LLVM's type of an argument: the type of a number or vector, or a pointer for an array or record."""
    if isinstance(kind, Vector):
        return type_of(*kind)
    return KINDS[kind] if isinstance(kind, Kind) else "ptr"


ROUTINES = "_ZGV"
"""Prefix of the names of vector routines in glibc (libmvec)."""


@cache
def vector_routines() -> dict[str, str]:
    """Return {operation: name of its vector routine in glibc (libmvec)} for the vector width of this processor.

    The result is empty if the library is missing.
    """
    processor.start()
    try:
        routines = ctypes.CDLL("libmvec.so.1")
    except OSError:
        return {}
    llvm.load_library_permanently("libmvec.so.1")
    prefix = ROUTINES + {8: "eN8", 4: "dN4", 2: "bN2"}[processor.lanes()]
    names = {op: f"{prefix}{'v' * (ARITY[op] or 0)}_{LIBRARY[op]}" for op in sorted(LIBRARY)}
    return {op: name for op, name in names.items() if hasattr(routines, name)}


def call_library(e: Emitter, op: str, args: Sequence[str], width: int) -> str:
    """Emit the operation `op` on vectors of `width` numbers by calls of the C library; return the result's operand.

    `args` are the operands. The vector routine for the operation is called if there is one. Otherwise the scalar
    function is called for each entry.
    """
    kind = type_of(REAL, width)
    name = vector_routines().get(op) if width == processor.lanes() else None
    if name is not None:
        return e.value(f"call {kind} @{name}({', '.join(f'{kind} {arg}' for arg in args)})")
    made = "poison"
    for k in range(width):
        entries = [e.value(f"extractelement {kind} {arg}, i64 {k}") for arg in args]
        value = e.value(f"call double @{LIBRARY[op]}({', '.join(f'double {entry}' for entry in entries)})")
        made = e.value(f"insertelement {kind} {made}, double {value}, i64 {k}")
    return made


def routines_called(texts: Sequence[str]) -> list[str]:
    """Return the declarations of the vector routines that the given IR texts call."""
    if not any(f"@{ROUTINES}" in text for text in texts):
        return []
    names = vector_routines().items()
    return [
        declaration(name, op, processor.lanes()) for op, name in names if any(f"@{name}(" in text for text in texts)
    ]
