"""Linear stability from steps themselves: published limits, claims, and what runs do."""

from __future__ import annotations

import math

import numpy as np
import pytest

import lagrange as lg
from lagrange.evidence.method_stability import growth, stability, step_of
from lagrange.show.figures import dynamics_figures
from lagrange.trajectory.methods.registry import BUILT_IN, find
from lagrange.trajectory.methods.splitting import Splitting

STEPS = [name for name in BUILT_IN if name != "taylor"]
DAMPED = [name for name in STEPS if not isinstance(find(name), Splitting)]


@pytest.mark.parametrize(
    ("name", "real", "imaginary"),
    [
        ("euler", 2.0, 0.0),
        ("midpoint", 2.0, 0.0),
        ("bs3", 2.5127, math.sqrt(3)),
        ("rk4", 2.7853, math.sqrt(8)),
        ("dopri5", 3.3066, 0.9972),
        ("trapezoidal", math.inf, math.inf),
    ],
)
def test_published_limits(name: str, real: float, imaginary: float) -> None:
    """Hairer, Wanner, Solving ODE II, IV.2: figures 2.1 and 2.2, and the polynomials 1 + z + ... + z^s / s!.

    The imaginary axis is unstable from the start for orders 1 and 2, by y^2/2 and y^4/8.
    """
    found = stability(name)
    assert found.real == pytest.approx(real, rel=1e-4)
    assert found.imaginary == pytest.approx(imaginary, rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("name", ["symplectic-euler", "verlet", "velocity-verlet", "leapfrog", "forest-ruth4"])
def test_splittings_on_the_imaginary_axis(name: str) -> None:
    """Stormer-Verlet up to 2; the triple jump up to 1.5734 (Hairer, Lubich, Wanner, Geometric Integration, VIII.4)."""
    found = stability(name)
    assert math.isnan(found.real)
    assert found.imaginary == pytest.approx(1.5734 if name == "forest-ruth4" else 2.0, rel=1e-4)


@pytest.mark.parametrize("name", DAMPED)
def test_a_stable_methods_are_those_that_claim_it(name: str) -> None:
    angles = np.linspace(math.pi / 2, 0.999 * math.pi, 60)
    plane = 10.0 ** np.linspace(-3, 4, 60)[:, None] * np.exp(1j * angles)
    assert find(name).claims.a_stable == bool((growth(name, plane) < 1 + 1e-9).all())


@pytest.mark.few(9)
@pytest.mark.parametrize("name", DAMPED)
def test_the_matrix_is_what_a_step_does(name: str) -> None:
    """Against the compiled step on the same oscillator, taken once from both unit vectors, if it has no memory."""
    step, z = step_of(name), -0.3 + 0.8j
    if step.starter is not None or step.control is not None:
        pytest.skip("two steps at once, or steps of its own")
    x = lg.coordinate("x")
    damped = lg.System(kinetic=x.dot**2 / 2, potential=abs(z) ** 2 * x**2 / 2, forces={x: 2 * z.real * x.dot})
    flow = lg.flow(damped.compile(), method=name, step=1.0)
    matrix = np.array([flow(unit, 0.0, 1.0) for unit in np.eye(2)]).T
    assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(growth(name, z), rel=1e-12)


def test_what_has_no_stability() -> None:
    with pytest.raises(lg.StatementError, match="taylor has no fixed step function"):
        stability("taylor")
    with pytest.raises(lg.StatementError, match="verlet moves coordinates and velocities in turn, without damping"):
        growth("verlet", -1.0)
    with pytest.raises(lg.StatementError, match="verlet moves coordinates and velocities in turn, without damping"):
        lg.methods.plot_stability("rk4", "verlet")
    with pytest.raises(lg.StatementError, match="name at least one"):
        lg.methods.plot_stability()


def test_the_picture_of_regions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamics_figures, "_POINTS", 41)
    figure = lg.methods.plot_stability("rk4", "radau5")
    (axis,) = figure.axes
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["rk4", "radau5"]


def test_a_pole_is_infinite_growth() -> None:
    """Backward Euler is 1/(1 - z), and one pole among many rates does not take the others with it."""
    found = growth("backward-euler", [1.0, -1.0, 3.0])
    assert found == pytest.approx([math.inf, 1 / 1.99, 1 / 1.97])


@pytest.mark.parametrize("name", DAMPED)
def test_every_method_can_be_drawn(name: str) -> None:
    x, y = np.meshgrid(np.linspace(-4, 4, 9), np.linspace(0, 4, 5))
    found = growth(name, x + 1j * y)
    assert (found >= 0).all() and np.isfinite(found).any()


@pytest.mark.parametrize("name", ["heun", "midpoint", "euler"])
def test_what_amplifies_from_the_start_is_stable_nowhere(name: str) -> None:
    assert stability(name).imaginary == 0.0
