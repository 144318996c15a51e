"""The edge of the domain of the equations: where steps shrink to nothing before anything is NaN."""

from __future__ import annotations

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.model import Model

DOMAIN_PROBE = 1e-6
"""Fraction of the run by which the right-hand side is evaluated ahead of a step that shrank to nothing.

It shows whether the equations lose their value there.
"""


def slope_ahead(model: Model, t: float, y: FloatArray, parameters: FloatArray, length: float) -> FloatArray:
    """Return the right-hand side a little ahead, for a run of a length; ones if the mass matrix is singular there.

    Near the edge of the domain of a root or a logarithm, steps shrink before anything is NaN.
    """
    kernel, h = model.kernel("rhs"), DOMAIN_PROBE * length
    with np.errstate(all="ignore"):
        try:
            return kernel(t + h, y + h * kernel(t, y, parameters), parameters)
        except SingularMassMatrix:
            return np.ones_like(y)
