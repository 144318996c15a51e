"""Every method by name: ours, and those that installed packages offer by entry point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from lagrange.errors import StatementError, listing, suggestion
from lagrange.trajectory.integrator import Claims, Integrator
from lagrange.trajectory.methods.explicit import BS3, DOP853, RK4, Dopri5, Euler, Heun, Midpoint, Tsit5, Verner9
from lagrange.trajectory.methods.implicit import BDF2, BackwardEuler, Gauss2, Gauss3, ImplicitMidpoint, Trapezoidal
from lagrange.trajectory.methods.radau import Radau3, Radau5
from lagrange.trajectory.methods.splitting import (
    Composition8,
    ForestRuth4,
    Leapfrog,
    Ruth3,
    SymplecticEuler,
    SymplecticEulerB,
    VelocityVerlet,
    Verlet,
    Yoshida6,
)
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.methods.variational import (
    DiscreteGradient,
    Galerkin4,
    Galerkin6,
    VariationalMidpoint,
    VariationalTrapezoid,
)
from lagrange.trajectory.plan import promises

GROUP = "lagrange.integrators"
"""The entry-point group in which a package registers `name = module:class`; the class is called without arguments."""

DEFAULT = "taylor"
"""The method of a run that names none: at errors of 1e-6 and below it needs the least time of those here
(docs/benchmarks/race.md)."""

BUILT_IN: dict[str, Callable[[], Integrator]] = {
    "euler": Euler,
    "heun": Heun,
    "midpoint": Midpoint,
    "rk4": RK4,
    "bs3": BS3,
    "dopri5": Dopri5,
    "tsit5": Tsit5,
    "verner9": Verner9,
    "dop853": DOP853,
    "symplectic-euler": SymplecticEuler,
    "symplectic-euler-b": SymplecticEulerB,
    "verlet": Verlet,
    "velocity-verlet": VelocityVerlet,
    "leapfrog": Leapfrog,
    "ruth3": Ruth3,
    "forest-ruth4": ForestRuth4,
    "yoshida6": Yoshida6,
    "composition8": Composition8,
    "backward-euler": BackwardEuler,
    "trapezoidal": Trapezoidal,
    "implicit-midpoint": ImplicitMidpoint,
    "gauss2": Gauss2,
    "gauss3": Gauss3,
    "radau3": Radau3,
    "radau5": Radau5,
    "bdf2": BDF2,
    "variational-midpoint": VariationalMidpoint,
    "variational-trapezoid": VariationalTrapezoid,
    "galerkin4": Galerkin4,
    "galerkin6": Galerkin6,
    "discrete-gradient": DiscreteGradient,
    "taylor": Taylor,
}


@dataclass(frozen=True)
class Row:
    """One line of the table of methods."""

    name: str
    claims: Claims
    about: str


class Table(tuple[Row, ...]):
    """The methods with their claims; prints as a table."""

    def __str__(self) -> str:
        head = f"{'method':<18}{'order':>5}  {'step':<9}{'symplectic':<12}{'symmetric':<11}{'A-stable':<10}about"
        lines = [head, "-" * len(head)]
        for row in self:
            claims = row.claims
            marks = ["yes" if mark else "-" for mark in (claims.symplectic, claims.symmetric, claims.a_stable)]
            kind = "adaptive" if claims.adaptive else "fixed"
            lines.append(
                f"{row.name:<18}{claims.order:>5}  {kind:<9}{marks[0]:<12}{marks[1]:<11}{marks[2]:<10}{row.about}"
            )
        return "\n".join(lines)

    def __repr__(self) -> str:
        return str(self)

    def to_markdown(self) -> str:
        """Return the table for a page."""
        lines = [
            "| method | order | step | symplectic | symmetric | A-stable | about |",
            "|---|---|---|---|---|---|---|",
        ]
        for row in self:
            c = row.claims
            marks = " | ".join("yes" if mark else "" for mark in (c.symplectic, c.symmetric, c.a_stable))
            kind = "adaptive" if c.adaptive else "fixed"
            lines.append(f"| `{row.name}` | {c.order} | {kind} | {marks} | {row.about} |")
        return "\n".join(lines)


def names() -> list[str]:
    """Return the name of every method that is here."""
    return [*BUILT_IN, *(name for name in sorted(_offered()) if name not in BUILT_IN)]


def find(method: Any) -> Integrator:
    """Return the integrator of a registered name, or the instance itself. Raises StatementError for another."""
    if not isinstance(method, str):
        if isinstance(method, type) or not callable(getattr(method, "integrate", None)):
            raise StatementError(
                f"method is {method!r}: give a name, such as '{DEFAULT}', or an instance, such as "
                "lg.methods.RK4(step=0.01)."
            )
        if not isinstance(getattr(method, "claims", None), Claims):
            raise StatementError(
                f"method {method!r} has no claims: give it a `claims` of type lg.Claims, such as its order."
            )
        instance: Integrator = method
        return instance
    if method in BUILT_IN:
        return BUILT_IN[method]()
    if method in _offered():
        made: Integrator = _offered()[method].load()()
        return made
    raise StatementError(
        f"there is no method {method!r}; the methods are {listing(names())}." + suggestion(method, names())
    )


def table() -> Table:
    """Return every method with its claims."""
    rows = []
    for name in names():
        integrator = find(name)
        summary = ((BUILT_IN[name] if name in BUILT_IN else type(integrator)).__doc__ or "").splitlines()
        about = summary[0] if summary else ""
        rows.append(Row(name, promises(integrator), about.removeprefix("Return ").rstrip(".")))
    return Table(rows)


@cache
def _offered() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}
