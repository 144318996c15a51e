"""The names that the tests of the text reader declare."""

from typing import Any

import sympy

from lagrange.statement.coordinate import coordinate, velocity_of

x, y = coordinate("x"), coordinate("y")
v = velocity_of(x)
ODD = ["E", "S", "N", "I", "Q", "O", "gamma", "beta", "zeta", "lamda", "pi_0", "m2"]
PARAMETERS = {name: sympy.Symbol(name, real=True) for name in ["m", "g", "k", *ODD]}
NAMES: dict[str, Any] = {"x": x, "y": y, "x_dot": v, **PARAMETERS}
m, g, k = (PARAMETERS[name] for name in ("m", "g", "k"))
