"""The largest value of a function in a bracket of three points, by Brent's method without derivatives.

Source: R. P. Brent, Algorithms for Minimization without Derivatives, 1973, chapter 5.
"""

from __future__ import annotations

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import PARTIAL, READ, REAL, WHOLE, Array, Callee, Kind, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Real, Whole

ALONG: tuple[Kind | Array, ...] = (REAL, REAL, REAL, WHOLE, READ, READ, WHOLE)
"""Arguments for a value along a step: the beginning of the step, its length in time and in the unit of the polynomial,
the index of the expression, the coefficients of the polynomial, the numbers of the system, and the degree."""

FRACTIONS = Callee((WHOLE, READ, Array(), *ALONG), ())
"""A callback that writes the values of an expression at some fractions of a step."""

RESOLUTION = 2.0**-27
"""Resolution of points as a fraction of the step: the value at a maximum is then exact to round-off."""

MOST_EVALUATIONS = 60
"""Largest number of evaluations. Without a second derivative it takes 40, with a third derivative about 8."""

GOLDEN = 0.3819660112501051
"""The smaller part of the golden section, (3 - sqrt(5)) / 2."""

MEMORY = ("low", "high", "x", "w", "v", "fx", "fw", "fv", "before", "moved", "at", "there")
"""Entries for each bracket: its ends, the best three points and their values, the last two moves, and the trial point
with its value."""


def memory_size(count: int) -> int:
    """Return the number of entries of the memory for `count` brackets."""
    return len(MEMORY) * count + PARTIAL


@shared
def largest_between(columns: int | None = None) -> Procedure:
    """Return the procedure that raises `best` to the largest value in each of some brackets.

    A bracket is three points with their values, which are multiplied by `sign`. The number of brackets is `columns`, or
    a parameter, and then the caller also passes the memory of `memory_size` numbers.
    """
    return _BracketSearch(columns).build()


