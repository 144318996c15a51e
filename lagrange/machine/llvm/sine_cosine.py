"""Sine and cosine in LLVM IR, both at once, written out for one number or a vector.

The C library's sine takes about as long as the rest of a small right-hand side, and its vector version (libmvec) has
errors of up to 4 units in the last place. This code has errors of up to 1.1 units, gives each lane of a vector the same
bits as a number alone, and overlaps with the arithmetic around it. Beyond |x| = 2**20, and for NaN and infinity, it
calls the C library.

With n the integer nearest to x / (pi/2), r = x - n pi/2 is computed to twice the precision from pi/2 in three parts of
53, 33 and 53 bits. The first multiply-add is exact, since n < 2**20 times the first part is a multiple of 2**-52, as x
is. The second is exact for small r. Otherwise its rounding error is kept separately, together with the third part.
Polynomials on [-pi/4, pi/4] and the quadrant give the result. Source of the polynomials: FreeBSD msun k_sin.c and
k_cos.c (Sun Microsystems, 1993).
"""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.operations import give, separated, splat, together, type_of
from lagrange.procedure.form import FLAG, REAL, WHOLE

RANGE = 2.0**20
TWO_OVER_PI = 0.6366197723675814
HALF_PI = 1.5707963267948966
HALF_PI_SECOND = 6.12323399538461e-17
HALF_PI_THIRD = 3.5215598651832e-27
ROUNDER = 1.5 * 2.0**52
"""Number that rounds x to an integer when it is added to x: the integer is then in the low bits of the sum."""

SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def sine_and_cosine(e: Emitter, x: str, lanes: int) -> tuple[str, str]:
    """Emit the computation of sin(x) and cos(x), without a call, and return both operands.

    The operand `x` is a number, or a vector of `lanes` numbers.
    """
    kind = type_of(REAL, lanes)
    near = e.value(f"fcmp olt {kind} {e.fabs(x, kind)}, {splat(e, literal(RANGE), REAL, lanes)}")
    every = near
    if lanes > 1:
        bits = e.value(f"bitcast {type_of(FLAG, lanes)} {near} to i{lanes}")
        every = e.value(f"icmp eq i{lanes} {bits}, -1")
    name = e.fresh("angle")
    pair = _near(e, x, lanes)
    before = e.block
    e.do(f"br i1 {every}, label %{name}.join, label %{name}.far, !prof !0")
    e.label(f"{name}.far")
    # Lanes with |x| < RANGE keep the values computed above. So their bits do not depend on the other lanes.
    far = [
        e.value(f"select {type_of(FLAG, lanes)} {near}, {kind} {near_value}, {kind} {far_value}")
        for near_value, far_value in zip(pair, _by_library(e, x, lanes), strict=True)
    ]
    e.jump(f"{name}.join")
    e.label(f"{name}.join")
    sine, cosine = (
        e.value(f"phi {kind} [ {near_value}, %{before} ], [ {far_value}, %{name}.far ]")
        for near_value, far_value in zip(pair, far, strict=True)
    )
    return sine, cosine


def angle_function(lanes: int) -> str:
    """Return the IR of a function that computes both sine and cosine of `lanes` angles, passed as a vector."""
    e, kind = Emitter(), type_of(REAL, lanes)
    give(e, (kind, kind), sine_and_cosine(e, "%x", lanes))
    return e.function(f"define internal {together((kind, kind))} @{angle_name(lanes)}({kind} %x) #0")


def angle_name(lanes: int) -> str:
    """Return the name of the function that `angle_function(lanes)` defines."""
    return "sine_and_cosine" if lanes == 1 else f"sine_and_cosine_{lanes}"


def call_sine_and_cosine(e: Emitter, x: str, lanes: int) -> tuple[str, str]:
    """Emit a call of the module's function for sine and cosine, and return the operands of sin(x) and cos(x).

    The operand `x` is a number, or a vector of `lanes` numbers. The function computes the same as the operations that
    `sine_and_cosine` emits. Calls keep modules with many angles short.
    """
    kind = type_of(REAL, lanes)
    both = e.value(f"call {together((kind, kind))} @{angle_name(lanes)}({kind} {x})")
    sine, cosine = separated(e, (kind, kind), both)
    return sine, cosine


