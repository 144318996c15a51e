"""Random states, times and parameter values at which no term is likely to vanish or to dominate."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.evidence.scales import Scales
from lagrange.statement.statement import Statement


@dataclass(frozen=True)
class Point:
    """A state, a time and a value for every parameter; `kind` says how it was chosen."""

    q: tuple[float, ...]
    v: tuple[float, ...]
    t: float
    parameters: Mapping[Any, float]
    kind: str

    def describe(self, names: Sequence[str], digits: int = 17) -> str:
        """Return the point as ``theta = 0.3, theta_dot = -1.2, t = 0.5, m = 1`` in the user's symbols."""
        pairs = [*zip(names, self.q, strict=True), *((f"{a}_dot", x) for a, x in zip(names, self.v, strict=True))]
        pairs += [("t", self.t), *((p.name, x) for p, x in self.parameters.items())]
        return ", ".join(f"{name} = {float(value):.{digits}g}" for name, value in pairs)


@dataclass(frozen=True)
class SampleKind:
    """How points are chosen: states near the initial one or of order one, parameters how far from their defaults."""

    name: str
    state: str
    parameters: str


SAMPLE_KINDS = (
    SampleKind("near the initial state", "initial", "default"),
    SampleKind("everything of order one", "order one", "order one"),
    SampleKind("of order one, parameters near their defaults", "order one", "near default"),
    SampleKind("near the initial state, parameters near their defaults", "initial", "near default"),
    SampleKind("everything of order one", "order one", "order one"),
)
"""Taken in turn. Near the initial state the numbers are those that matter; with everything of order one no term
hides behind another 20 orders of magnitude larger, as one body's does behind the sun's in real units; parameters off
their defaults tell m1 from m2 where both are 1, and c from nothing where it is 0."""

DRAWS_PER_KIND = 40
"""Draws of one kind of point before the next kind is tried."""


Move = tuple[float, float, float]
"""A place, a random number, and the size of a move from the place by that number."""


class Sampler:
    """Random points of a statement, the same for the same seed."""

    def __init__(self, statement: Statement, seed: int) -> None:
        self.statement = statement
        self._draw = random.Random(seed)
        self._scales = Scales(statement)
        n = len(statement.coordinates)
        self._initial = (statement.initial[:n], statement.initial[n:])

    def point(self, kind: SampleKind, attempt: int = 0) -> Point:
        """Return a point; it is nearer to the initial state the more attempts have failed."""
        near = kind.state == "initial"
        if near:
            spread = 0.3 * 0.1 ** (attempt // 4)
            moves = [self._near(values, spread) for values in self._initial]
        else:
            moves = [[(0.0, self._of_order_one(), 1.0) for _ in values] for values in self._initial]
        t = self._draw.uniform(0.1, 2.0) * (max(0.1, self.statement.run.t_end / 2) if near else 1.0)
        parameters = self._parameters(kind.parameters)
        q, v = self._placed(moves, self._scales.sizes(parameters, self.statement.initial if near else ()))
        return Point(q, v, self._within(t), parameters, kind.name)

    def initial(self) -> Point:
        """Return the initial state itself, at t = 0 with the default parameters."""
        q, v = self._initial
        return Point(q, v, self._within(0.0), self._parameters("default"), "the initial state")

    def far(self) -> Point:
        """Return a point with numbers of any size, for branches that are rarely taken."""
        moves = [
            [(x if self._draw.random() < 0.5 else 0.0, self._of_order_one() * self._magnitude(), 1.0) for x in values]
            for values in self._initial
        ]
        t = abs(self._of_order_one()) * self._magnitude()
        parameters = self._parameters(self._draw.choice(("default", "near default", "order one")))
        q, v = self._placed(moves, self._scales.sizes(parameters))
        return Point(q, v, self._within(t), parameters, "far and wide")

    def _placed(
        self, moves: Sequence[Sequence[Move]], scales: Sequence[float]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return q and v from their moves; the characteristic size goes before the size of a move where it is not 1."""
        every = zip([*moves[0], *moves[1]], scales, strict=True)
        state = tuple(place + (size if scale == 1.0 else scale) * x for (place, x, size), scale in every)
        return state[: len(moves[0])], state[len(moves[0]) :]

    def _within(self, t: float) -> float:
        """Return the time, or one at which given functions have values if it has none."""
        first, last = self.statement.span
        return t if first <= t <= last else first + (last - first) * (0.2 + 0.6 * t / (1.0 + t))

    def _near(self, values: Sequence[float], spread: float) -> list[Move]:
        largest = max(1.0, *map(abs, values))
        # Where nothing tells the size of a zero, it is between 1 and the largest of its kind.
        sizes = [abs(x) or 10.0 ** self._draw.uniform(0.0, math.log10(largest)) for x in values]
        moves = [spread * self._of_order_one() for _ in values]
        return [
            (x + size * move, 0.0, 1.0) if x else (0.0, move, size)
            for x, move, size in zip(values, moves, sizes, strict=True)
        ]

    def _parameters(self, how: str) -> dict[Any, float]:
        values = {}
        for symbol in self.statement.parameters:
            default = self.statement.defaults.get(symbol)
            if default is not None and how == "default":
                values[symbol] = default
            elif default and how == "near default":
                values[symbol] = default * self._draw.uniform(0.7, 1.4)
            else:
                size = self._draw.uniform(0.4, 1.8)
                values[symbol] = -size if self._negative(symbol, default) else size
        return values

    def _negative(self, symbol: Any, default: float | None) -> bool:
        if symbol.is_positive:
            return False
        return default < 0 if default else self._draw.random() < 0.5

    def _of_order_one(self) -> float:
        return self._draw.uniform(0.2, 1.7) * (1.0 if self._draw.random() < 0.5 else -1.0)

    def _magnitude(self) -> float:
        return math.pow(10.0, self._draw.uniform(-3.0, 3.0))
