"""Drivers in machine code: the loop over steps of a step program, around calls of the right-hand side.

    i32 drive(ptr rhs, ptr parameters, ptr jacobian, ptr its parameters,
              ptr reals, ptr counts, ptr work, i64 budget, ptr times, ptr rows)

For a system with constraints, the projection and its parameters precede `reals`; the loop over steps takes them last.
`reals` and `counts` are those of `DriverState`. `work` holds the vectors of a step and the data of its solves, see
`Layout`. The result is an `Outcome`.
"""

from __future__ import annotations

import ctypes
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.step.controlled_steps import steps_of
from lagrange.algorithm.step.memory import NEWTON, Kept, Layout, kept
from lagrange.machine.backend import FloatArray
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.kernel.llvm_module import STORED_TOGETHER, fit
from lagrange.machine.llvm.address import address, workspace
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import declarations
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, function
from lagrange.machine.llvm.tiers import TieredModule
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.step_events import StepFunction
from lagrange.procedure.form import Procedure, calls
from lagrange.program.actions import LAWS
from lagrange.program.step import StepProgram


class LlvmDriver:
    """A compiled driver bound to one right-hand side and one set of prepared parameters."""

    def __init__(
        self,
        step: StepProgram,
        kernel: LlvmKernel,
        parameters: FloatArray,
        jacobian: LlvmKernel | None = None,
        projection: LlvmKernel | None = None,
    ) -> None:
        self._kernel = kernel
        self._code = _compiled(step, LAWS[step.law].dimension(kernel.program.states), projection is not None)
        self._drive, self._places = self._code.drive, self._code.places
        self._quick = not self._code.module.is_final
        self._prepared = kernel.prepare(parameters)
        self._work = workspace(self._code.layout.size)
        self._fixed: tuple[int | None, ...] = (kernel.law_address, address(self._prepared), None, None)
        if jacobian is not None:
            self._derivative = jacobian, jacobian.prepare(parameters)
            self._fixed = (*self._fixed[:2], jacobian.address, address(self._derivative[1]))
        if projection is not None:
            self._projection = projection, projection.prepare(parameters)
            self._fixed = (*self._fixed, projection.address, address(self._projection[1]))
        self._work_address = address(self._work)
        self._state: DriverState | None = None
        self._records = (0, 0)
        self._function: StepFunction | None = None

    def adopt(self, state: DriverState) -> None:
        """Do nothing: the state keeps its own memory; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`. `rows` needs one spare block after its last row."""
        self._work[self._places] = state.y
        recorded = (address(times), address(rows)) if state.counts[DriverState.RECORD] else (None, None)
        if state is not self._state:
            self._state, self._records = state, (address(state.reals), address(state.counts))
        before = state.integers[DriverState.STEPS]
        outcome = self._drive(*self._fixed, *self._records, self._work_address, budget, *recorded)
        self.count(state.integers[DriverState.STEPS] - before)
        state.y[:] = self._work[self._places]
        return Outcome(outcome)

    @property
    def function(self) -> StepFunction:
        """The compiled function that takes steps, for a separately compiled loop. It changes after many steps."""
        if self._function is None:
            laws = np.array([0 if one is None else one for one in self._fixed], dtype=np.int64)
            self._function = StepFunction(self._code.module.address_of("steps"), laws, self._work, self._places)
        return self._function

    def count(self, steps: int) -> None:
        """Count steps of the quickly compiled code, and switch to the optimized code when it is ready."""
        if not self._quick:
            return
        self._code.module.count(steps)
        if self._code.module.is_final:
            self._drive, self._quick = self._code.drive, False
            self._function = None

    def kept(self) -> tuple[Kept, ...]:
        """Return the kept data of each solve of the steps, followed by those of the starter."""
        layout = self._code.layout
        found = _kept(layout, self._work)
        return found if layout.step.starter is None else (*found, *_kept(layout.starting, self._work[layout.end :]))


def _kept(layout: Layout, work: FloatArray) -> tuple[Kept, ...]:
    step = NEWTON.places["matrix_step"]
    return tuple(kept(layout, float(work[solve.flags + step]), solve, work) for solve in layout.solves)


_LAWS = "ptr %rhs, ptr %p, ptr %jacobian, ptr %jp"
"""Pointer arguments in C order: the law that a step calls and its Jacobian, each with its prepared parameters."""

