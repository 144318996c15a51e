"""A point on a line whose acceleration may fail, for tests of solvers of other packages."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from sympy import Integer

from lagrange.equations.euler_lagrange import StateLayout
from lagrange.graph.node import Graph
from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.integrator import Problem


class Called:
    """A function of (t, y, parameters) as a kernel, without quick calls."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, t: float, y: Any, parameters: Any) -> Any:
        return self.function(t, y, parameters)

    def quick(self, parameters: Any) -> None:
        """Return None: there are no quick calls."""


class Point:
    """A fake model: one coordinate x with the acceleration a(t, x, v)."""

    statement = SimpleNamespace(
        names=("x",), parameters=(), lagrangian=Integer(0), dissipation=Integer(0), forces=(), rotations=()
    )
    layout = StateLayout(("x",), ("x",))
    equations = SimpleNamespace(
        structure=SimpleNamespace(brief=False), constraints=(), accelerations=(), graph=Graph(), settled=False
    )

    def __init__(self, acceleration: Any) -> None:
        self.acceleration = acceleration

    def kernel(self, name: str) -> Any:
        return Called(self.rhs if name == "rhs" else self.jacobian)

    def parameter_array(self, parameters: Any) -> Any:
        return np.array(list(parameters.values()))

    def rhs(self, t: float, y: Any, parameters: Any = None) -> Any:
        return np.array([y[1], self.acceleration(t, y[0], y[1])])

    def column_without_inertia(self, t: float, q: Any, v: Any, parameters: Any) -> None:
        """Return None: the point has a mass."""

    def jacobian(self, t: float, y: Any, parameters: Any = None) -> Any:
        columns = []
        for j in range(2):
            h = 1e-6 * max(1.0, abs(y[j]))
            e = np.eye(2)[j] * h
            columns.append((self.rhs(t, y + e) - self.rhs(t, y - e)) / (2 * h))
        return np.array(columns).T


def oscillator(t: float, x: float, v: float) -> float:
    return -x


def problem(acceleration: Any, t1: float = 2.0, y0: Any = (1.0, 0.0), **options: Any) -> Any:
    model: Any = Point(acceleration)
    given: dict[str, Any] = {"t0": 0.0, "max_wall": 1000.0, "max_steps": 20_000, "rtol": 1e-8, "atol": 1e-10}
    return Problem(model=model, parameters={}, t1=t1, y0=np.array(y0, dtype=float), **(given | options))


def double_pole(t: float, x: float, v: float) -> float:
    return 6 * x * x


class Singular(Point):
    """A point whose mass matrix is singular for x < 0.5."""

    def rhs(self, t: float, y: Any, parameters: Any = None) -> Any:
        if not y[0] >= 0.5:
            raise SingularMassMatrix
        return super().rhs(t, y)

    def singular_message(self, t: float, y: Any, column: Any, parameters: Any) -> str:
        return f"the mass matrix of the clock is singular at x = {y[0]:.1f}."
