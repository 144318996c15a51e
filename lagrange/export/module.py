"""The language-independent module of an export: functions, their tests, and texts about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lagrange.procedure.form import Procedure
from lagrange.program.program import Instruction, Program


@dataclass(frozen=True, eq=False)
class ExportedQuantity:
    """An exported function of time, state and the array p of values that depend on parameters alone.

    `results` are the names of its results in C order, `shape` is the shape of their array, and `unit` their common
    unit. `program` is its formula, for languages without loops. `procedure` is its code, for the other languages.
    """

    name: str
    about: str
    program: Program
    procedure: Procedure
    results: tuple[str, ...]
    shape: tuple[int, ...]
    unit: str = ""


@dataclass(frozen=True, eq=False)
class ExportedIntegrator:
    """An exported integrator: one step, or a run to an end time if `adaptive`.

    The parameters of the exported function are those of `procedure`.
    """

    name: str
    procedure: Procedure
    adaptive: bool


@dataclass(frozen=True, eq=False)
class ValueNames:
    """Names for values in an exported file: of the state, of parameters, and of matrix entries.

    `matrix` is the program whose results are the matrix entries of the linear system for the accelerations; `entries`
    are the names of these results. Where `state` or `parameters` is empty, values of that kind get no name.
    """

    state: tuple[str, ...]
    parameters: tuple[str, ...]
    entries: tuple[str, ...]
    matrix: Program

    def of(self, program: Program) -> dict[int, str]:
        """Return the names of values in a program, by the index of the instruction that computes or reads the value."""
        numbers: dict[Instruction, int] = {}
        entries, values = numbered(self.matrix, numbers), numbered(program, numbers)
        matrix = {entries[ref]: name for ref, name in zip(self.matrix.outputs, self.entries, strict=True)}
        stated = {"state": self.state, "parameter": self.parameters, "constant": (), "time": ()}
        names = {}
        for ref, instruction in enumerate(program.instructions):
            if instruction.op not in stated and values[ref] in matrix:
                names[ref] = matrix[values[ref]]
            elif instruction.place < len(stated.get(instruction.op, ())):
                names[ref] = stated[instruction.op][instruction.place]
        return names


def numbered(program: Program, numbers: dict[Instruction, int]) -> list[int]:
    """Return a number for each instruction of a program; instructions with equal values have the same number.

    `numbers` has the number of each instruction so far, also of other programs; new instructions are added to it.
    """
    result: list[int] = []
    for instruction in program.instructions:
        moved = instruction._replace(args=tuple(result[arg] for arg in instruction.args))
        result.append(numbers.setdefault(moved, len(numbers)))
    return result


@dataclass(frozen=True)
class Check:
    """The test of a quantity with k results at s states of 2n numbers.

    `times` is (s,), `states` (s, 2n), the expected `results` (s, k), and the `allowed` absolute errors (s, k).
    """

    name: str
    times: tuple[float, ...]
    states: tuple[tuple[float, ...], ...]
    results: tuple[tuple[float, ...], ...]
    allowed: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class StepCheck:
    """The test of an integrator: from `state` (2n,) at `time`, the state after the time `length` is `result` (2n,).

    `length` is the step, or the duration of an adaptive run. `allowed` (2n,) are the allowed absolute errors.
    """

    name: str
    time: float
    length: float
    state: tuple[float, ...]
    result: tuple[float, ...]
    allowed: tuple[float, ...]


@dataclass(frozen=True)
class ExportedRun:
    """The run of `main` from the initial state to `t_end`; `main` prints a table of `intervals` + 1 rows."""

    initial: tuple[float, ...]
    t_end: float
    intervals: int
    rtol: float


@dataclass(frozen=True, eq=False)
class SourceModule:
    """The content of an exported file, independent of a language.

    - `statement` are lines of text about the system.
    - `state` and `parameters` are the names of the entries of the arrays `y` and `parameters`, as stated.
    - `values` are the values of the parameters, `inputs` the names of the parameters that may change during a run.
    - `units` are the stated units of state, parameters and t.
    - `names` are the names of values in the formulas.
    - `prepare` fills the array p of `prepared` numbers: the parameters, then all values that depend on parameters
      alone.
    - `divisors` computes the matrix entries by which formulas of the accelerations divide, to test them for zero.
    """

    name: str
    statement: tuple[str, ...]
    state: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    units: Mapping[str, str]
    names: ValueNames
    prepare: Procedure
    prepared: int
    quantities: tuple[ExportedQuantity, ...]
    integrators: tuple[ExportedIntegrator, ...] = ()
    checks: tuple[Check, ...] = ()
    step_checks: tuple[StepCheck, ...] = ()
    run: ExportedRun | None = None
    inputs: tuple[str, ...] = ()
    divisors: Program | None = None

    def quantity(self, name: str) -> ExportedQuantity | None:
        """Return a quantity by name, or None if it is not exported."""
        return next((candidate for candidate in self.quantities if candidate.name == name), None)

    @property
    def public(self) -> tuple[Procedure, ...]:
        """The procedures that a user calls, in order."""
        functions = [quantity.procedure for quantity in self.quantities]
        return (self.prepare, *functions, *(quantity.procedure for quantity in self.integrators))

    @property
    def procedures(self) -> tuple[Procedure, ...]:
        """All procedures, each once and before its callers."""
        ordered: dict[Procedure, None] = {}
        for procedure in self.public:
            ordered |= dict.fromkeys((*procedure.callees, procedure))
        return tuple(ordered)
