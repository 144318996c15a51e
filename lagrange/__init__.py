"""lagrange: state kinetic and potential energy, get checked, compiled equations of motion and trajectories.

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # what type checkers take for true; the module typing takes longer than all the rest here

if TYPE_CHECKING:
    from typing import Any

    from lagrange import cli as cli
    from lagrange import methods as methods
    from lagrange.dynamical import basins, bifurcation, energy_exchange, first_passage, phase_portrait, poincare
    from lagrange.ensembles import ensemble
    from lagrange.errors import LagrangeError, RunError, SceneError, StatementError
    from lagrange.evidence.trust import TrustHorizon, trust_horizon
    from lagrange.export.registry import targets
    from lagrange.library import scene, scenes
    from lagrange.loading import load
    from lagrange.members.varied import grid, sample
    from lagrange.racing import race
    from lagrange.recipes.model import Model
    from lagrange.show.ensemble import Ensemble
    from lagrange.show.figures.empty_figure import figure
    from lagrange.show.plotting import plot
    from lagrange.show.race import Race
    from lagrange.statement.coordinate import coordinate, coordinates, parameters, t
    from lagrange.statement.energy import gravity, kinetic_energy, rotational_energy, spring
    from lagrange.statement.event import Event, event
    from lagrange.statement.given import given
    from lagrange.statement.multiplier import multiplier
    from lagrange.statement.table import table
    from lagrange.system import System
    from lagrange.trajectory.integrator import Claims, Integrator, Problem
    from lagrange.trajectory.run import flow, integrate
    from lagrange.trajectory.solution import Solution
    from lagrange.trajectory.trajectory import Status, Trajectory

__version__ = "0.1.0"

_HOMES = {
    "lagrange.members.varied": ("grid", "sample"),
    "lagrange.ensembles": ("ensemble",),
    "lagrange.dynamical": (
        *("basins", "bifurcation", "energy_exchange", "first_passage"),
        *("phase_portrait", "poincare"),
    ),
    "lagrange.errors": ("LagrangeError", "RunError", "SceneError", "StatementError"),
    "lagrange.evidence.trust": ("TrustHorizon", "trust_horizon"),
    "lagrange.export.registry": ("targets",),
    "lagrange.loading": ("load",),
    "lagrange.racing": ("race",),
    "lagrange.recipes.model": ("Model",),
    "lagrange.trajectory.run": ("flow", "integrate"),
    "lagrange.show.ensemble": ("Ensemble",),
    "lagrange.show.figures.empty_figure": ("figure",),
    "lagrange.show.plotting": ("plot",),
    "lagrange.show.race": ("Race",),
    "lagrange.trajectory.solution": ("Solution",),
    "lagrange.statement.coordinate": ("coordinate", "coordinates", "parameters", "t"),
    "lagrange.statement.multiplier": ("multiplier",),
    "lagrange.statement.energy": ("gravity", "kinetic_energy", "rotational_energy", "spring"),
    "lagrange.statement.event": ("Event", "event"),
    "lagrange.statement.given": ("given",),
    "lagrange.statement.table": ("table",),
    "lagrange.library": ("scene", "scenes"),
    "lagrange.system": ("System",),
    "lagrange.trajectory.integrator": ("Claims", "Integrator", "Problem"),
    "lagrange.trajectory.trajectory": ("Status", "Trajectory"),
}

_MODULES = {"cli": "lagrange.cli", "methods": "lagrange.methods"}

_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Claims",
    "Ensemble",
    "Event",
    "Integrator",
    "LagrangeError",
    "Model",
    "Problem",
    "Race",
    "RunError",
    "SceneError",
    "Solution",
    "StatementError",
    "Status",
    "System",
    "Trajectory",
    "TrustHorizon",
    "__version__",
    "basins",
    "bifurcation",
    "coordinate",
    "coordinates",
    "energy_exchange",
    "ensemble",
    "event",
    "figure",
    "first_passage",
    "flow",
    "given",
    "gravity",
    "grid",
    "integrate",
    "kinetic_energy",
    "load",
    "methods",
    "multiplier",
    "parameters",
    "phase_portrait",
    "plot",
    "poincare",
    "race",
    "rotational_energy",
    "sample",
    "scene",
    "scenes",
    "spring",
    "t",
    "table",
    "targets",
    "trust_horizon",
]


def __getattr__(name: str) -> Any:
    """Load a public name from the module it lives in (PEP 562)."""
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name not in _HOME:
        raise AttributeError(f"module 'lagrange' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
