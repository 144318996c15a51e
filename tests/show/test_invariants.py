"""What a system conserves, along a run: the mapping, the card and the plot."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.mechanics import conserved

r, phi, theta, x, y = lg.coordinates("r phi theta x y")
m, g, l, k = lg.parameters("m g l k")
BOB = (l * sin(theta) * cos(phi), l * sin(theta) * sin(phi), -l * cos(theta))
VALUES = {m: 1.3, g: 9.81, l: 0.7}


def spherical(**start: float) -> lg.Solution:
    system = lg.System(lg.kinetic_energy(m, BOB), lg.gravity(m, BOB, g), parameters=VALUES)
    return system.run(2.0, {"theta": 1.0, "phi_dot": 2.0, **start}, rtol=1e-11)


def test_invariants_along_a_run() -> None:
    run = spherical()
    assert list(run.invariants) == ["energy", "p_phi"] == list(pickle.loads(pickle.dumps(run)).invariants)
    np.testing.assert_allclose(run.invariants["energy"], run.energy, rtol=1e-12)
    momentum = 1.3 * 0.7**2 * np.sin(run[theta]) ** 2 * run[phi.dot]
    np.testing.assert_allclose(run.invariants["p_phi"], momentum, rtol=1e-12)
    kepler = lg.System(lg.kinetic_energy(m, (x, y)), -k / sqrt(x**2 + y**2), parameters={m: 1, k: 2})
    orbit = kepler.run(3.0, {x: 1.0, y.dot: 1.2}, rtol=1e-11)
    assert len(orbit.invariants) == 4
    for values in orbit.invariants.values():
        # Runge-Lenz vector along y is zero; the others are of order one.
        assert values.shape == orbit.t.shape and np.ptp(values) < 1e-8
    assert lg.System(m * x.dot**2, k * x**2 * cos(lg.t), parameters={m: 1, k: 1}).run(0.1).invariants == {}


def test_the_card_and_the_plot_have_the_momenta() -> None:
    run = spherical()
    assert "p_phi drift" in repr(run) and " of its largest term" in repr(run)
    titles = [axis.get_title(loc="left") for axis in run.plot().axes]
    assert "drift of p_phi relative to the largest term" in titles
    # From rest along phi the momentum is zero: its terms are the scale, and nothing is divided by zero.
    assert spherical(phi_dot=0.0).momentum_drift["p_phi"].max() == 0.0
    free = lg.System(sum(m * lg.coordinate(f"f{i}").dot ** 2 for i in range(5)), parameters={m: 1})
    card = repr(free.run(0.1))
    assert card.count(" drift ") == 4 and "2 in solution.invariants" in card


def test_a_card_does_not_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conserved, "_symmetries", None)
    assert "p_phi drift" in repr(spherical())
