"""The check catches every small fault in a derivative rule or an equation builder.

Each mutant flips a sign, drops a term, swaps an index or scales a factor of one rule while a system is stated and
compiled; `check` must then find something wrong at the first point that it tries, by differences of the stated
energies alone: neither the textbook derivation nor another machine helps. A control shows that the same systems pass
without a mutant, with all that `check` has and at all points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import pytest
import sympy

import lagrange as lg
from lagrange.equations import euler_lagrange
from lagrange.evidence.check import check
from lagrange.graph import differentiate
from lagrange.graph.node import Kind, Node
from lagrange.statement.vocabulary.functions import FUNCTIONS
from tests.covering import Share

Rule = Callable[..., Any]

x, y = lg.coordinates("x y")
m, k = lg.parameters("m k")

TERMS = {
    "sin": sympy.sin(x + 2 * y),
    "cos": sympy.cos(2 * x - y),
    "tan": sympy.tan(x / 3 + y / 5),
    "asin": sympy.asin(x / 7),
    "acos": sympy.acos(y / 7),
    "atan": sympy.atan(x * y),
    "atan2": sympy.atan2(x + 3, y + 2),
    "exp": sympy.exp(x / 2 - y),
    "log": sympy.log(x**2 + y**2 + 1),
    "sinh": sympy.sinh(x / 2 + y / 3),
    "cosh": sympy.cosh(x / 2 - y / 3),
    "tanh": sympy.tanh(x - y),
    "asinh": sympy.asinh(x - y),
    "acosh": sympy.acosh(x + y / 2 + 3),
    "atanh": sympy.atanh((x - y) / 5),
    "erf": sympy.erf(x - y / 2),
    "abs": x * sympy.Abs(y - x / 2),
    "min": sympy.Min(x**2, y + 1) * x,
    "max": sympy.Max(x**2, y + 1) * y,
    "pow": (x**2 + 2) ** (y / 3 + 2),
}
"""A potential for each function that has a derivative worth the name."""


def plane(potential: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2 * (2 + sympy.sin(x))) / 2,
        potential=k * potential,
        coordinates=[x, y],
        parameters={m: 1.3, k: 0.7},
        initial={x: 0.4, y: 0.3, x.dot: 0.2, y.dot: -0.5},
        name="plane",
    )


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


@dataclass(frozen=True)
class Mutant:
    """A fault, a function that inserts it, and a system in which it has an effect."""

    name: str
    inject: Callable[[], Any]
    system: Callable[[], lg.System]


def negated(rule: Rule) -> Rule:
    return lambda *args: -rule(*args)


def scaled(rule: Rule) -> Rule:
    return lambda *args: 2 * rule(*args)


def dropped(rule: Rule) -> Rule:
    return lambda *args: args[0].graph.zero


CHANGES = {"negated": negated, "scaled": scaled, "dropped": dropped}


CHANGED_RULES = [
    (rule, kind)
    for rule in [(name, index) for name in TERMS for index in range(len(FUNCTIONS[name].partials))]
    for kind in CHANGES
]


def function_mutants() -> Iterator[Mutant]:
    for (name, index), kind in CHANGED_RULES:
        partials = FUNCTIONS[name].partials
        changed = (*partials[:index], CHANGES[kind](partials[index]), *partials[index + 1 :])
        yield Mutant(f"{name} rule {index} {kind}", _function_patch(name, changed), _with_potential(TERMS[name]))
    for name, term in TERMS.items():
        if len(FUNCTIONS[name].partials) == 2:
            swapped = FUNCTIONS[name].partials[::-1]
            yield Mutant(f"{name} rules swapped", _function_patch(name, swapped), _with_potential(term))


def _function_patch(name: str, rules: tuple[Rule, ...]) -> Callable[[], Any]:
    return lambda: patch.dict(FUNCTIONS, {name: replace(FUNCTIONS[name], partials=rules)})


def _with_potential(term: Any) -> Callable[[], lg.System]:
    return lambda: plane(term)


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


def _power_without_factor(node: Node) -> Any:
    return [(0, node.graph.power(node.args[0], node.data - 1))]


def _power_same_exponent(node: Node) -> Any:
    return [(0, node.graph.sum(((node.data, node),)))]


def rule_mutants() -> Iterator[Mutant]:
    changes: dict[str, Callable[[Rule], Rule]] = {
        "first negated": lambda rule: _first(lambda p: -p, rule),
        "first scaled": lambda rule: _first(lambda p: 2 * p, rule),
        "last dropped": _last_dropped,
        "indices rotated": _rotated,
    }
    for kind in (Kind.PRODUCT, Kind.POWER):
        for name, change in changes.items():
            if kind is Kind.POWER and name in ("last dropped", "indices rotated"):
                continue
            yield Mutant(f"{kind.value} {name}", _rule_patch(kind, change(differentiate.PARTIALS[kind])), rich)
    yield Mutant("power without its factor", _rule_patch(Kind.POWER, _power_without_factor), rich)
    yield Mutant("power with its exponent kept", _rule_patch(Kind.POWER, _power_same_exponent), rich)


def _rule_patch(kind: Kind, rule: Rule) -> Callable[[], Any]:
    return lambda: patch.dict(differentiate.PARTIALS, {kind: rule})


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
    module = euler_lagrange
    for name in ("conjugate_momenta", "applied_forces", "generalized_forces", "bias_forces"):
        for fault, build in _elementwise(getattr(module, name)).items():
            if (name, fault) == ("conjugate_momenta", "first dropped"):
                continue  # leaves a coordinate without inertia, which is refused when it is stated
            yield Mutant(f"{name} {fault}", _builder_patch(name, build), rich)
    solve = module.solve_motion
    for fault, build in _elementwise(lambda *a: solve(*a)[0]).items():
        yield Mutant(f"solve_motion {fault}", _builder_patch("solve_motion", _without_multipliers(build)), rich)


def _without_multipliers(build: Rule) -> Rule:
    """Return a builder of accelerations as a builder of accelerations and (no) multipliers."""
    return lambda *a: (build(*a), [])


def _builder_patch(name: str, build: Rule) -> Callable[[], Any]:
    return lambda: patch.object(euler_lagrange, name, build)


MUTANTS = [*function_mutants(), *rule_mutants(), *builder_mutants()]


@contextmanager
def injected(mutant: Mutant) -> Iterator[None]:
    with mutant.inject():
        yield


@pytest.mark.few(5)
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name.replace(" ", "-"))
def test_mutant_is_caught(mutant: Mutant) -> None:
    with injected(mutant):
        report = check(mutant.system().compile("numpy", check=False), points=1)
    assert not report, f"{mutant.name} survived:\n{report}"


@pytest.mark.few(1)
@pytest.mark.parametrize("name", TERMS)
def test_the_same_system_passes_without_a_mutant(name: str, share: Share) -> None:
    report = plane(TERMS[name]).check(points=share(5))
    assert report, str(report)


@pytest.mark.slow
def test_the_rich_system_passes_without_a_mutant() -> None:
    report = rich().check()
    assert report, str(report)