class _BracketSearch:
    """Builder of the procedure that searches for a maximum in each bracket."""

    def __init__(self, columns: int | None) -> None:
        self.p = p = Builder("largest_between", "Raise numbers to the largest values between places.")
        self.value = p.function("value", FRACTIONS)
        self.count: Whole | int = p.given("columns", WHOLE) if columns is None else columns
        self.sign: Real = p.given("sign", REAL)
        self.places = [p.array(name, read=True) for name in ("first", "middle", "last")]
        self.values = [p.array(f"{name}_value", read=True) for name in ("first", "middle", "last")]
        self.best = p.array("best")
        self.along = [p.given(f"along{k}", kind) for k, kind in enumerate(ALONG)]
        work = p.array("work", room=PARTIAL) if columns is None else p.reserve(len(MEMORY) * columns, name="work")
        self.kept = {name: work.at(self.count * k) for k, name in enumerate(MEMORY)}

    def build(self) -> Procedure:
        p, kept, tried = self.p, self.kept, self.p.variable(0, "tried")
        self.begin()
        unfinished = p.variable(self.unfinished(), "unfinished")
        with p.repeat(lambda: unfinished.value & (tried.value < MOST_EVALUATIONS)):
            self.choose_places()
            self.value(self.count, kept["at"], kept["there"], *self.along)
            self.sort_in()
            unfinished.value = self.unfinished()
            tried.value = tried.value + 1
        with p.each(self.count) as i:
            self.best[i] = p.choose(kept["fx"][i] > self.best[i], kept["fx"][i], self.best[i])
        return p.finish()

    def begin(self) -> None:
        """Start from the middle, the better end and the other end; the vertex of their parabola is tried first."""
        p, kept = self.p, self.kept
        with p.each(self.count) as i:
            low, middle, high = (places[i] for places in self.places)
            first, inside, last = (values[i] * self.sign for values in self.values)
            left = first > last
            kept["low"][i], kept["high"][i] = low, high
            kept["x"][i], kept["fx"][i] = middle, inside
            kept["w"][i], kept["fw"][i] = p.choose(left, low, high), p.choose(left, first, last)
            kept["v"][i], kept["fv"][i] = p.choose(left, high, low), p.choose(left, last, first)
            kept["before"][i], kept["moved"][i] = high - low, high - low

    def wide(self, i: Whole) -> Flag:
        """Return True if a bracket is wider than the resolution."""
        low, high, x = (self.kept[name][i] for name in ("low", "high", "x"))
        found: Flag = abs(x - (low + high) * 0.5) > 2.0 * RESOLUTION - (high - low) * 0.5
        return found

    def unfinished(self) -> Flag:
        """Return whether any bracket is wide."""
        p = self.p
        with p.each(self.count) as i:
            most = p.largest_magnitude(p.choose(self.wide(i), 1.0, p.constant(0.0, REAL)))
        found: Flag = most.value > 0.0
        return found

    def choose_places(self) -> None:
        """Choose the next point of each bracket.

        It is the vertex of the parabola through the best three points, or given by the golden section.
        """
        p, kept = self.p, self.kept
        with p.each(self.count) as i:
            names = ("low", "high", "x", "w", "v", "fx", "fw", "fv", "before", "moved")
            low, high, x, w, v, fx, fw, fv, before, moved = (kept[name][i] for name in names)
            r, q = (x - w) * (fv - fx), (x - v) * (fw - fx)
            top, below = (x - v) * q - (x - w) * r, 2.0 * (q - r)
            top, below = p.choose(below > 0.0, -top, top), abs(below)
            fits = (abs(top) < abs(below * before * 0.5)) & (top > below * (low - x)) & (top < below * (high - x))
            fits = fits & (abs(before) > RESOLUTION)
            step = top / p.choose(below.equals(0.0), 1.0, below)
            middle = (low + high) * 0.5
            towards = p.choose(x < middle, RESOLUTION, p.constant(-RESOLUTION, REAL))
            close = (x + step - low < 2.0 * RESOLUTION) | (high - (x + step) < 2.0 * RESOLUTION)
            rest = p.choose(x < middle, high - x, low - x)
            step = p.choose(fits, p.choose(close, towards, step), rest * GOLDEN)
            least = p.choose(step > 0.0, RESOLUTION, p.constant(-RESOLUTION, REAL))
            kept["before"][i], kept["moved"][i] = p.choose(fits, moved, rest), step
            kept["at"][i] = x + p.choose(self.wide(i), p.choose(abs(step) < RESOLUTION, least, step), 0.0)

    def sort_in(self) -> None:
        """Sort the trial point into the best three, and shrink the bracket."""
        p, kept = self.p, self.kept
        with p.each(self.count) as i:
            names = ("low", "high", "x", "w", "v", "fx", "fw", "fv", "at", "there")
            low, high, x, w, v, fx, fw, fv, u, value = (kept[name][i] for name in names)
            fu, wide = value * self.sign, self.wide(i)
            better = fu >= fx
            second = ~better & ((fu >= fw) | w.equals(x))
            third = ~better & ~second & ((fu >= fv) | v.equals(x) | v.equals(w))
            left, right = p.choose(better, x, u), p.choose(better, u, x)
            risen = left < right
            made = {
                "low": p.choose(risen, left, low),
                "high": p.choose(risen, high, left),
                "v": p.choose(better | second, w, p.choose(third, u, v)),
                "fv": p.choose(better | second, fw, p.choose(third, fu, fv)),
                "w": p.choose(better, x, p.choose(second, u, w)),
                "fw": p.choose(better, fx, p.choose(second, fu, fw)),
                "x": p.choose(better, u, x),
                "fx": p.choose(better, fu, fx),
            }
            before = {"low": low, "high": high, "v": v, "fv": fv, "w": w, "fw": fw, "x": x, "fx": fx}
            for name, new in made.items():
                kept[name][i] = p.choose(wide, new, before[name])