def _near(e: Emitter, x: str, lanes: int) -> tuple[str, str]:
    kind = type_of(REAL, lanes)
    integers = type_of(WHOLE, lanes)

    def constant(value: float) -> str:
        return splat(e, literal(value), REAL, lanes)

    def binary(operation: str, a: str, b: str) -> str:
        return e.value(f"{operation} {kind} {a}, {b}")

    def negative(a: str) -> str:
        return e.value(f"fneg {kind} {a}")

    rounded = e.fma(x, constant(TWO_OVER_PI), constant(ROUNDER), kind)
    n = binary("fsub", rounded, constant(ROUNDER))
    first = e.fma(negative(n), constant(HALF_PI), x, kind)
    r = e.fma(negative(n), constant(HALF_PI_SECOND), first, kind)
    # The rounding error is kept with reversed sign: subtracting it preserves the sign of sin(-0).
    lost = e.fma(n, constant(HALF_PI_SECOND), binary("fsub", r, first), kind)
    lost = e.fma(n, constant(HALF_PI_THIRD), lost, kind)
    z = binary("fmul", r, r)
    z2 = binary("fmul", z, z)
    s = [constant(c) for c in SINE]
    c = [constant(c) for c in COSINE]
    # sin(r - lost) = r - (lost - z r P). It omits z/2 of `lost`, an eighth of a unit in the last place.
    upper = e.fma(z2, s[5], e.fma(z, s[4], s[3], kind), kind)
    poly = e.fma(z2, upper, e.fma(z, s[2], s[1], kind), kind)
    poly = e.fma(z, poly, s[0], kind)
    cube = binary("fmul", z, r)
    sine = binary("fsub", r, e.fma(negative(cube), poly, lost, kind))
    # cos(r - lost) = 1 + (z (z Q - 1/2) + r lost)
    upper = e.fma(z2, c[5], e.fma(z, c[4], c[3], kind), kind)
    poly = e.fma(z2, upper, e.fma(z, c[2], c[1], kind), kind)
    poly = e.fma(z, e.fma(z, poly, c[0], kind), constant(-0.5), kind)
    cosine = binary("fadd", constant(1.0), e.fma(z, poly, binary("fmul", r, lost), kind))
    return _turn(e, rounded, sine, cosine, kind, integers, lanes)


def _turn(e: Emitter, rounded: str, sine: str, cosine: str, kind: str, integers: str, lanes: int) -> tuple[str, str]:
    """Emit the sine and cosine of an angle x from those of the remainder x - n pi/2, and return both operands.

    `sine` and `cosine` are those of the remainder. The integer n is in the low bits of `rounded`. Sine and cosine are
    exchanged for odd n, and n gives their signs. The operands are vectors with `lanes` numbers, or numbers. `kind` is
    their LLVM type, and `integers` that of vectors with as many integers.
    """

    def whole(value: int) -> str:
        return splat(e, str(value), WHOLE, lanes)

    def signed(value: str, quadrant: str) -> str:
        sign = e.value(f"and {integers} {e.value(f'shl {integers} {quadrant}, {whole(62)}')}, {whole(-(2**63))}")
        bits = e.value(f"bitcast {kind} {value} to {integers}")
        return e.value(f"bitcast {integers} {e.value(f'xor {integers} {bits}, {sign}')} to {kind}")

    quadrant = e.value(f"bitcast {kind} {rounded} to {integers}")
    odd = e.value(f"icmp ne {integers} {e.value(f'and {integers} {quadrant}, {whole(1)}')}, {whole(0)}")
    swapped = [
        e.value(f"select {type_of(FLAG, lanes)} {odd}, {kind} {a}, {kind} {b}")
        for a, b in ((cosine, sine), (sine, cosine))
    ]
    following = e.value(f"add {integers} {quadrant}, {whole(1)}")
    return signed(swapped[0], quadrant), signed(swapped[1], following)


def _by_library(e: Emitter, x: str, lanes: int) -> tuple[str, str]:
    """Emit calls of the C library's `sincos` for the `lanes` numbers in `x`, and return both operands."""
    pair = [e.reserve("double"), e.reserve("double")]
    if lanes == 1:
        e.do(f"call void @sincos(double {x}, ptr {pair[0]}, ptr {pair[1]})")
        return e.load(pair[0]), e.load(pair[1])
    kind = type_of(REAL, lanes)
    sine = cosine = "poison"
    for lane in range(lanes):
        angle = e.value(f"extractelement {kind} {x}, i64 {lane}")
        e.do(f"call void @sincos(double {angle}, ptr {pair[0]}, ptr {pair[1]})")
        sine = e.value(f"insertelement {kind} {sine}, double {e.load(pair[0])}, i64 {lane}")
        cosine = e.value(f"insertelement {kind} {cosine}, double {e.load(pair[1])}, i64 {lane}")
    return sine, cosine
