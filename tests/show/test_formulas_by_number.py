"""All formulas of all scenes' pages: both sides are evaluated and compared with the compiled model, and read back."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.show.derivation_page import FormulaLine, LineWriter
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.latex_mathml import LatexNotation, MathmlNotation
from lagrange.show.notation.sections import (
    ExpressionRows,
    Formula,
    Partial,
    Product,
    Rate,
    ShownQuantity,
    SignedTerms,
    Transpose,
    sections,
)
from lagrange.show.notation.text import Notation, UnicodeNotation
from lagrange.statement.typed.reader import TypedReader
from tests.models import SCENE_NAMES, shared_scene, stated_in

LONG = (
    *("pleiades", "seven-body-mechanism", "hanging-chain", "spinning-top", "slider-crank", "free-flip"),
    *("sun-earth-moon", "four-bar-ladder", "four-bar-change-point"),
)
SCENES = [
    pytest.param(name, marks=[pytest.mark.slow] * (name in LONG))
    for name in SCENE_NAMES
    if "rotations" not in stated_in(name)
]
"""Equations in rates of rotations are read back by `compare` in tests of typed answers."""
DIGITS = 80
STEP = mpmath.mpf(10) ** -20
"""Central differences, nested once, leave 20 digits or more of what they are taken of."""
AGREEMENT = 1e-7
"""States that are on the constraints to 1e-10, relative, leave this much of the largest term."""


class Motion:
    """A state of a scene that satisfies its constraints, near the initial one, and values of the model there."""

    def __init__(self, system: lg.System, seed: int) -> None:
        self.system, self.statement = system, system.statement
        statement = system.statement
        self.model = system.compile(check=False)
        draw = np.random.default_rng(seed)
        scale = np.array([abs(x) or 1.0 for x in statement.initial])
        y = np.array(statement.initial) + 0.05 * scale * draw.uniform(-1, 1, len(scale))
        self.t, n = 0.3, len(statement.coordinates)
        keys = (*statement.coordinates, *statement.velocities)
        if statement.constraints or statement.name == "two-point-vortices":
            result = system.consistent(dict(zip(keys, y, strict=True)), t=self.t).initial
            y = np.array([result[key] for key in keys])
        self.q, self.v = y[:n], y[n:]
        self.a = self.model.accelerations(self.q, self.v, self.t)
        held = statement.constraints
        self.multipliers = self.model.multipliers(self.q, self.v, self.t) if held else np.zeros(0)
        plain = list(statement.plain.values())
        point = dict(zip(plain, np.column_stack([self.q, self.v, self.a]).ravel(), strict=True))
        point |= {p: statement.defaults[p] for p in statement.parameters}
        point |= {item.multiplier: x for item, x in zip(held, self.multipliers, strict=True)} | {lg.t: self.t}
        self.point = {symbol: mpmath.mpf(float(value)) for symbol, value in point.items()}
        self.functions: dict[Any, Callable[..., Any]] = {}

    def value(self, expression: Any, moved: Any = None) -> Any:
        """Return the value of an expression at the state, in multiple precision."""
        if expression not in self.functions:
            plain = expression.xreplace(self.statement.plain)
            assert plain.free_symbols <= set(self.point), expression
            self.functions[expression] = sympy.lambdify(list(self.point), plain, "mpmath", cse=True)
        with mpmath.workdps(DIGITS):
            return mpmath.mpmathify(self.functions[expression](*(self.point | (moved or {})).values()))

    def number(self, expression: Any) -> float:
        value = self.value(expression)
        assert isinstance(value, mpmath.mpf), expression
        return float(value)

    def slope(self, expression: Any, by: Any, moved: Any = None) -> Any:
        """Return the derivative of a stated expression by central differences."""
        at = {**self.point, **(moved or {})}
        symbol = by.xreplace(self.statement.plain)
        with mpmath.workdps(DIGITS):
            h = STEP * max(abs(at[symbol]), 1)
            ends = [self.value(expression, {**at, symbol: at[symbol] + sign * h}) for sign in (1, -1)]
            return (ends[0] - ends[1]) / (2 * h)

    def rate(self, value: Callable[[Any], Any]) -> float:
        """Return the time derivative along the motion of a function of the state."""
        plain = list(self.statement.plain.values())
        ends = []
        with mpmath.workdps(DIGITS):
            for s in (STEP, -STEP):
                moved = {lg.t: self.point[lg.t] + s}
                for q, v, a in zip(plain[::3], plain[1::3], plain[2::3], strict=True):
                    moved |= {q: self.point[q] + s * self.point[v], v: self.point[v] + s * self.point[a]}
                ends.append(value(moved))
            return float((ends[0] - ends[1]) / (2 * STEP))

    def side(self, side: Any) -> Any:
        match side:
            case ShownQuantity():
                value = self.quantity(side.letter, side.indices)
                return float(np.dot(*[np.asarray(value).ravel()] * 2)) if side.squared else value
            case Partial():
                return float(self.slope(self.stated(side.quantity), side.by))
            case Rate(inside=inside):
                by = inside.by if isinstance(inside, Partial) else self.velocity(inside.indices[0])
                return self.rate(partial(self.slope, self.statement.lagrangian, by))
            case Transpose():
                return np.asarray(self.side(side.matrix)).T
            case Product():
                factors = [np.asarray(self.side(factor)) for factor in side.factors]
                value = factors[0]
                for factor in factors[1:]:
                    value = value @ factor if value.ndim and factor.ndim else value * factor
                return value
            case SignedTerms():
                return sum((-1 if negative else 1) * np.asarray(self.side(term)) for negative, term in side.terms)
            case ExpressionRows():
                return np.array([[self.number(entry) for entry in row] for row in side.rows])
        return self.number(side)

    def velocity(self, name: str) -> Any:
        return next(q.dot for q in self.statement.coordinates if q.name == name)

    def stated(self, quantity: ShownQuantity) -> Any:
        s = self.statement
        table = {"L": s.lagrangian, "T": s.kinetic, "V": s.potential, "D": s.dissipation}
        held = {item.name: item.expression for item in s.constraints}
        return table[quantity.letter] if quantity.letter in table else held[quantity.indices[0]]

    def quantity(self, letter: str, indices: tuple[str, ...]) -> Any:
        s, names = self.statement, self.statement.names
        if letter in ("r", "v"):
            return self.point_of(letter, indices[0])
        if letter == "T" and indices:
            masses = {point.name: point.mass for point in self.system.derivation().points}
            return self.number(masses[indices[0]]) * self.side(ShownQuantity("v", indices, squared=True)) / 2
        if letter in ("L", "T", "V", "D", "f"):
            return self.number(self.stated(ShownQuantity(letter, indices)))
        rows = [item.name for item in s.constraints] if letter == "G" else list(names)
        values = {
            "E": lambda: self.model.energy(self.q, self.v, self.t),
            "J": lambda: self.model.energy(self.q, self.v, self.t),
            "p": lambda: self.model.momenta(self.q, self.v, self.t),
            "Q": lambda: np.array([self.number(force) for force in s.forces]),
            "M": self.mass,
            "h": lambda: (self.mass() @ self.a - self.gradient().T @ self.multipliers)[:, None],
            "G": self.gradient,
        }[letter]()
        places = tuple((rows if k == 0 else list(names)).index(index) for k, index in enumerate(indices))
        return np.squeeze(values[places]) if places else values

    def mass(self) -> Any:
        return self.model.mass_matrix(self.q, self.t, v=self.v)

    def gradient(self) -> Any:
        s = self.statement
        if not s.constraints:
            return np.zeros((0, len(s.coordinates)))
        return self.model.evaluate("constraint_gradient", self.q, self.v, self.t)

    def point_of(self, letter: str, name: str) -> Any:
        entries = self.statement.positions[name]
        if letter == "r":
            return np.array([[self.number(entry) for entry in entries]])
        return np.array([[self.rate(partial(self.value, entry)) for entry in entries]])


@cache
def page(name: str) -> tuple[lg.System, list[Formula]]:
    system = shared_scene(name)
    return system, [row for part in sections(system.derivation()) for row in part.rows if isinstance(row, Formula)]


@pytest.mark.few
@pytest.mark.parametrize("name", SCENES)
def test_each_side_is_what_the_compiled_model_gives(name: str) -> None:
    system, rows = page(name)
    motion = Motion(system, seed=1)
    for row in rows:
        first, *others = [np.asarray(motion.side(side), dtype=float) for side in row.sides]
        for side, value in zip(row.sides[1:], others, strict=True):
            scale = max(1e-9, *(np.max(np.abs(x), initial=0.0) for x in (first, value)))
            scale = max(scale, size(motion, side), size(motion, row.sides[0]))
            assert np.all(np.abs(first.squeeze() - value.squeeze()) <= AGREEMENT * scale), (row, first, value)


def size(motion: Motion, side: Any) -> float:
    """Return the largest term of a side, the scale of its rounding errors."""
    if isinstance(side, SignedTerms):
        return max((float(np.max(np.abs(motion.side(term)))) for _, term in side.terms), default=0.0)
    if isinstance(side, sympy.Expr):
        return max(abs(motion.number(term)) for term in sympy.Add.make_args(side))
    return 0.0


SIGNS = {"\N{MINUS SIGN}": "-", "·": "*", "×": "*", "\N{FUNCTION APPLICATION}": " "}


def strict(symbol: Any) -> str:
    """Return the name of a symbol as people type it: lambda_wire for lambda[wire]."""
    return str(symbol.name).replace("[", "_").removesuffix("]")


def typed(setter: Typesetter, text: str) -> str:
    """Return MathML as people type the formula."""
    for symbol, letter in sorted(setter.letters.items(), key=lambda pair: -len(pair[1])):
        text = text.replace(letter, f"<s>{strict(symbol)}</s>")
    return _typed(ElementTree.fromstring(f"<mrow>{text}</mrow>"))


def _typed(node: ElementTree.Element) -> str:
    parts = [_typed(child) for child in node]
    match node.tag:
        case "mfrac":
            return f"(({parts[0]})/({parts[1]}))"
        case "msup":
            return f"{parts[0].rstrip()}^({parts[1]})"
        case "msqrt":
            return f"sqrt({''.join(parts)})"
        case "mrow" | "mspace":
            return "".join(parts)
    return f" {SIGNS.get(node.text or '', node.text)} "


def printed(row: Formula, lines: list[FormulaLine]) -> Iterator[tuple[sympy.Expr, str]]:
    """Yield the expressions of a formula with their texts: the last side, and the side before it if there is one."""
    starts = [place for place, line in enumerate(lines) if not line.goes_on]
    texts = [" ".join(line.right for line in lines[a:b]) for a, b in pairwise([*starts, len(lines)])]
    sides = row.sides[-len(texts) :]
    if not lines[0].left:
        sides, texts = row.sides[:1], [re.split("<mo>=</mo>| = ", " ".join(texts))[0]]
    yield from ((side, text) for side, text in zip(sides, texts, strict=True) if isinstance(side, sympy.Expr))


@pytest.mark.parametrize("notation", [Notation, UnicodeNotation, LatexNotation, MathmlNotation])
@pytest.mark.parametrize("name", SCENES)
def test_what_is_printed_reads_back_as_the_same_numbers(name: str, notation: Any) -> None:
    system, rows = page(name)
    writer = LineWriter(system.statement, notation)
    reader = TypedReader({strict(symbol): symbol for symbol in writer.setter.letters}, {})
    draw = np.random.default_rng(2)
    point = {symbol: sympy.Float(float(draw.uniform(0.3, 1.7)), 30) for symbol in writer.setter.letters}
    for row in rows:
        for side, text in printed(row, writer.formula(row)):
            plain = typed(writer.setter, text) if notation is MathmlNotation else text
            (equation,) = reader.equations(f"{plain} - 1 = 0")
            expected = side.xreplace(system.statement.plain).xreplace(point)
            result = equation.zero.xreplace(point) + 1
            assert abs(sympy.N(result - expected, 25)) <= 1e-12 * max(1, abs(sympy.N(expected, 25))), (text, side)
