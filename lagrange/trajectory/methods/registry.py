"""Table of all methods by name: built-in methods, methods of the user, and methods of installed packages."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.statement.display import text_table
from lagrange.statement.expression import flag
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.integrator import Claims, Integrator, entered
from lagrange.trajectory.methods import implicit, radau, runge_kutta, splitting, taylor, variational
from lagrange.trajectory.methods.runge_kutta import RungeKutta
from lagrange.trajectory.methods.splitting import Splitting
from lagrange.trajectory.methods.user_defined import StepMethod, step_method
from lagrange.trajectory.plan import locates_events
from lagrange.trajectory.tableaux.butcher import ButcherTableau

GROUP = "lagrange.integrators"
"""The entry-point group in which another package registers a method as `name = module:class`. The class is called
without arguments."""

FOREIGN_NAMES = {
    "rk45": "dopri5",
    "ode45": "dopri5",
    "rk23": "bs3",
    "ode23": "bs3",
    "ode89": "verner9",
    "ode113": "scipy-lsoda",
    "radau": "radau5",
    "bdf": "scipy-bdf",
    "lsoda": "scipy-lsoda",
    "ode15s": "scipy-bdf",
    "leap-frog": "leapfrog",
    "gauss4": "gauss2",
    "gauss6": "gauss3",
    "stormer-verlet": "verlet",
    "runge-kutta": "rk4",
}
"""Names of methods in other packages, each with the most similar method here, for the hint after an unknown name."""

FAMILIES = (runge_kutta, splitting, implicit, radau, variational, taylor)
"""The modules that define methods, in the order of the table."""

BUILT_IN: dict[str, Callable[..., Integrator]] = {
    name: maker for family in FAMILIES for name, maker in entered(family.__name__).items()
}
"""Constructor of each method of this package, called without arguments or with its options."""

_registered: dict[str, Callable[[], Integrator]] = {}
"""The methods passed to `register`, by name, in order."""

NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def register(name: str, method: Any, *, order: int | None = None, replaces: bool = False) -> None:
    """Register a method under a name, so that `method="name"` selects it in this process.

    `method` is a ButcherTableau, an instance of an integrator, its class, or a function that makes one and is called
    without arguments. With `order` it is a step function for `step_method`. With `replaces=True` the name may be the
    name of a registered method, which is replaced. Raises StatementError for an argument that is not a method, or whose
    claims are wrong.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise StatementError(
            f"name = {shown(name)}: give lower-case letters and digits, starting with a letter, with '-' between "
            "words, such as 'my-method'."
        )
    replaces = flag(replaces, "replaces")
    if name in BUILT_IN or name in _offered() or (name in _registered and not replaces):
        again = " Pass replaces=True to replace it." if name in _registered else ""
        raise StatementError(f"there is a method {name!r} already: give another name.{again}")
    _registered[name] = _maker(name, method, order)


def _maker(name: str, method: Any, order: int | None) -> Callable[[], Integrator]:
    """Return a function without arguments that makes the integrator of a registered `method`.

    One integrator is made and checked now. `method` and `order` are the arguments of `register`. Raises StatementError.
    """
    if order is not None:
        if isinstance(method, ButcherTableau) or callable(getattr(method, "integrate", None)):
            raise StatementError(
                f"order= is for step functions only, and {name} states its order itself: leave out order."
            )
        stepper = step_method(method, order=order, name=name)
        return lambda: stepper
    if isinstance(method, ButcherTableau):
        named = replace(method if method.dense else method.hermite(), name=name)
        return lambda: RungeKutta(named)
    if callable(getattr(method, "integrate", None)) and not isinstance(method, type):
        instance = find(replace(method, name=name) if isinstance(method, StepMethod) else method)
        return lambda: instance
    if not callable(method):
        raise StatementError(
            f"the method for the name {name!r} is {shown(method)}: give a ButcherTableau, an integrator, its class, "
            "or a step function with its order."
        )
    if _needed(method):
        raise StatementError(
            f"the method for the name {name!r} needs the arguments ({', '.join(_needed(method))}). If it is a step "
            "function, give order=. If it is a class, or makes an integrator, it is called without arguments: give "
            "them default values."
        )
    find(method())
    return lambda: find(method())


def _needed(method: Callable[..., Any]) -> list[str]:
    """Return the names of the required arguments of a function or class that a user registers as a method."""
    try:
        parameters = inspect.signature(method).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p.name for p in parameters if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]


@dataclass(frozen=True)
class MethodRow:
    """One row of the table of methods: the name of a method, its claimed properties, and a short description."""

    name: str
    claims: Claims
    about: str


