"""A model as it is exported, in no language: its functions, their tests, and what people read about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

from lagrange.procedure.form import Procedure
from lagrange.program.program import Program


@dataclass(frozen=True, eq=False)
class Quantity:
    """A function of time, state and prepared numbers: its results by name, in C order, and their shape.

    `program` is what it computes, for languages without memory; `procedure` how, for the others.
    """

    name: str
    about: str
    program: Program
    procedure: Procedure
    results: tuple[str, ...]
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Integrator:
    """A function that takes steps: its parameters are those of its procedure, in order."""

    name: str
    about: str
    procedure: Procedure
    adaptive: bool


@dataclass(frozen=True)
class Check:
    """The test of one quantity: times (s,), states (s, 2n), and the results there with what they may be off, (s, k)."""

    name: str
    times: tuple[float, ...]
    states: tuple[tuple[float, ...], ...]
    results: tuple[tuple[float, ...], ...]
    allowed: tuple[tuple[float, ...], ...]

    @property
    def flat(self) -> list[tuple[float, ...]]:
        """Times, states, results and what they may be off, the rows of each one behind the other."""
        return [self.times, *(tuple(chain(*rows)) for rows in (self.states, self.results, self.allowed))]


@dataclass(frozen=True)
class StepCheck:
    """The test of an integrator: from a state at a time, with a step or to an end, to a state with what it may be off.

    `length` is the step, or the time to the end.
    """

    name: str
    time: float
    length: float
    state: tuple[float, ...]
    result: tuple[float, ...]
    allowed: tuple[float, ...]


@dataclass(frozen=True)
class Run:
    """What `main` does: the initial state to an end, with so many intervals between the rows of its table."""

    initial: tuple[float, ...]
    t_end: float
    intervals: int
    rtol: float


@dataclass(frozen=True, eq=False)
class SourceModule:
    """What is written into a file.

    `state` and `parameters` are the names of what is in the arrays `y` and `parameters`, as stated; `values` are those
    of the parameters, `inputs` the names of those that may change along a motion. `units` are those of state,
    parameters and t where they were given. `statement` are lines of text about where it came from. `prepare` computes
    once what depends on parameters alone, `prepared` numbers with the parameters in front.
    """

    name: str
    statement: tuple[str, ...]
    state: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    units: Mapping[str, str]
    prepare: Procedure
    prepared: int
    quantities: tuple[Quantity, ...]
    integrators: tuple[Integrator, ...] = ()
    checks: tuple[Check, ...] = ()
    step_checks: tuple[StepCheck, ...] = ()
    run: Run | None = None
    inputs: tuple[str, ...] = ()

    def quantity(self, name: str) -> Quantity | None:
        """Return a quantity by name, None where it is not exported."""
        return next((one for one in self.quantities if one.name == name), None)

    @property
    def public(self) -> tuple[Procedure, ...]:
        """The procedures that a user calls, in order."""
        functions = [one.procedure for one in self.quantities]
        return (self.prepare, *functions, *(one.procedure for one in self.integrators))

    @property
    def procedures(self) -> tuple[Procedure, ...]:
        """All procedures, each once and before its callers."""
        found: dict[Procedure, None] = {}
        for one in self.public:
            found |= dict.fromkeys((*one.callees, one))
        return tuple(found)
