"""Small statements for the tests of this folder, and a model with deliberate faults that the check must find."""

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp
from sympy import cos

from lagrange.errors import RunError
from lagrange.statement.coordinate import coordinate, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.parameters import parameter_values
from lagrange.statement.statement import Statement
from tests.models import bead_on_hoop, charge

theta, x, y, z, r, phi = (coordinate(name) for name in ("theta", "x", "y", "z", "r", "phi"))
m, g, length, k, c, omega = parameters("m g l k c omega")


def pendulum(**more: Any) -> Statement:
    return declare(
        kinetic=m * length**2 * theta.dot**2 / 2,
        potential=-m * g * length * cos(theta),
        parameters={m: 1.0, g: 9.81, length: 1.0},
        name="pendulum",
        **more,
    )


def pulled_pendulum() -> Statement:
    """Return a pendulum whose string becomes shorter, so that the momentum depends on time."""
    string = length * sp.exp(-omega * t)
    return declare(kinetic=m * string**2 * theta.dot**2 / 2, potential=-m * g * string * cos(theta), name="pulled")


def driven_oscillator() -> Statement:
    """Return an oscillator with force, dissipation and explicit time; the default of c is 0."""
    return declare(
        kinetic=m * (x.dot**2 + y.dot**2 + x.dot * y.dot) / 2,
        potential=k * x**2 / 2 + k * sp.exp(x - y),
        forces={x: sp.sin(omega * t) - c * y, y: length * x.dot},
        dissipation=c * (x.dot - y.dot) ** 2 / 2 + c * y.dot**4,
        parameters={m: 1.0, k: 1.0, c: 0.0, omega: 1.0, length: 1.0},
        name="oscillator",
    )


def contact() -> Statement:
    """Return a spring that acts only beyond x = 10, where no random point of order one is."""
    spring = sp.Piecewise((k * (x - 10) ** 2 / 2, x > 10), (0, True))
    return declare(kinetic=m * x.dot**2 / 2, potential=spring + m * g * x, name="contact")


def guarded_root() -> Statement:
    """Return a system with a Piecewise whose other branch has no value."""
    well = sp.Piecewise((sp.sqrt(x) ** 3, x > 0), (x**2, True))
    return declare(kinetic=m * x.dot**2 / 2, potential=well, name="guarded")


def relativistic() -> Statement:
    """Return a relativistic particle: L is not quadratic in the velocity, and is defined below the speed of light."""
    return declare(lagrangian=-m * c**2 * sp.sqrt(1 - x.dot**2 / c**2) - k * x**2 / 2, parameters={c: 3.0}, name="fast")


def half_line() -> Statement:
    return declare(kinetic=m * x.dot**2 / 2, potential=k * sp.log(x) + sp.sqrt(length - x), name="half line")


def kepler() -> Statement:
    return declare(kinetic=m * (r.dot**2 + r**2 * phi.dot**2) / 2, potential=-k * m / r, name="kepler")


def earth_and_moon() -> Statement:
    """Return two bodies in SI units, with numbers between 1e-11 and 1e30."""
    gravity, earth, moon = parameters("G earth moon")
    qs = [coordinate(name) for name in ("xe", "ye", "xm", "ym")]
    distance = sp.sqrt((qs[0] - qs[2]) ** 2 + (qs[1] - qs[3]) ** 2)
    return declare(
        kinetic=earth * (qs[0].dot ** 2 + qs[1].dot ** 2) / 2 + moon * (qs[2].dot ** 2 + qs[3].dot ** 2) / 2,
        potential=-gravity * earth * moon / distance,
        parameters={gravity: 6.6743e-11, earth: 5.972e24, moon: 7.342e22},
        initial={qs[0]: 1.496e11, qs[2]: 1.496e11 + 3.844e8, "ye_dot": 29780.0, "ym_dot": 30802.0},
        name="earth and moon",
    )


ALL = (
    *(pendulum, charge, bead_on_hoop, pulled_pendulum, driven_oscillator, contact, guarded_root, relativistic),
    *(half_line, kepler, earth_and_moon),
)


# --- A model computed by SymPy alone, with deliberate faults that the check must find --------------------------


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
        self.equations = SimpleNamespace(first_order=(), rates_are_solved=False)
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
