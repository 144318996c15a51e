"""Values of all kinds that a user may pass by mistake, and some valid ones."""

import itertools
from collections import deque
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy

import lagrange as lg
from tests.refusals import nested

X = lg.coordinate("x")
U = sympy.Symbol("u")


class Hostile:
    """An object whose repr raises an error."""

    def __repr__(self) -> str:
        raise ValueError("no repr")


def itself() -> list[Any]:
    """Return a list that contains itself."""
    made: list[Any] = [1.0]
    made.append(made)
    return made


NUMBERS: list[Any] = [
    *(5e-324, sympy.Float("1e-400"), 0, 1, -1, 2, 7, 3.5, 0.25, -0.0, 1e-300, 1e300, -1e-9, 10**400, -(10**5000)),
    *(2**63, float("nan"), float("inf"), -float("inf"), 1j, complex("nan"), True, False, Fraction(1, 3)),
    *(Fraction(10**400, 7), Decimal("0.1"), Decimal("nan"), np.float16(1.5), np.float32("nan")),
    *(np.longdouble("1e4000"), np.int8(3), np.uint64(2**64 - 1), np.bool_(1), np.complex64(1)),
    *(np.timedelta64(1, "s"), np.datetime64("2020-01-01"), np.array(2.0), np.array(1, bool), sympy.Integer(2)),
    *(sympy.Rational(1, 3), sympy.Float("1e400"), sympy.nan, sympy.oo, sympy.zoo, sympy.I, sympy.pi, sympy.true),
    np.ma.masked,
]

TEXTS: list[Any] = [
    *("", "x", "x y", "1.0", "nan", "taylor", "rk4", "a" * 100_000, "\0", "../x", b"x", bytearray(b"1")),
    np.str_("x"),
]

EXPRESSIONS: list[Any] = [
    *(nested(X, 250), X ** (10**30), X ** sympy.Rational(10**50, 3), X, X.dot, X.ddot, U, X**2 + U, lg.t),
    *(sympy.Eq(X, 1), X > 0, sympy.Eq(X, sympy.true), sympy.Function("f")(X, U), sympy.Derivative(sympy.sin(X), X)),
    *(sympy.Integral(U, U), sympy.Symbol("q", commutative=False), sympy.MatrixSymbol("A", 2, 2), sympy.Symbol("a b")),
    *(sympy.Piecewise((X, X > 0), (0, True)), sympy.Interval(0, 1), sympy.Poly(U**2, U), sympy.gamma(X)),
    *(sympy.Tuple(X, U), sympy.Lambda(U, U), sympy.sin, sympy.Symbol),
]

MATRICES: list[Any] = [
    *(sympy.Matrix([[1, 2], [3, 4]]), sympy.Matrix([X, U]), sympy.Matrix(0, 0, []), sympy.ImmutableMatrix([[X]])),
    *(sympy.Array([[1, 2], [3, 4]]), sympy.Array([1, 2, 3, 4]), sympy.SparseMatrix(3, 3, {(0, 0): X}), sympy.eye(2)),
]

ARRAYS: list[Any] = [
    *(np.zeros(0), np.zeros((0, 3)), np.zeros(4), np.ones((4, 3)), np.zeros((2, 2, 2)), np.arange(4)),
    *(np.full(4, np.nan), np.array([True, False, True, False]), np.array(["a", "b"]), np.array([b"a"])),
    *(np.array([1j, 2]), np.array([None, 1.0], object), np.array([X, U], object)),
    *(np.ma.array([1.0, 2.0, 3.0, 4.0], mask=[False, True, False, False]), np.array([1, 2], "M8[s]")),
    *(np.array([1, 2], "m8[s]"), np.zeros(2, dtype=[("a", float)]), np.array([np.inf, 1.0]), np.zeros(4, np.float16)),
    *(np.array([1.0, 2.0], ">f8"), np.matrix([[1.0, 2.0]]), np.array(X, object), np.broadcast_to(0.05, 10**9)),
    *(np.broadcast_to(0.5, (4, 10**9)), range(10**9), np.ones(4, np.longdouble)),
]

CONTAINERS: list[Any] = [
    *([], (), {}, set(), frozenset(), [None], [[]], [[1.0, 2.0], [3.0]], [1.0, True], [1.0, 2.0, 3.0, 4.0]),
    *([0.0, 0.1], (0.0, 0.1), (0.1,), [X, U], [[X, U], [U, X]], ["x", "y"], ("a", 1.0), [b"x"], {"x": 1.0}, {X: 1.0}),
    *({"m": "1"}, {"m": None}, {X: X > 0}, {1: 2}, {None: None}, {(): []}, {"x": [1.0]}, {10**5000: 1.0}),
    *({float("nan"): 1.0}, {"k": -1.0}, {"bob": (X, X)}, {"bob": "ab"}, {1, 2}, deque([1.0]), [10**400]),
    *([np.nan, 1.0], [object()], [Hostile()], [1.0, np.ma.masked], [("origin", "bob")], [Fraction(1, 2), 1]),
    [range(10**9)],
]

OBJECTS: list[Any] = [
    *(None, ..., NotImplemented, object(), object, int, Hostile(), Hostile, len, print, lambda: 1, lambda *a: a[0]),
    *(lambda f, t, y, h: y, SimpleNamespace(integrate=lambda p: None), SimpleNamespace(integrate=1, claims=2)),
    *(SimpleNamespace(name="own", claims=lg.Claims(order=1), integrate=lambda problem: 3), Path("x"), Path("/")),
    *(slice(1, 2), Exception("x"), SimpleNamespace(compile=lambda: 3), lg.Status.SUCCESS, lg.System, lg.methods.RK4),
    *(lg.methods.RK4(), lg.methods.Taylor(), memoryview(b"ab"), type("Empty", (), {})),
]

MADE: list[Callable[[], Any]] = [
    *(itself, lambda: iter([1.0, 2.0]), lambda: (x for x in (X, U)), lambda: (x for x in "ab"), itertools.count),
    *(lambda: itertools.repeat(X), lambda: map(str, range(3)), lambda: zip([1], [2], strict=True)),
    lambda: [*range(20_000)],
]

KINDS: list[list[Any]] = [NUMBERS, TEXTS, EXPRESSIONS, MATRICES, ARRAYS, CONTAINERS, OBJECTS]
