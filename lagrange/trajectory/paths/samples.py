"""Times between the steps of a run, at which its dense output is sampled."""

from __future__ import annotations

import numpy as np

from lagrange.machine.backend import FloatArray


def divided(t: FloatArray, parts: int) -> FloatArray:
    """Return times (K,) that divide every interval of `t` into `parts` equal parts."""
    if len(t) < 2 or parts < 2:
        return t
    inner = t[:-1, None] + np.arange(parts) / parts * np.diff(t)[:, None]
    return np.append(inner.ravel(), t[-1])
