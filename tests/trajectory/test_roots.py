"""Root isolation: each root is found once, with its direction, on one step and at the ends of steps."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from lagrange.algorithm.events.roots import roots as isolation
from lagrange.algorithm.taylor.event_series import keeps_sign
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.python_source import called
from lagrange.trajectory.events.array_search import Root, Side, roots
from lagrange.trajectory.trajectory import FloatArray
from tests.covering import Share


@pytest.fixture(autouse=True)
def _in_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolate roots in machine code; `tests/procedure/test_root_isolation.py` compares it with printed Python."""
    monkeypatch.setattr("lagrange.trajectory.events.array_search.printed", lambda: LlvmMachine().called(ISOLATE))


ISOLATE = isolation.form()
EPSILON = 2.0**-52
GRID = 2**40
"""Roots are multiples of 1 / GRID, so that the coefficients of their product are integers."""
UNRESOLVED = 24 * EPSILON
"""Times sum |c[k] h**k|: what is this small between two roots may pass for zero (3 times the least noise)."""

Case = tuple[FloatArray, list[float], list[complex]]
"""Coefficients in s = tau / h, the roots inside the step in order, and those outside."""


def times(p: list[int], q: Sequence[int]) -> list[int]:
    product = [0] * (len(p) + len(q) - 1)
    for j, a in enumerate(p):
        for k, b in enumerate(q):
            product[j + k] += a * b
    return product


def rounded(inside: Sequence[float], outside: Sequence[complex] = (), sign: int = 1) -> FloatArray:
    """Return the correctly rounded coefficients of a polynomial with given roots; a complex root counts as a pair."""
    product, scale = [sign], 1
    for root in (*inside, *outside):
        a, b = round(root.real * GRID), round(root.imag * GRID)
        factor = (a * a + b * b, -2 * a * GRID, GRID * GRID) if b else (-a, GRID)
        product, scale = times(product, factor), scale * factor[-1]
    return np.array([c / scale for c in product])


def stepped(scaled: FloatArray, h: float) -> FloatArray:
    return np.array(scaled / h ** np.arange(len(scaled)))


def snapped(s: float) -> float:
    return round(s * GRID) / GRID


def random_case(rng: np.random.Generator) -> Case:
    """Return a random polynomial with up to eight roots in (0, 1), some of them close, and up to degree 24."""
    drawn = list(rng.uniform(0.01, 0.99, rng.integers(0, 9)))
    close = [drawn[0] + 10 ** rng.uniform(-6, -2)] if drawn and rng.random() < 0.5 else []
    inside = sorted(snapped(s) for s in (*drawn, *close))
    outside: list[complex] = []
    for _ in range(rng.integers(0, 16)):
        turn = rng.uniform(0, np.pi)
        away = 0.5 + rng.uniform(0.8, 4) * complex(np.cos(turn), np.sin(turn))
        outside.append(complex(snapped(away.real), snapped(away.imag) if rng.random() < 0.4 else 0.0))
        if 0 <= outside[-1].real <= 1 and not outside[-1].imag:
            outside[-1] += 2
    while len(inside) + sum(2 if z.imag else 1 for z in outside) > 24:
        outside.pop()
    return rounded(inside, outside, int(rng.choice((-1, 1)))), inside, outside


def size_of_product(s: float, inside: Sequence[float], outside: Sequence[complex]) -> float:
    return math.prod([abs(s - z) ** (2 if z.imag else 1) for z in (*inside, *outside)])


def resolved(case: Case) -> bool:
    """Return True if the polynomial exceeds its round-off between the roots and at both ends."""
    c, inside, outside = case
    limit = UNRESOLVED * float(np.abs(c).sum())
    middles = [(a + b) / 2 for a, b in pairwise(inside)]
    return all(size_of_product(s, inside, outside) > limit for s in (0.0, 1.0, *middles))


def directions(result: list[Root]) -> list[int]:
    return [root.rising for root in result]


