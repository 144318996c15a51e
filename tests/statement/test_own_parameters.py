"""Parameters of `lg.parameters` are those of a scene by their names, though SymPy takes them for others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from sympy import sin

import lagrange as lg
from tests.models import shared_scene

theta = lg.coordinate("theta")
m, g, l = lg.parameters("m g l")
x, y = lg.coordinates("x y")
NAMED = dict(zip("mgl", (m, g, l), strict=True))


def own(name: str) -> Callable[[str], Any]:
    """Return what gives a parameter of a scene itself."""
    table = {p.name: p for p in shared_scene(name).statement.parameters}
    assert not set(table.values()) & {m, g, l}
    return lambda letter: table[letter]


USES: dict[str, tuple[str, Callable[[Any, Callable[[str], Any]], Any]]] = {
    "evaluate": ("pendulum", lambda s, p: s.run(0.5).evaluate(p("m") * p("g") * p("l") * sin(theta)).tolist()),
    "event": ("pendulum", lambda s, p: s.run(2.0, events=[theta - p("l")]).t_events[0].tolist()),
    "reset": (
        "pendulum",
        lambda s, p: s.run(2.0, events=[lg.event(theta, reset={theta.dot: -p("l") * theta.dot / 2})]).final,
    ),
    "noether": ("kepler", lambda s, p: s.noether({x: -p("m") * y, y: p("m") * x})),
    "eliminate": ("cartesian-pendulum", lambda s, p: s.eliminate({y: ((p("l") ** 2 - x**2) ** 0.5)}).accelerations()),
    "poisson": ("pendulum", lambda s, p: s.hamiltonian().poisson(p("l") * theta, s.hamiltonian().momenta[theta])),
    "transform": ("pendulum", lambda s, p: s.transform({theta: lg.coordinate("u") / p("l")}).lagrangian),
    "linearize": ("pendulum", lambda s, p: s.linearize({theta: p("l") / 9}).K),
    "substitute": ("pendulum", lambda s, p: s.substitute({"g": 4 * p("l")}).lagrangian),
}


@pytest.mark.few(4)
@pytest.mark.parametrize("use", USES)
def test_a_parameter_is_known_by_its_name(use: str) -> None:
    name, asked = USES[use]
    scene = shared_scene(name)
    assert asked(scene, NAMED.__getitem__) == asked(scene, own(name))
