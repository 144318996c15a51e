"""The check catches every small fault in a derivative rule or an equation builder.

Each mutant flips a sign, drops a term, swaps an index or scales a factor of one rule while a system is stated and
compiled; `check` must then find something wrong at the first point that it tries, by differences of the stated
energies alone: neither the textbook derivation nor another machine helps. A control shows that the same system passes
without a mutant, with all that `check` has and at all points.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any
from unittest.mock import patch

import pytest
import sympy

import lagrange as lg
from lagrange.equations import euler_lagrange
from lagrange.evidence.check import check
from lagrange.graph.differentiate import PARTIALS
from lagrange.graph.node import Kind, Node

Rule = Callable[..., Any]

PRODUCT, POWER = Kind.PRODUCT, Kind.POWER

x, y = lg.coordinates("x y")
m, k = lg.parameters("m k")


def rich() -> lg.System:
    """Return a system that needs every equation builder: it has coupling, time, forces and dissipation."""
    t = lg.t
    return lg.System(
        lagrangian=m * (x.dot**2 + y.dot**2 + x.dot * y.dot * sympy.cos(x - 2 * y)) / 2
        + k * (x * y.dot - y * x.dot) * sympy.cos(t)
        - k * x**2 * y / 3
        + sympy.sin(t) * x,
        coordinates=[x, y],
        forces={x: -0.3 * x.dot * y, y: sympy.cos(t) * x},
        dissipation=0.2 * (x.dot + 2 * y.dot) ** 2 / 2,
        parameters={m: 1.3, k: 0.7},
        initial={x: 0.4, y: 0.3, x.dot: 0.2, y.dot: -0.5},
        name="rich",
    )


Mutant = tuple[str, Callable[[], Any]]
"""A fault, and a function that returns a context in which it is there."""


def _first(change: Callable[[Node], Node], rule: Rule) -> Rule:
    def mutated(node: Node) -> Any:
        (i, partial), *rest = rule(node)
        return [(i, change(partial)), *rest]

    return mutated


def _last_dropped(rule: Rule) -> Rule:
    return lambda node: rule(node)[:-1] if len(node.args) > 2 else rule(node)


def _rotated(rule: Rule) -> Rule:
    """Return a rule that gives each argument the derivative of the next one."""

    def mutated(node: Node) -> Any:
        pairs = rule(node)
        return [(i, other) for (i, _), (_, other) in zip(pairs, [*pairs[1:], pairs[0]], strict=True)]

    return mutated


RULE_CHANGES: dict[str, tuple[Kind, Rule]] = {
    **{f"{kind.value} first negated": (kind, _first(lambda p: -p, PARTIALS[kind])) for kind in (PRODUCT, POWER)},
    **{f"{kind.value} first scaled": (kind, _first(lambda p: 2 * p, PARTIALS[kind])) for kind in (PRODUCT, POWER)},
    "product last dropped": (PRODUCT, _last_dropped(PARTIALS[PRODUCT])),
    "product indices rotated": (PRODUCT, _rotated(PARTIALS[PRODUCT])),
    "power without its factor": (POWER, lambda node: [(0, node.graph.power(node.args[0], node.data - 1))]),
    "power with its exponent kept": (POWER, lambda node: [(0, node.graph.sum(((node.data, node),)))]),
}


def rule_mutants() -> Iterator[Mutant]:
    for name, (kind, rule) in RULE_CHANGES.items():
        yield name, partial(patch.dict, PARTIALS, {kind: rule})


def _with_first(values: Sequence[Node], change: Callable[[Node], Node]) -> list[Node]:
    return [change(values[0]), *values[1:]]


def _elementwise(build: Rule) -> dict[str, Rule]:
    """Return the faults of a builder that returns one node for each coordinate."""
    return {
        "first negated": lambda *a: _with_first(build(*a), lambda n: -n),
        "last scaled": lambda *a: _with_first(build(*a)[::-1], lambda n: 3 * n)[::-1],
        "first dropped": lambda *a: _with_first(build(*a), lambda n: n.graph.zero),
        "swapped": lambda *a: build(*a)[::-1],
    }


def builder_mutants() -> Iterator[Mutant]:
    builders = {
        name: _elementwise(getattr(euler_lagrange, name))
        for name in ("conjugate_momenta", "applied_forces", "generalized_forces", "bias_forces")
    }
    del builders["conjugate_momenta"]["first dropped"]  # a coordinate without inertia is refused when it is stated
    solve = euler_lagrange.solve_motion
    motions = _elementwise(lambda *a: solve(*a)[0])
    builders["solve_motion"] = {
        fault: lambda *a, build=build: (build(*a), []) for fault, build in motions.items()
    }  # and no multipliers
    for name, faults in builders.items():
        for fault, build in faults.items():
            yield f"{name} {fault}", partial(patch.object, euler_lagrange, name, build)


MUTANTS = {**dict(rule_mutants()), **dict(builder_mutants())}


@pytest.mark.few(5)
@pytest.mark.parametrize("fault", MUTANTS)
def test_mutant_is_caught(fault: str) -> None:
    with MUTANTS[fault]():
        report = check(rich().compile("numpy", check=False), points=1)
    assert not report, f"{fault} survived:\n{report}"


@pytest.mark.slow
def test_the_rich_system_passes_without_a_mutant() -> None:
    report = rich().check()
    assert report, str(report)
