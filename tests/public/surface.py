"""All public callables of the package, and valid arguments for each of them."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import sympy

import lagrange as lg
from lagrange.evidence.report import Report
from lagrange.show.dynamics import Bifurcation, EquilibriumBranches, PhasePortrait, PoincareSection, ShownModes
from lagrange.statement.scene.library import LIBRARY
from lagrange.trajectory.methods.registry import MethodTable
from lagrange.trajectory.run import Flow


@cache
def system() -> lg.System:
    x, y = lg.coordinates("x y")
    m, k = lg.parameters("m k")
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=k * (x**2 + y**2) / 2,
        parameters={m: 1.0, k: 2.0},
        initial={x: 1.0},
        positions={"bob": (x, y)},
        name="bob",
    )


@cache
def model() -> lg.Model:
    return system().compile("numpy")


@cache
def solution() -> lg.Solution:
    return lg.integrate(model(), (0.0, 0.5), method="rk4", step=0.1)


@cache
def held() -> lg.System:
    """Return a system with a constraint, for the methods that need one."""
    x, y = lg.coordinates("x y")
    m = lg.parameters("m")
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        parameters={m: 1.0},
        constraints={"rod": x + 2 * y - 1},
        initial={x: 1.0},
        positions={"bob": (x, y)},
        name="held",
    )


@cache
def race() -> lg.Race:
    x = system().coordinates[0]
    end = np.cos(np.sqrt(2.0) * 0.1), 0.0, -np.sqrt(2.0) * np.sin(np.sqrt(2.0) * 0.1), 0.0
    return lg.race(model(), 0.1, {x: 1.0}, methods=["rk4"], steps=[0.01], repeats=1, reference=end)


@cache
def slowed() -> lg.System:
    """Return a system that comes to rest, with an angle, for the records of its dynamics."""
    x = lg.coordinate("x")
    m = lg.parameters("m")
    potential = -sympy.cos(x)
    return lg.System(kinetic=m * x.dot**2 / 2, potential=potential, forces={x: -x.dot}, parameters={m: 1.0}, name="bob")


def few() -> dict[Any, Any]:
    """Return a small grid of initial states."""
    x = slowed().coordinates[0]
    return {x: (0.5, 3.0, 2), x.dot: (0.0, 3.0, 2)}


DYNAMICS: dict[type, Callable[[], Any]] = {
    PhasePortrait: cache(lambda: lg.phase_portrait(slowed(), starts=[{"x": 1.0}])),
    PoincareSection: cache(lambda: lg.poincare(slowed(), lg.coordinate("x"), [{"x": 1.0}], crossings=3, longest=9.0)),
    Bifurcation: cache(lambda: lg.bifurcation(slowed(), "m", [1.0, 2.0], section=1.0, points=2, skip=1)),
    EquilibriumBranches: cache(lambda: lg.bifurcation(slowed(), "m", [1.0, 2.0])),
    ShownModes: cache(lambda: slowed().modes()),
}
"""What functions of dynamics return."""


def problem() -> lg.Problem:
    y0 = np.array([1.0, 0.0, 0.0, 0.0])
    return lg.Problem(model(), model().parameter_values(), 0.0, 0.1, y0)


@cache
def flow() -> Flow:
    return lg.flow(model(), method="rk4", step=0.1)


@cache
def report() -> Report:
    return system().check(points=1)


INSTANCES: dict[type, Callable[[], Any]] = {
    lg.System: system,
    lg.Model: model,
    lg.Solution: solution,
    lg.Race: race,
    lg.Problem: problem,
    lg.Trajectory: lambda: solution().trajectory,
    lg.Event: lambda: lg.event(system().coordinates[0]),
    lg.Claims: lambda: lg.Claims(order=4),
    lg.Ensemble: lambda: lg.ensemble(model(), 0.1, {system().coordinates[0]: [1.0, 2.0]}),
    lg.TrustHorizon: lambda: lg.trust_horizon(model(), (0.0, 0.1)),
    lg.methods.ButcherTableau: lambda: lg.methods.RK4().tableau,
    lg.methods.RungeKutta: lg.methods.RK4,
    lg.methods.ImplicitMethod: lg.methods.Gauss2,
    lg.methods.Splitting: lg.methods.Verlet,
    lg.methods.Taylor: lg.methods.Taylor,
    lg.methods.StepMethod: lambda: lg.methods.step_method(euler, order=1),
    lg.methods.Stability: lambda: lg.methods.stability("euler"),
    lg.methods.CVODE: lg.methods.CVODE,
    lg.methods.ScipyRK45: lg.methods.ScipyRK45,
    lg.methods.ScipyRK23: lg.methods.ScipyRK23,
    lg.methods.ScipyDOP853: lg.methods.ScipyDOP853,
    lg.methods.ScipyRadau: lg.methods.ScipyRadau,
    lg.methods.ScipyBDF: lg.methods.ScipyBDF,
    lg.methods.ScipyLSODA: lg.methods.ScipyLSODA,
    Flow: flow,
    **DYNAMICS,
    Report: report,
    MethodTable: lg.methods.table,
}
"""An instance of every public class, and of what public functions return that can be called in its turn."""


def euler(f: Any, t: Any, y: Any, h: Any) -> Any:
    return y + f(t, y) * h


@dataclass(frozen=True)
class Public:
    """A public callable: its name, how to get it, and its parameters without `self`."""

    name: str
    get: Callable[[], Callable[..., Any]]
    parameters: tuple[inspect.Parameter, ...]


@cache
def exported() -> dict[str, Any]:
    """Return what `lagrange` and `lagrange.methods` export, by name."""
    result = {f"lg.{name}": getattr(lg, name) for name in lg.__all__ if name != "__version__"}
    return result | {f"lg.methods.{name}": getattr(lg.methods, name) for name in lg.methods.__all__}


def classes() -> list[type]:
    """Return the public classes of which there are instances."""
    result = [value for value in exported().values() if isinstance(value, type) and is_made(value)]
    return [*dict.fromkeys([*result, *INSTANCES])]


def is_made(kind: type) -> bool:
    """Return True if users call the class: it is no error, enumeration or protocol."""
    return not issubclass(kind, (Exception, Enum)) and kind is not lg.Integrator


SPECIAL = ("__call__", "__getitem__")


RESULTS = lg.Model, lg.Solution, lg.Race, lg.Ensemble, lg.TrustHorizon, lg.methods.Stability
"""Classes that functions return and nobody else makes: their constructors do not look at what they are given."""


def surface() -> list[Public]:
    """Return all public callables: functions, methods, class methods, and constructors except those of `RESULTS`."""
    result = []
    for name, value in exported().items():
        if callable(value) and value not in RESULTS and (not isinstance(value, type) or is_made(value)):
            result.append(Public(name, partial(itself, value), parameters(value)))
    for kind in classes():
        for name, member in inspect.getmembers(kind, callable):
            if (not name.startswith("_") or name in SPECIAL) and not isinstance(member, type) and is_ours(kind, name):
                if find_spec(NEEDS.get(f"{kind.__name__}.{name}", "lagrange")) is None:
                    continue
                get = partial(method, kind, name)
                result.append(Public(f"{kind.__name__}.{name}", get, parameters(get())))
    return result


def itself(function: Callable[..., Any]) -> Callable[..., Any]:
    return function


def method(kind: type, name: str) -> Callable[..., Any]:
    """Return a method of the instance of a class."""
    make = HELD.get(f"{kind.__name__}.{name}", INSTANCES[kind])
    bound: Callable[..., Any] = getattr(make(), name)
    return bound


def is_ours(kind: type, name: str) -> bool:
    """Return True if a method is defined in this package."""
    return next(base for base in kind.__mro__ if name in vars(base)).__module__.startswith("lagrange.")


def parameters(function: Callable[..., Any]) -> tuple[inspect.Parameter, ...]:
    if function is lg.Status:
        function = lg.Status._missing_  # the signature of an enumeration is that of its metaclass
    return tuple(inspect.signature(function).parameters.values())


def sound(folder: Path) -> dict[str, Any]:
    """Return a valid argument for a parameter, by the name of the parameter."""
    x, y = system().coordinates
    m, k = lg.parameters("m k")
    stated: dict[str, Any] = {
        "A": [[0, 0], ["1/2", 0]],
        "a": (x, y),
        "argument": x,
        "angular_velocity": [x.dot, y.dot],
        "b": [0, 1],
        "claims": lg.Claims(order=1, explicit=False),
        "coefficients": [1.0],
        "coordinates": [x, y],
        "event": x,
        "starts": [{x: 1.0, y: 0.5}],
        "window": {x: (-1, 1, 3), x.dot: (-1, 1, 3)},
        "derived": [m * x.ddot + k * x, m * y.ddot + k * y],
        "expression": x - y,
        "forces": {x: -x.dot},
        "function": euler,
        "given": {m: 2.0},
        "inertia": [m, k],
        "initial": {x: 1.0},
        "key": x,
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "mass": m,
        "model": model(),
        "name": "rhs",
        "names": "p q",
        "nodes": model().equations.q,
        "order": 1,
        "parameters": {m: 2.0},
        "position": (x, y),
        "positions": {"bob": (x, y)},
        "potential": k * x**2 / 2,
        "problem": problem(),
        "sliders": {m: (0.5, 4.0), x.dot: (-1, 1)},
        "statement": system().statement,
        "stages": ((1.0, 1.0),),
        "stiffness": k,
        "system": system(),
        "tableau": lg.methods.RK4().tableau,
    }
    return stated | numbers(folder)


def numbers(folder: Path) -> dict[str, Any]:
    """Return a list without its expressions and records."""
    return {
        "check": False,
        "dpi": 20,
        "error": 1e-3,
        "events": [system().coordinates[0]],
        "max_steps": 1000,
        "method": "rk4",
        "methods": ["rk4"],
        "path": folder / "file",
        "points": 1,
        "q": [0.1, 0.2],
        "reference": [1.0, 0.0, 0.0, 0.0],
        "repeats": 1,
        "span": (0.0, 0.1),
        "step": 0.05,
        "steps": [0.05],
        "t": 0.0,
        "t0": 0.0,
        "t1": 0.1,
        "t_end": 0.1,
        "target": "numpy",
        "index": 0,
        "status": lg.Status.SUCCESS,
        "message": "It went well.",
        "rejected": 0,
        "evaluations": 4,
        "wall": 0.1,
        "dense": solution().trajectory.dense,
        "v": [0.1, 0.2],
        "y": [0.1, 0.2, 0.3, 0.4],
        "y0": np.array([0.1, 0.2, 0.3, 0.4]),
        "z": [1j],
    }


def in_double_precision() -> lg.Model:
    """Return the model, and let JAX compute in double precision."""
    import jax

    jax.config.update("jax_enable_x64", val=True)
    return model()


NEEDS = {"Model.as_casadi": "casadi", "Model.as_jax": "jax", "Model.as_numba": "numba"}
"""The packages of methods that are refused without them; see `tests/recipes`."""

HELD: dict[str, Callable[[], Any]] = {
    "Model.as_jax": in_double_precision,
    "Model.as_numba": lambda: system().compile("llvm"),
    "Model.multipliers": lambda: held().compile("numpy"),
    "Solution.constraint_force": lambda: held().run(0.1, method="rk4", step=0.05, target="numpy"),
}
"""Instances for methods that need another model: with constraints, or in machine code."""

OWN: dict[str, dict[str, Any]] = {
    "lg.phase_portrait": {"at": {"y": 0, "y_dot": 0}},
    "lg.bifurcation": {"parameter": "m", "values": [1.0, 2.0], "section": lg.coordinate("x"), "points": 2, "skip": 1},
    "lg.poincare": {"crossings": 2},
    "PoincareSection.plot": {"x": "x", "y": "x_dot"},
    "System.export": {"target": "c", "contents": ["rhs", "events"]},
    "Solution.animate": {"path": None},
    "System.from_scene": {"path": LIBRARY / "pendulum.toml"},
    "Model.as_casadi": {"status": True},
    "Solution.constraint_force": {"name": "rod", "at": "bob"},
    "System.transform": {"coordinates": {"x": lg.coordinate("u") ** 3 + 1}, "positive": (), "initial": {"u": 1.0}},
    "System.small": {"about": {}, "order": 2},
    "Ensemble.given": {"name": "x"},
    "lg.ensemble": {"initial": {"x": [0.5, 1.0]}, "workers": 1},
    "lg.grid": {"axes": {"x": (0.0, 1.0, 3)}},
    "lg.sample": {"ranges": {"x": (0.0, 1.0)}, "count": 4, "method": "sobol"},
    "lg.Claims": {"events": True, "dense": 3},
    "lg.Trajectory": {"t": [0.0, 0.1], "y": np.zeros((4, 2))},
    "lg.methods.ButcherTableau": {"order": 2, "A": ((), (0.5,)), "b": (0, 1), "error": None, "dense": None},
    "lg.methods.ImplicitMethod": {"path": None},
    "lg.scene": {"name": "pendulum"},
    "lg.coordinate": {"name": "u"},
    "lg.event": {"expression": sympy.Symbol("u")},
    "lg.contact": {"gap": lg.coordinate("y"), "slip": lg.coordinate("x").dot, "restitution": 0.5, "friction": 0.2},
    "lg.table": {"argument": lg.coordinate("x"), "points": [0, 1, 2, 3], "values": [0, 1, 0, 2]},
    "lg.gravity": {"g": lg.parameters("g")},
    "lg.spring": {"b": (0, 0)},
    "lg.methods.composition": {"order": 2},
    "lg.methods.tableau": {"order": 2},
    "lg.methods.explicit_method": {"order": 2},
    "lg.methods.Taylor": {"order": 12},
    "lg.methods.growth": {"z": [1j]},
    "lg.methods.CVODE": {"method": "BDF"},
    "lg.methods.register": {"name": "mine", "method": euler, "order": 1, "replaces": True},
}
"""Arguments of callables whose parameters mean something else there."""


def arguments(public: Public, folder: Path) -> dict[str, Any]:
    """Return valid arguments for the parameters of a callable, except *args and **kwargs."""
    known = sound(folder) | OWN.get(public.name, {})
    if public.name == "lg.load":
        known["path"] = solution().to_npz(folder / "run.npz")
    if public.name == "Solution.animate":
        known["path"] = folder / "run.html"
    if public.name == "System.export":
        known["path"] = folder / "exported"
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {p.name: known[p.name] for p in public.parameters if p.kind not in kinds and p.name in known}