_PROJECTION = "ptr %projection, ptr %pp"
"""The kernel of the corrections onto the constraints, with its prepared parameters."""


def _drive_type(pointers: int) -> Any:
    """Return the C type of a driver with `pointers` pointers before its budget."""
    before = [ctypes.c_void_p] * pointers
    return ctypes.CFUNCTYPE(ctypes.c_int32, *before, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)


_DRIVE, _DRIVE_PROJECTED = _drive_type(7), _drive_type(9)


@dataclass(frozen=True, eq=False)
class _Code:
    """A driver in machine code, its layout of `work`, and the indices of the state's entries there.

    The state is one vector, or coordinates and velocities, each padded to whole blocks.
    """

    module: TieredModule
    layout: Layout
    places: NDArray[np.intp]

    @property
    def drive(self) -> Any:
        """The driver as a function."""
        return (_DRIVE_PROJECTED if self.layout.projected else _DRIVE)(self.module.address)


@lru_cache(maxsize=64)
def _compiled(step: StepProgram, dimension: int, projected: bool) -> _Code:
    layout, n = laid_out(step, dimension, projected=projected), dimension // 2
    second = layout.width if step.partitioned else n
    places = np.array([*range(n), *range(second, second + n)])
    ir = driver_ir(step, dimension, projected=projected)
    return _Code(TieredModule(ir, "drive", optimize=True), layout, places)


def driver_ir(step: StepProgram, dimension: int, *, projected: bool = False) -> str:
    """Return the IR of the driver of a step for states of a dimension; `projected` if constraints hold."""
    layout = laid_out(step, dimension, projected=projected)
    loop = steps_of(layout)
    return "\n".join([declarations(), METADATA, ATTRIBUTES, *_procedures(loop), _drive(layout, loop), _steps(layout)])


def laid_out(step: StepProgram, dimension: int, *, projected: bool = False) -> Layout:
    """Return the layout of the vectors of a step, in whole blocks."""
    small = fit(dimension) and not LAWS[step.law].through_memory
    return Layout(step, dimension, block=STORED_TOGETHER, in_registers=small, projected=projected)


def _drive(layout: Layout, loop: Procedure) -> str:
    """Emit drive, which calls the loop over steps."""
    e = Emitter()
    floors, effort = e.address("%reals", DriverState.FLOORS), e.address("%work", layout.effort)
    solves = [solve.flags for solve in layout.solves]
    if layout.step.starter is not None:
        solves += [layout.end + solve.flags for solve in layout.starting.solves]
    records = "".join(f"ptr {e.address('%work', place)}, " for place in solves)
    more = [_PROJECTION] if layout.projected else []
    given = ", ".join([f"{_LAWS}, ptr %reals, ptr %counts, ptr {floors}, ptr {effort}, {records}ptr %work", *more])
    laws = ", ".join([_LAWS, *more])
    outcome = e.value(f"call i64 @{loop.name}({given}, i64 %budget, ptr %times, ptr %rows)")
    e.do(f"ret i32 {e.value(f'trunc i64 {outcome} to i32')}")
    return e.function(
        f"define i32 @drive({laws}, ptr noalias %reals, ptr noalias %counts, ptr noalias %work, i64 %budget, "
        "ptr noalias %times, ptr noalias %rows)"
    )


def _steps(layout: Layout) -> str:
    """Emit `steps`: `drive` with its laws and parameters in one array, in the signature `STEPS`."""
    e = Emitter()
    laws = ", ".join(f"ptr {e.get('%laws', place, 'ptr')}" for place in range(6 if layout.projected else 4))
    rest = "ptr %reals, ptr %counts, ptr %work, i64 %budget, ptr %times, ptr %rows"
    outcome = e.value(f"call i32 @drive({laws}, {rest})")
    e.do(f"ret i64 {e.value(f'zext i32 {outcome} to i64')}")
    return e.function(f"define i64 @steps(ptr %laws, {rest})")


def _procedures(loop: Procedure) -> list[str]:
    """Return the IR of a loop and its callees. Procedures with a single call are merged into their caller."""
    wanted = (*loop.callees, loop)
    called = Counter(call.callee for procedure in wanted for call in calls(procedure.body))
    return [function(procedure, hidden=True, merged=called[procedure] < 2) for procedure in wanted]
