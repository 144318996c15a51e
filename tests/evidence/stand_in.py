"""A model computed by SymPy alone, with deliberate faults that the check must find."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp

from lagrange.errors import RunError
from lagrange.statement.coordinate import t
from lagrange.statement.parameters import parameter_values
from lagrange.statement.statement import Statement

Break = Callable[[list[Any]], list[Any]]
"""Takes the entries of a quantity as SymPy expressions in plain symbols, and returns wrong ones."""

SHAPES: dict[str, Callable[[int], tuple[int, ...]]] = {
    "lagrangian": lambda n: (),
    "energy": lambda n: (),
    "mass_matrix": lambda n: (n, n),
    "jacobian": lambda n: (2 * n, 2 * n),
    "rhs": lambda n: (2 * n,),
}


class StandIn:
    """A replacement for Model. `breaks` maps a quantity to its fault, and `late` changes numbers after evaluation."""

    def __init__(
        self,
        statement: Statement,
        breaks: Mapping[str, Break] | None = None,
        late: Callable[[str, Any], Any] | None = None,
        target: str = "stand-in",
    ) -> None:
        self.statement = statement
        self.target = target
        self.dimension = len(statement.coordinates)
        self.equations = SimpleNamespace(first_order=(), settled=False)
        self.late = late or (lambda name, value: value)
        self.calls: list[str] = []
        plain = dict(statement.plain)
        self.q = [plain[q] for q in statement.coordinates]
        self.v = [plain[v] for v in statement.velocities]
        self.breaks = dict(breaks or {})
        self.expressions = self._derive(plain)
        symbols = [*self.q, *self.v, t, *statement.parameters]
        self.functions: dict[str, list[Any]] = {
            name: [sp.lambdify(symbols, entry, "numpy") for entry in entries]
            for name, entries in self.expressions.items()
        }

    def _derive(self, plain: Mapping[Any, Any]) -> dict[str, list[Any]]:
        s, q, v, n = self.statement, self.q, self.v, self.dimension

        def broken(name: str, entries: list[Any]) -> list[Any]:
            return self.breaks[name](entries) if name in self.breaks else entries

        lagrangian, dissipation, *loads = (part.xreplace(plain) for part in (s.lagrangian, s.dissipation, *s.forces))
        (lagrangian,) = broken("lagrangian", [lagrangian])
        p = broken("momenta", [sp.diff(lagrangian, b) for b in v])
        f = [sp.diff(lagrangian, a) + load - sp.diff(dissipation, b) for a, b, load in zip(q, v, loads, strict=True)]
        f = broken("forces", f)
        mass = [sp.diff(a, b) for a in p for b in v]
        rates = [sum((sp.diff(a, x) * y for x, y in zip(q, v, strict=True)), sp.diff(a, t)) for a in p]
        bias = broken("bias", [a - b for a, b in zip(f, rates, strict=True)])
        a = broken("accelerations", list(sp.Matrix(n, n, mass).LUsolve(sp.Matrix(bias))))
        energy = broken("energy", [sum((x * y for x, y in zip(v, p, strict=True)), -lagrangian)])
        rhs = broken("rhs", [*v, *a])
        jacobian = broken("jacobian", [sp.diff(entry, b) for entry in rhs for b in (*q, *v)])
        return {
            "lagrangian": [lagrangian],
            "momenta": p,
            "forces": f,
            "mass_matrix": broken("mass_matrix", mass),
            "bias": bias,
            "accelerations": a,
            "energy": energy,
            "rhs": rhs,
            "jacobian": jacobian,
        }

    def evaluate(self, name: str, q: Any, v: Any, time: Any = 0.0, parameters: Mapping[Any, Any] | None = None) -> Any:
        self.calls.append(name)
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        values = parameter_values(parameters, self.statement.parameters, self.statement.defaults)
        batch = q.shape[1:]
        arguments = [*q, *v, np.broadcast_to(time, batch)[()], *(values[s] for s in self.statement.parameters)]
        with np.errstate(all="ignore"):
            entries: list[Any] = [f(*arguments) for f in self.functions[name]]
        rows: list[Any] = [np.broadcast_to(entry, batch) for entry in entries]
        out = np.array(rows, dtype=float)
        shape = SHAPES[name](self.dimension) if name in SHAPES else (self.dimension,)
        return self.late(name, out.reshape(shape + batch)[()])

    def accelerations(self, q: Any, v: Any, time: Any = 0.0, parameters: Any = None) -> Any:
        return self.evaluate("accelerations", q, v, time, parameters)

    def kernel(self, name: str) -> str:
        return name

    def called(self, kernel: str, time: Any, y: Any, parameters: Any = None) -> Any:
        return self.evaluate(kernel, y[: self.dimension], y[self.dimension :], time, parameters)

    def jacobian(self, time: Any, y: Any, parameters: Any = None) -> Any:
        return self.evaluate("jacobian", y[: self.dimension], y[self.dimension :], time, parameters)


class Refusing(StandIn):
    """A model that reports every mass matrix as singular."""

    def accelerations(self, q: Any, v: Any, time: Any = 0.0, parameters: Any = None) -> Any:
        raise RunError("the mass matrix is singular")