def alternating(count: int, first: int) -> list[int]:
    return [first if k % 2 == 0 else -first for k in range(count)]


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(10))
def test_every_root_of_a_random_polynomial_is_found_once(seed: int, share: Share) -> None:
    """Each block has a thousand polynomials with known roots.

    Locations are right to the round-off of g over its slope.
    """
    rng = np.random.default_rng(seed)
    every = [random_case(rng) for _ in range(share(1500))]
    cases = [case for case in every if resolved(case)][: share(1000)]
    assert len(cases) == share(1000), "the coefficients resolve most of what is drawn"
    for scaled, inside, outside in cases:
        h = float(rng.choice((-1, 1)) * 10 ** rng.uniform(-6, 6))
        result, after = roots(stepped(scaled, h), h)
        first = 1 if scaled[0] < 0 else -1
        assert directions(result) == alternating(len(inside), first), (scaled, h)
        assert after == Side(-first if len(inside) % 2 == 0 else first)
        assert not inside or h < 0 or not clear(stepped(scaled, h), h)
        size = float(np.abs(scaled).sum())
        for root, s in zip(result, inside, strict=True):
            slope = size_of_product(s, [other for other in inside if other != s], outside)
            # The round-off of the coefficients, of their scaling by h**k and of Horner's rule is below 4 EPSILON.
            # A close neighbour bends g at this distance: the factor 2.
            assert abs(root.time / h - s) <= 2 * 4 * EPSILON * size / slope + 2 * EPSILON


@pytest.mark.parametrize("sign", [1, -1])
def test_roots_of_higher_order(sign: int, share: Share) -> None:
    """A double root is a touch. A triple root is a crossing, located up to the cube root of round-off."""
    rng = np.random.default_rng(5)
    for _ in range(share(300)):
        s = snapped(rng.uniform(0.01, 0.99))
        outside = [complex(snapped(z)) for z in (*rng.uniform(1.5, 4, 6), *rng.uniform(-3, -0.5, 5))]
        for order in (2, 3, 4):
            c = rounded([s] * order, outside, sign)
            before = 1 if c[0] > 0 else -1
            result, after = roots(c, 1.0)
            assert directions(result) == [0 if order % 2 == 0 else -before]
            assert after == Side(before if order % 2 == 0 else -before)
            spread = (UNRESOLVED * float(np.abs(c).sum()) / size_of_product(s, (), outside)) ** (1 / order)
            assert abs(result[0].time - s) < (spread if order > 2 else 0.01 * spread)


def wave(t: float, turns: int) -> FloatArray:
    """Return the Taylor coefficients about t of the cosine shifted by quarter periods; 3 quarters give the sine."""
    derivatives = (math.cos(t), -math.sin(t), -math.cos(t), math.sin(t))
    return np.array([derivatives[(k + turns) % 4] / math.factorial(k) for k in range(30)])


@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1.0, 1e150, 1e300])
def test_scales(scale: float) -> None:
    """The units of g and of time have no effect."""
    c = rounded([0.125, 0.25, 0.25, 0.75])
    result, after = roots(c * scale, 1.0)
    assert directions(result) == [-1, 0, 1] and after == Side(1)
    assert [root.time for root in result] == pytest.approx([0.125, 0.25, 0.75], rel=1e-13)
    for unit in (scale, -scale):
        result, after = roots(np.array([-0.5, 1 / unit]), unit)
        assert directions(result) == [1] and after == Side(1)
        assert result[0].time == pytest.approx(unit / 2, rel=1e-15, abs=0)
        assert roots(np.array([-scale / 2, scale / unit]), unit, noise=scale)[1] == Side()
    assert directions(roots(c * 1e308, 1.0)[0]) == [-1, 0, 1]
    assert clear(np.array([-0.5, 0.3 / scale]), scale) and not clear(np.array([-0.5, 1 / scale]), scale)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(bad: float) -> None:
    for c, h, noise in (([1.0, bad], 1.0, 0.0), ([1.0, 2.0], bad, 0.0), ([1.0, 2.0], 1.0, bad), ([bad], 1.0, 0.0)):
        with pytest.raises(ValueError, match="must be finite numbers"):
            roots(np.array(c), h, noise=noise)
    assert not clear(np.array([1.0, bad]), 1.0) and not clear(np.array([bad, 1.0]), 1.0)
    with pytest.raises(ValueError, match="must be finite numbers"):
        roots(np.empty(0), 1.0)