class MethodTable(tuple[MethodRow, ...]):
    """The table of all methods with their claimed properties, one row each; it prints as text."""

    def __str__(self) -> str:
        return text_table(TITLES, self._cells("{}", "-"), right=(1, len(TITLES) - 2))

    __repr__ = __str__

    def _cells(self, name: str, no: str) -> list[list[str]]:
        """Return the texts of the cells of each row of the table.

        `name` is a format string for the names of methods, such as "{}". `no` is the text for a claim that a method
        does not make.
        """
        return [
            [
                *(name.format(row.name), str(row.claims.order), "adaptive" if row.claims.adaptive else "fixed"),
                *("yes" if holds(row.claims) else no for _, holds in MARKS),
                *(str(row.claims.dense or no), row.about),
            ]
            for row in self
        ]

    def to_markdown(self) -> str:
        """Return the table of methods as Markdown."""
        head, *lines = (f"| {' | '.join(row)} |" for row in (TITLES, *self._cells("`{}`", "")))
        return "\n".join([head, "|---" * len(TITLES) + "|", *lines])

    _repr_markdown_ = to_markdown


MARKS: tuple[tuple[str, Callable[[Claims], bool]], ...] = (
    ("symplectic", lambda claims: claims.symplectic),
    ("symmetric", lambda claims: claims.symmetric),
    ("energy", lambda claims: claims.energy),
    ("A-stable", lambda claims: claims.a_stable),
)
"""Columns of the table of methods that show whether a method makes a claim: heading, and test of the claims."""

TITLES = ["method", "order", "step", *(what for what, _ in MARKS), "dense", "about"]  # Headings of the table


def names() -> list[str]:
    """Return the names of all methods: built-in methods, methods of installed packages, and registered methods."""
    return [*BUILT_IN, *(name for name in sorted(_offered()) if name not in BUILT_IN), *_registered]


def find(method: Any) -> Integrator:
    """Return the integrator for a method as a user gives it.

    `method` is an integrator, which is returned unchanged, the name of a method, or a tableau, whose Runge-Kutta method
    is returned. Raises StatementError for anything else.
    """
    if isinstance(method, ButcherTableau):
        return RungeKutta(method)
    if not isinstance(method, str):
        if isinstance(method, type) or not callable(getattr(method, "integrate", None)):
            raise StatementError(
                f"method is {shown(method)}: give a name, such as '{DEFAULT_METHOD}', or an instance, such as "
                "lg.methods.RK4(step=0.01)."
            )
        if not isinstance(getattr(method, "claims", None), Claims):
            raise StatementError(
                f"method {shown(method)} has no attribute `claims`: give it one of type lg.Claims, with its order."
            )
        instance: Integrator = method
        return instance
    if method in BUILT_IN:
        return _built_in(method)
    if method in _registered:
        return _registered[method]()
    if method in _offered():
        integrator: Integrator = _loaded(method)()
        return integrator
    meant = FOREIGN_NAMES.get(method.lower())
    hint = f" Did you mean {meant!r}?" if meant else suggestion(method.lower(), names())
    raise StatementError(f"there is no method {shown(method)}; the methods are {listing(names(), 20)}.{hint}")


@cache
def _built_in(name: str) -> Integrator:
    """Return the built-in method `name` with default settings. One instance serves all runs: it has no state."""
    return BUILT_IN[name]()


def table() -> MethodTable:
    """Return the table of all methods: each with its name, its claimed properties, and a description."""
    rows = []
    for name in names():
        integrator = find(name)
        claims = replace(integrator.claims, events=locates_events(integrator))
        rows.append(MethodRow(name, claims, _about(name, integrator)))
    return MethodTable(rows)


def _about(name: str, integrator: Integrator) -> str:
    """Return the description of a method in the table of methods, one line without a full stop."""
    described: Any = BUILT_IN[name] if name in BUILT_IN else type(integrator)
    match integrator:
        case StepMethod():
            described = integrator.function
        case RungeKutta() if name in _registered:
            stages = integrator.tableau.stages
            return integrator.tableau.source or f"an explicit Runge-Kutta method of {stages} stages"
        case Splitting() if name in _registered:
            return integrator.source or "a composition of kicks and drifts"
    summary = next(iter((described.__doc__ or "").strip().splitlines()), "")
    return summary.removeprefix("Return ").rstrip(".")


@cache
def _loaded(name: str) -> Callable[[], Integrator]:
    """Return the constructor of another package's method `name`. It is cached, since loading takes as long as a run."""
    loaded: Callable[[], Integrator] = _offered()[name].load()
    return loaded


@cache
def _offered() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}
