"""Fields xi(q) along which a system may be moved: affine ones, and those of rotations and shifts in curved coordinates.

Each is a product of functions of one coordinate each, in one component. In polar coordinates a shift of the plane is
xi = (cos(phi), -sin(phi)/r), in spherical ones a rotation is (0, sin(phi), cos(phi) cot(theta)).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import Any

import numpy as np
import sympy

from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.machine.backend import FloatArray

MOST_FIELDS = 420
"""Fields that are tried together: their null space takes 0.2 s for so many."""

MOST_CURVED = 4
"""With more coordinates affine fields alone are tried: the others are too many."""

MOST_RATIOS = 3
"""With more coordinates no ratios of lengths are tried: a rotation in cylindrical coordinates has z/r."""


@dataclass(frozen=True)
class Factor:
    """A function of one coordinate: its values and slopes, and as SymPy."""

    value: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]
    written: Callable[[Any], Any]


FACTORS: dict[str, Factor] = {
    "q": Factor(lambda x: x, np.ones_like, lambda x: x),
    "1/q": Factor(lambda x: 1 / x, lambda x: -1 / x**2, lambda x: 1 / x),
    "sin": Factor(np.sin, np.cos, sympy.sin),
    "cos": Factor(np.cos, lambda x: -np.sin(x), sympy.cos),
    "cot": Factor(lambda x: 1 / np.tan(x), lambda x: -1 / np.sin(x) ** 2, lambda x: sympy.cos(x) / sympy.sin(x)),
    "csc": Factor(lambda x: 1 / np.sin(x), lambda x: -np.cos(x) / np.sin(x) ** 2, lambda x: 1 / sympy.sin(x)),
    "tan": Factor(np.tan, lambda x: 1 / np.cos(x) ** 2, lambda x: sympy.sin(x) / sympy.cos(x)),
    "sec": Factor(lambda x: 1 / np.cos(x), lambda x: np.sin(x) / np.cos(x) ** 2, lambda x: 1 / sympy.cos(x)),
}


@dataclass(frozen=True)
class Field:
    """xi with one component: a product of factors, (coordinate, name) each, in the component `of`."""

    of: int
    factors: tuple[tuple[int, str], ...]

    def values(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the component and its rate at states (n, K), (K,) each."""
        parts = [FACTORS[name].value(q[j]) for j, name in self.factors]
        whole, rate = np.ones(q.shape[1]), np.zeros(q.shape[1])
        for part in parts:
            whole = whole * part
        for k, (j, name) in enumerate(self.factors):
            slope = FACTORS[name].slope(q[j]) * v[j]
            for other, part in enumerate(parts):
                slope = slope if other == k else slope * part
            rate = rate + slope
        return whole, rate

    def written(self, q: Sequence[Any]) -> Any:
        """Return the component as SymPy."""
        return sympy.Mul(*(FACTORS[name].written(q[j]) for j, name in self.factors))


def fields(stated: StatedAlgebra) -> list[Field]:
    """Return the fields to try for a statement, the affine ones first."""
    n = len(stated.q)
    shifts = [Field(i, ()) for i in range(n)]
    linear = [Field(i, ((j, "q"),)) for i in range(n) for j in range(n)]
    if n > MOST_CURVED or (curved := _curved(stated)) is None:
        return shifts if len(shifts) + len(linear) > MOST_FIELDS else [*linear, *shifts]
    known = frozenset((*linear, *shifts))
    found = [one for i in range(n) for one in (Field(i, factors) for factors in curved) if one not in known]
    return [*found, *linear, *shifts] if len(found) + len(known) <= MOST_FIELDS else [*linear, *shifts]


def components(stated: StatedAlgebra) -> list[Any]:
    """Return the components of places in curved coordinates: a length times a sine or cosine of one or two angles."""
    if len(stated.q) > MOST_RATIOS:
        return []
    angles = [q for q in stated.q if not _places(stated, q)[1]]
    waves = [[sympy.sin(q), sympy.cos(q)] for q in angles]
    pairs = [a * b for i, first in enumerate(waves) for second in waves[:i] for a in first for b in second]
    return [q * wave for q in stated.q if q not in angles for wave in (*chain(*waves), *pairs)]


def _curved(stated: StatedAlgebra) -> list[tuple[tuple[int, str], ...]] | None:
    """Return products of functions of angles with one power of a length; None where nothing is an angle.

    An angle is a coordinate that stands in sines and cosines alone, or nowhere.
    """
    options: list[list[tuple[tuple[int, str], ...]]] = []
    lengths: list[tuple[tuple[int, str], ...]] = [()]
    for j, q in enumerate(stated.q):
        in_angles, elsewhere = _places(stated, q)
        if elsewhere:
            lengths += [((j, "q"),), ((j, "1/q"),)]
            continue
        names = ["sin", "cos", *(["cot", "csc", "tan", "sec"] if in_angles else [])]
        options.append([(), *(((j, name),) for name in names)])
    if not options:
        return None
    if len(stated.q) <= MOST_RATIOS:
        straight = [j for factors in lengths[1::2] for j, _ in factors]
        lengths += [((i, "q"), (j, "1/q")) for i in straight for j in straight if i != j]
    return [tuple(sorted(chain(*parts))) for parts in product(*options, lengths)]


def _places(stated: StatedAlgebra, q: Any) -> tuple[bool, bool]:
    """Return whether a coordinate stands in sines and cosines, and whether it stands elsewhere."""
    in_angles = elsewhere = False
    for monomial in stated.lagrangian:
        for k, _ in monomial:
            factor = stated.algebra.factors[k]
            if q not in stated.algebra.free(k):
                continue
            rest = factor.replace(
                lambda node: isinstance(node, (sympy.sin, sympy.cos, sympy.tan)), lambda node: sympy.S.One
            )
            elsewhere |= rest.has(q)
            in_angles |= not rest.has(q)
    return in_angles, elsewhere