def clear(c: FloatArray, h: float, noise: float = 0.0) -> bool:
    """Return True if the loop over steps concludes that a function keeps its sign on a step."""
    return bool(called(keeps_sign.form())(c, len(c), h, noise, float(np.sign(c[0]))))


Series = Callable[[float], FloatArray]
"""From a time to the Taylor coefficients of g about it."""


def power(order: int) -> Series:
    return lambda t: np.array([math.comb(order, k) * t ** (order - k) for k in range(order + 1)])


def followed(g: Series, edges: Sequence[float], *, noise: float = 0.0, last: bool = False) -> list[tuple[float, int]]:
    """Return the times and directions of the roots found by a run with given step ends."""
    side = Side()
    events: list[tuple[float, int]] = []
    for a, b in pairwise(edges):
        c, h = g(a), b - a
        if side.settled and h > 0 and clear(side.sign * c, h, noise):
            continue
        result, side = roots(c, h, side, noise=noise, last=last and b == edges[-1])
        events += [(a + root.time, root.rising) for root in result]
    return events


def edges_about(rng: np.random.Generator, places: Sequence[float], low: float, high: float, grid: bool) -> list[float]:
    """Return step ends at most 2 apart, at roots, at the doubles next to them, and at other distances."""
    joints = [*np.arange(low, high, 1.9), *rng.uniform(low, high, 20), high]
    for place in places:
        near = [place, math.nextafter(place, high), math.nextafter(place, low)]
        near += [place + s * 10 ** rng.uniform(-16, -1) for s in (-1, -1, -1, 1, 1, 1)]
        joints += [t for t in near if rng.random() < 0.4]
    joints = [snapped(t) if grid else float(t) for t in joints]
    return sorted({t for t in joints if low <= t <= high})


@pytest.mark.parametrize("grid", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_run_reports_each_root_of_the_sine_once(seed: int, grid: bool, share: Share) -> None:
    """At step ends on a grid the series are exact; elsewhere two steps differ by the rounding of the time."""
    rng = np.random.default_rng(300 + seed)
    places = [k * math.pi for k in range(1, 12)]
    for _ in range(share(60)):
        edges = edges_about(rng, places, 0.375, 36.0, grid)
        for path in (edges, edges[::-1]):
            events = followed(lambda t: wave(t, 3), path, noise=0.0 if grid else 2e-14)
            onward = path[0] < path[-1]
            assert [way for _, way in events] == alternating(11, -1 if onward else 1), path
            assert [time for time, _ in events] == pytest.approx(places[:: 1 if onward else -1], abs=4e-14)


@pytest.mark.few(1)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_flat_root_at_a_joint_is_one(order: int) -> None:
    rng = np.random.default_rng(order)
    for _ in range(300):
        edges = sorted({-1.0, 1.0, *(float(s * 10 ** rng.uniform(-12, 0)) for s in rng.choice((-1, 0, 1), 6))})
        for path in (edges, edges[::-1]):
            way = 0 if order % 2 == 0 else 1 if path is edges else -1
            assert [result for _, result in followed(power(order), path)] == [way], path


@pytest.mark.parametrize("sign", [1, -1])
def test_the_ends_of_a_run(sign: int) -> None:
    """A root at the start of a run is no event, a root at its end is one, and a root at a step end counts once."""
    c = sign * np.array([0.0, 1.0])
    assert roots(c, 1.0) == ([], Side(sign))
    assert roots(c, 1.0, Side(-sign, near=True)) == ([Root(0.0, sign)], Side(sign))
    assert roots(c, 1.0, Side(sign)) == ([], Side(sign))
    towards = -sign * np.array([1.0, -1.0])
    assert roots(towards, 1.0) == ([], Side(-sign, near=True))
    assert roots(towards, 1.0, last=True)[0] == [Root(1.0, sign)]
    turning = sign * np.array([0.25, -1.0, 1.0])
    assert roots(turning, 0.5) == ([], Side(sign, near=True))
    assert roots(turning, 0.5, last=True)[0] == [Root(0.5, 0)]
    assert roots(sign * np.array([0.0, 0.0, 1.0]), 0.5, Side(sign, near=True)) == ([Root(0.0, 0)], Side(sign))
