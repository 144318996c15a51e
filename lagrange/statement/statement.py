"""What the user said, checked and frozen: the record that every later stage reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from sympy import Symbol

from lagrange.statement.constraint import Constraint
from lagrange.statement.coordinate import acceleration_of, name_of, velocity_of
from lagrange.statement.dimension import Size

REFUSE, ALLOW = REDUNDANT = ("refuse", "allow")
"""What is done with constraints that follow from others: they are refused, or share the forces."""


_VIEWS = ("defaults", "positions", "dimensions")
"""The fields of a statement that are read-only views of dicts."""


@dataclass(frozen=True)
class RunSettings:
    """How a scene asks to be run; whatever the caller says goes first."""

    t_end: float = 10.0
    method: str | None = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None


@dataclass(frozen=True, eq=False)
class Statement:
    """A mechanical system as stated: n coordinates, their energies, forces, parameters and initial state.

    Expressions are SymPy, in the coordinates q(t), their velocities Derivative(q(t), t), the parameters and t.
    `forces` has one entry per coordinate, in the order of `coordinates`; `initial` holds (q, v), 2n numbers.
    `constraints` are expressions that stay zero; `redundant` says what is done with those that follow from others.
    `defaults` lacks the parameters that were given no value. `dimensions` has the sizes of coordinates, parameters and
    t that were stated or follow from those, empty where none were.
    """

    coordinates: tuple[Any, ...]
    kinetic: Any
    potential: Any
    lagrangian: Any
    forces: tuple[Any, ...]
    dissipation: Any
    parameters: tuple[Symbol, ...]
    defaults: Mapping[Symbol, float]
    initial: tuple[float, ...]
    positions: Mapping[str, tuple[Any, ...]]
    links: tuple[tuple[str, str], ...]
    name: str
    about: str = ""
    source: str = ""
    run: RunSettings = field(default_factory=RunSettings)
    constraints: tuple[Constraint, ...] = ()
    redundant: str = REFUSE
    dimensions: Mapping[Any, Size] = field(default_factory=lambda: MappingProxyType({}))

    def __getstate__(self) -> dict[str, Any]:
        # Read-only views of dicts do not pickle.
        return self.__dict__ | {name: dict(getattr(self, name)) for name in _VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        views = {name: MappingProxyType(state[name]) for name in _VIEWS}
        self.__dict__.update(state | views)

    @property
    def velocities(self) -> tuple[Any, ...]:
        """The generalized velocities, n of them."""
        return tuple(velocity_of(q) for q in self.coordinates)

    @property
    def names(self) -> tuple[str, ...]:
        """The coordinates' names, n of them."""
        return tuple(name_of(q) for q in self.coordinates)

    @property
    def unused(self) -> tuple[Symbol, ...]:
        """The parameters that stand in no energy, force, constraint or position."""
        stated = [self.kinetic, self.potential, self.dissipation, *self.forces]
        stated += [one.expression for one in self.constraints]
        stated += [entry for point in self.positions.values() for entry in point]
        used = frozenset().union(*(expression.free_symbols for expression in stated))
        return tuple(p for p in self.parameters if p not in used)

    @property
    def plain(self) -> Mapping[Any, Any]:
        """Replacement of q(t) and its derivatives by real symbols `q`, `q_dot`, `q_ddot`, for differentiation."""
        table: dict[Any, Any] = {}
        for q, name in zip(self.coordinates, self.names, strict=True):
            table[q] = Symbol(name, real=True)
            table[velocity_of(q)] = Symbol(f"{name}_dot", real=True)
            table[acceleration_of(q)] = Symbol(f"{name}_ddot", real=True)
        return MappingProxyType(table)
