"""A free body as a unit quaternion, against Jacobi's elliptic functions over a hundred flips about its middle axis."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ellipj, ellipk

import lagrange as lg
from tests.models import shared_scene

FLIPS = 100


def body_rates(state: Any) -> Any:
    """Return the angular velocity in the body, 2 conj(q) q', (3, K)."""
    (w, x, y, z), (dw, dx, dy, dz) = np.split(state, 2)
    return 2 * np.array(
        [w * dx - x * dw - y * dz + z * dy, w * dy - y * dw - z * dx + x * dz, w * dz - z * dw - x * dy + y * dx]
    )


def elliptic(times: Any, inertias: Any, spin: Any) -> Any:
    """Return the angular velocity in the body, (3, K), from a spin (a, b, 0) with L^2 < 2 E I2, and the time of a flip.

    Source: L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed. (1976), section 37, with the axes 1 and 3 exchanged.
    """
    I1, I2, I3 = inertias
    energy, square = inertias @ spin**2 / 2, inertias**2 @ spin**2
    assert square < 2 * energy * I2
    first = np.sqrt((2 * energy * I3 - square) / (I1 * (I3 - I1)))
    second = np.sqrt((square - 2 * energy * I1) / (I2 * (I2 - I1)))
    third = np.sqrt((square - 2 * energy * I1) / (I3 * (I3 - I1)))
    speed = np.sqrt((I2 - I1) * (2 * energy * I3 - square) / (I1 * I2 * I3))
    m = (I3 - I2) * (square - 2 * energy * I1) / ((I2 - I1) * (2 * energy * I3 - square))
    quarter = ellipk(m) / speed
    sn, cn, dn, _ = ellipj(speed * (times + quarter), m)
    return np.array([first * dn, second * sn, third * cn]), 2 * quarter


def test_a_hundred_flips_are_elliptic_functions() -> None:
    """A rounding at a flip grows by some e^5 until the next; what is conserved keeps errors to their phase."""
    scene = shared_scene("free-flip")
    values = {symbol.name: number for symbol, number in scene.statement.defaults.items()}
    inertias = np.array([values["I1"], values["I2"], values["I3"]])
    start = np.array(scene.statement.initial)
    spin = body_rates(start[:, None])[:, 0]
    assert spin[2] == 0.0
    _, flip = elliptic(0.0, inertias, spin)
    times = np.linspace(0.0, FLIPS * flip, 501)
    solution = scene.run(times[-1], rtol=1e-13, t_eval=times)
    assert solution.status is lg.Status.SUCCESS
    expected, _ = elliptic(times, inertias, spin)
    assert np.abs(body_rates(solution.y) - expected).max() <= 1e-8
    assert np.abs((solution.y[:4] ** 2).sum(axis=0) - 1).max() <= 1e-14
    assert np.count_nonzero(np.diff(np.sign(body_rates(solution.y)[1]))) == FLIPS
