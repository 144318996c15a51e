"""Drivers that advance a run by steps of any method, and the memory of a Taylor run with events and surfaces.

Each driver calls the compiled or printed loop over its steps.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import RELATIVE_PERTURBATION, WIDEST_VECTOR, perturbation_factors
from lagrange.algorithm.events.constants import CROSSING
from lagrange.algorithm.step.memory import EFFORT, NEWTON
from lagrange.algorithm.taylor.memory import HELD, MOST_SURFACES
from lagrange.algorithm.taylor.watched_functions import MOST_ZEROS, PARTS, SETTINGS, SIDES, WATCH, scratch_sizes
from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, Kernel, Machine, SeriesCode
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.machine.llvm.address import workspace
from lagrange.machine.state import OUTCOMES, DriverState, Outcome, Outputs, Reaction, StepFunction
from lagrange.procedure.form import Record
from lagrange.program.program import Program
from lagrange.program.step import StepProgram

TAYLOR_EVENT_ROOM = 4096
"""Least number of events for which an `EventMemory` has room. If one step may have more events, it has more room. The
loop over steps returns when the memory is full.
"""


@lru_cache(maxsize=64)
def _tilts(dimension: int) -> FloatArray:
    """Return factors (2n + 1,) near 1 for the 2n entries of the state and the time.

    The rounding noise of an event function is estimated from its change when state and time are multiplied by them.
    """
    return np.asarray(1 + RELATIVE_PERTURBATION * perturbation_factors(dimension + 1))


@lru_cache(maxsize=64)
def _settings(reactions: tuple[Reaction, ...]) -> NDArray[np.int64]:
    """Return the settings of all watched functions (events and surfaces) as one read-only array of integers.

    `reactions` has one entry for each function. The array has a block for each setting, such as the direction in which
    a zero counts as an event. A block has one entry for each function. After the blocks come the indices of the state
    entries that resets replace.
    """
    rows = [(r.direction, r.terminal, r.first, len(r.entries), int(r.root), int(r.smooth)) for r in reactions]
    settings = [x for block in zip(*rows, strict=True) for x in block]
    if len(settings) != len(SETTINGS) * len(reactions):
        raise AssertionError("a setting has no block")
    return np.array([*settings, *(entry for r in reactions for entry in r.entries), 0], dtype=np.int64)


class EventMemory:
    """Memory in which the loop over Taylor steps tracks its watched functions, and the events that it has found.

    Watched functions are the `surfaces` switching surfaces (a number), then the event functions, whose effects
    `reactions` states. `dimension` is the length of a state. `values` is the kernel that evaluates the functions from
    the state, the parameters and the sides of the surfaces. The side of a surface is the sign of its function, 1 or
    -1. `resets` is the kernel that computes the new state entries of all resets from the state and the `parameters`
    (k,).
    """

    def __init__(
        self,
        dimension: int,
        surfaces: int,
        reactions: Sequence[Reaction],
        values: Kernel | None = None,
        resets: Kernel | None = None,
        parameters: FloatArray | None = None,
    ) -> None:
        self.count, self._dimension = surfaces + len(reactions), dimension
        self.values, self.resets, self.parameters = values, resets, np.empty(0) if parameters is None else parameters
        changing = surfaces > 0 or any(reaction.terminal or reaction.entries for reaction in reactions)
        room = max(TAYLOR_EVENT_ROOM, MOST_ZEROS * self.count)
        self.record: Any = WATCH.structure(surfaces=surfaces, changing=int(changing), room=room, changed=-np.inf)
        self.tilts = _tilts(dimension)
        self.sides = np.zeros(2 * len(SIDES) * self.count, dtype=np.int64)
        self.settings = _settings((*[Reaction(CROSSING)] * surfaces, *reactions))
        self.times = np.empty(room)
        self.states = np.empty(room * dimension + WIDEST_VECTOR)
        self.places = np.empty(room, dtype=np.int64)
        self.surfaces = surfaces
        few = surfaces <= MOST_SURFACES
        self.combinations = np.full(2**surfaces if few else 1, -1, dtype=np.int64)
        self.switch_rows, self.switch_combinations = (np.empty(room, dtype=np.int64) for _ in range(2))
        reals, wholes = scratch_sizes(self.count, dimension)
        self.scratch, self.whole_scratch = np.empty(reals + WIDEST_VECTOR), np.empty(wholes, dtype=np.int64)
        self.keep_start()

    def keep_start(self) -> None:
        """Save the present state of the memory, with which each later run with the same parameters starts."""
        self._start = bytes(self.record), self.combinations.copy()

    def restart(self) -> None:
        """Prepare the memory for another run: remove all events, and set the signs of all functions to unknown."""
        record, combinations = self._start
        ctypes.memmove(ctypes.addressof(self.record), record, len(record))
        self.combinations[:] = combinations
        self.sides.fill(0)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all arrays of the memory."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def store_sides(self, sides: FloatArray, size: int) -> int:
        """Make `sides` (s,) the present sides of the switching surfaces. Return the index of their block of numbers.

        Some numbers that the code reads depend on the parameters and on the sides. The driver has one array for them,
        with a block of `size` numbers for each combination of sides, and a first block for combinations that have no
        number because `combination` returns -1.
        """
        self.record.combination = self.combination(sides)
        self.record.numbers = (1 + self.record.combination) * size
        if self.record.combination >= 0:
            self.combinations[self.record.combination] = self.record.numbers
        return int(self.record.numbers)

    def combination(self, sides: FloatArray) -> int:
        """Return the sides (s,) of switching surfaces as a binary number.

        Bit i is 1 if side i is 1.0, and 0 if it is -1.0. Return -1 if there are more than `MOST_SURFACES` surfaces,
        or if a side is 0. A side is 0 if the motion stays on the surface.
        """
        if self.surfaces == 0:
            return 0
        if len(sides) > MOST_SURFACES or not (np.abs(sides) == 1.0).all():
            return -1
        return sum(1 << i for i, side in enumerate(sides.tolist()) if side > 0)

    def sides_of(self, combination: int) -> FloatArray:
        """Return the sides (s,) of switching surfaces, each 1.0 or -1.0, for a number that `combination` returned."""
        return np.array([1.0 if combination >> i & 1 else -1.0 for i in range(self.surfaces)])

    def switched(self) -> list[tuple[int, int]]:
        """Return the crossings of switching surfaces since the last call, as pairs (row, new sides).

        The row is the index of the accepted state from which on the run has the new sides. The sides are a binary
        number, as `combination` returns it.
        """
        count, self.record.switches = self.record.switches, 0
        return list(zip(self.switch_rows[:count].tolist(), self.switch_combinations[:count].tolist(), strict=True))

    def __getattr__(self, name: str) -> NDArray[np.int64]:
        """Return part `name` of the integer arrays `sides` and `whole_scratch`: an entry for each watched function.

        For example, the part `signs` has the signs of the functions, and `event_counts` the numbers of their events.
        `PARTS` lists the names. Raises AttributeError for other names.
        """
        array, begin = PARTS.get(name, ("", 0))
        if array not in ("sides", "whole_scratch"):
            raise AttributeError(name)
        block: NDArray[np.int64] = getattr(self, array)[begin * self.count :][: self.count]
        return block

    def zeros_now(self) -> list[tuple[int, int]]:
        """Return pairs (index, direction) of the watched functions that are zero at the present state.

        The direction is 1 or -1 for a change of sign, and 0 for a function that touches zero. The list is empty
        unless one of these zeros resets the state, crosses a switching surface, or ends the run.
        """
        return list(zip(*(part[: self.record.due].tolist() for part in (self.due, self.due_directions)), strict=True))

    @property
    def mark(self) -> tuple[int, float, float]:
        """Mark by which a caller recognizes a batch of events: their number, and the times of the first and last."""
        count = self.record.done
        return count, float(self.times[0]), float(self.times[count - 1])

    def forget(self) -> None:
        """Discard the events in memory, after the caller has copied them."""
        self.record.done = self.record.ahead = 0

    def written(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return, for each watched function, the times (k,) and states (k, 2n) of its k events in memory."""
        count, size = self.record.done, self._dimension
        times, states = self.times[:count], self.states[: count * size].reshape(count, size)
        if self.count == 1:
            return [(times.copy(), states.copy())]
        indices = self.places[:count]
        # NumPy sorts 8-bit and 16-bit integers by radix sort. Indexing rows with [order] takes ten times as long as
        # `take`.
        order = indices.astype(np.min_scalar_type(self.count)).argsort(kind="stable")
        ends = np.bincount(indices, minlength=self.count).cumsum().tolist()
        times, states = times.take(order), states.take(order, axis=0)
        return [(times[a:b], states[a:b]) for a, b in pairwise((0, *ends))]


class StepDriver:
    """Advances a run by steps of a method that is given as the step program `step` (implements `Driver`).

    It serves one right-hand side, `kernel`, and one set of parameters. `jacobian` is the derivative of `kernel`, for
    Newton's method in implicit methods. `projection` computes corrections of a state onto the constraints. Both may be
    None. The driver's work array keeps the matrices of Newton's method from step to step.
    """

    def __init__(
        self,
        machine: Machine,
        step: StepProgram,
        kernel: Kernel,
        parameters: FloatArray,
        jacobian: Kernel | None = None,
        projection: Kernel | None = None,
    ) -> None:
        loop, layout = machine.loop(step, kernel.program, projected=projection is not None)
        self._loop: Any = loop
        self._layout, self._work = layout, workspace(layout.size)
        self._call: Any = self._loop.bound()
        n = layout.dimension // 2
        second = layout.width if step.states == 2 else n
        self._entries = np.array([*range(n), *range(second, second + n)])
        """Indices (2n,) of the state's entries in the work array, where q and v may be separate, padded vectors."""
        self._kernels = kernel, jacobian, projection
        law = machine.callback(kernel, parameters, of_steps=True)
        self._call.give(law=law.function, parameters=law.numbers, work=self._work)
        for name, corrections, numbers in (
            ("jacobian", jacobian, "constants"),
            ("projection", projection, "projection_numbers"),
        ):
            if corrections is not None:
                callback = machine.callback(corrections, parameters)
                self._call.give(**{name: callback.function, numbers: callback.numbers})
        self._call.give(effort=self._record(EFFORT, layout.effort))
        for i, solve in enumerate(layout.solves):
            self._call.give(**{f"newtons_{i}": self._record(NEWTON, solve.flags)})
        # The layout of the starter, the method of the first steps, follows the vectors of the step.
        for i, solve in enumerate(() if step.starter is None else layout.starting.solves):
            self._call.give(**{f"starters_{i}": self._record(NEWTON, layout.end + solve.flags)})
        self._budget: int | None = None
        """Largest number of steps that was last passed to the loop, or None if its arguments must be passed again."""
        self._state: DriverState | None = None
        self._function: StepFunction | None = None

    def _record(self, record: Record, index: int) -> Any:
        """Return part of the driver's work array, from index `index` on, as a structure of named numbers.

        `record` is the type of the structure, which shares memory with the array.
        """
        memory: Any = self._work
        return record.structure.from_buffer(memory, 8 * index)

    def adopt(self, state: DriverState) -> None:
        """Do nothing. Only a driver by Taylor series replaces the array `state.y` by its own."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps; write accepted ones to `times` (c,) and `rows` (c, 2n). Return why they stopped."""
        self._work[self._entries] = state.y
        self._use(state)
        if state.integers[DriverState.RECORD]:
            self._budget = None
            self._call.give(budget=budget, times=times, rows=rows)
        elif budget != self._budget:
            self._budget = budget
            self._call.give(budget=budget, times=None, rows=None)
        before = state.integers[DriverState.STEPS]
        try:
            outcome: Outcome = OUTCOMES[self._call()]
        finally:
            state.y[:] = self._work[self._entries]
        self.count(state.integers[DriverState.STEPS] - before)
        return outcome

    def _use(self, state: DriverState) -> None:
        """Pass the arrays of `state` to the loop over steps, unless the loop already has the arrays of this run."""
        if state is not self._state:
            self._state = state
            self._call.give(**state.records())

    def function(self, state: DriverState) -> StepFunction:
        """Return the compiled function by which another compiled loop lets this driver take steps of the run `state`.

        After many steps the result changes: it is then a function with optimized code.
        """
        self._use(state)
        self._budget = None
        if self._function is None:
            loop, call = self._loop, self._call
            self._function = StepFunction(loop.steps, call.words, self._work, self._entries)
        return self._function

    def count(self, steps: int) -> None:
        """Add `steps` to the number of steps taken. After many steps, optimized code is compiled and used."""
        if self._call.count(steps):
            self._function = None


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return {graph node: its value} for the coefficients of the step program `step` at time t with step size h.

    A coefficient, such as h/6, multiplies a vector of the step. `ratio` is h divided by the previous step size.
    `scalars` is the program that computes all coefficients; it is built once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))


WATCHED = (
    *((name, name) for name in ("tilts", "sides", "settings", "combinations", "switch_rows", "switch_combinations")),
    *((name, name) for name in ("scratch", "whole_scratch")),
    *((f"event_{name}", name) for name in ("times", "states", "places")),
)
"""Arrays of an `EventMemory`: pairs of the name as an argument of the loop over steps, and the name as an attribute."""


class SeriesDriver:
    """Advances a run by Taylor steps of one `order` (implements `Driver`).

    `parameters` (k + s,) are k parameters of the model, then one entry for each of the s switching surfaces. This
    entry is the sign of the surface's function, 1.0 or -1.0, or 0.0 if the motion stays on the surface.
    """

    def __init__(self, machine: Machine, code: SeriesCode, order: int, parameters: FloatArray) -> None:
        self._machine, self._code, self._call = machine, code, code.loop.bound()
        self._work = workspace(code.layout.size(order))
        self._y = self._work[: code.layout.dimension]
        self._call.give(jet=code.function, work=self._work, held=HELD.structure(), order=order)
        self._budget: int | None = None
        """Largest number of steps that was last passed to the loop, or None if it must be passed again."""
        self._is_final = False
        self._state: DriverState | None = None
        self._outputs: Outputs | None = None
        self._memory: EventMemory | None = None
        self._numbers: FloatArray | None = None
        projection = code.program.projection
        self._projection = None if projection is None else code.load(projection)
        self._parameters = parameters
        if not code.layout.watched:
            self.use(parameters)

    def use(self, parameters: FloatArray) -> None:
        """Change the parameters (k + s,) for the rest of the run: k values, then the signs of the s switching surfaces.

        A sign is that of the surface's function: 1.0, -1.0, or 0.0 if the motion stays on the surface.
        """
        self._parameters, memory, code = parameters, self._memory, self._code
        if self._projection is not None:
            callback = self._machine.callback(self._projection, parameters[: len(parameters) - code.program.sides])
            self._call.give(projection=callback.function, projection_numbers=callback.numbers)
        numbers, sizes = code.joined(parameters, None if memory is None else memory.values)
        if memory is None or not memory.surfaces:
            if memory is not None:
                memory.store_sides(parameters[:0], 0)
            self._numbers = numbers
            self._point(numbers, sizes)
            return
        offset = memory.store_sides(parameters[len(parameters) - memory.surfaces :], len(numbers))
        if self._numbers is None:
            self._numbers = np.zeros(len(numbers) * (1 + len(memory.combinations)))
            self._point(self._numbers, sizes)
        self._numbers[offset : offset + len(numbers)] = numbers

    def _point(self, numbers: FloatArray, sizes: Sequence[int]) -> None:
        """Pass parts of `numbers` to the loop over steps as its arguments `prepared`, `constants` and `value_numbers`.

        The parts follow one another, with the lengths `sizes`. `prepared` has the parameters and the values that depend
        only on them. `constants` are other numbers of the series. `value_numbers` are read by the kernel of the event
        functions.
        """
        begin = 0
        for name, size in zip(("prepared", "constants", "value_numbers"), sizes, strict=False):
            self._call.give(**{name: numbers[begin:]})
            begin += size

    def watch(self, memory: EventMemory) -> None:
        """Let the loop over steps search for zeros of the event functions and switching surfaces of `memory`.

        The loop writes the events that it finds to `memory`.
        """
        self._memory, self._numbers, code = memory, None, self._code
        self._call.give(watch=memory.record, sizes=code.layout.sizes)
        self._call.give(**{name: getattr(memory, attribute) for name, attribute in WATCHED})
        if memory.values is not None:
            self._call.give(values=self._machine.callback(memory.values, self._parameters).function)
        self.use(self._parameters)
        if memory.resets is not None:
            self._resets = code.load(memory.resets.program)
            callback = self._machine.callback(self._resets, memory.parameters)
            self._call.give(resets=callback.function, reset_numbers=callback.numbers)

    def restart(self, state: DriverState) -> None:
        """Set the rounding errors of the state's entries to zero, because the state has jumped.

        The loop carries these errors from step to step, for compensated sums.
        """
        layout = self._code.layout
        self._work[layout.lost : layout.lost + layout.padded] = 0.0
        state.taylor.low = 0.0

    def adopt(self, state: DriverState) -> None:
        """Replace the array `state.y` by the driver's own array, so that steps do not copy the state."""
        state.y = self._y

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps; write accepted ones to `times` (c,) and `rows` (c, 2n). Return why they stopped."""
        if state is not self._state:
            self._state = state
            if self._memory is None and self._code.layout.watched:
                # Without a search for events the loop returns before each step that may cross a switching surface.
                program = self._code.program
                reactions = [Reaction()] * (len(program.watched) - program.sides)
                self.watch(EventMemory(program.states, program.sides, reactions))
            self._call.give(**state.records(), taylor=state.taylor)
        if state.outputs is not self._outputs:
            outputs = self._outputs = state.outputs
            self._call.give(outputs=outputs.record, output_times=outputs.times, output_states=outputs.states)
        foreign = state.y is not self._y
        if foreign:
            self._y[:] = state.y
        if state.integers[DriverState.RECORD]:
            self._budget = None
            self._call.give(budget=budget, times=times, rows=rows)
        elif budget != self._budget:
            self._budget = budget
            self._call.give(budget=budget)
        before = state.integers[DriverState.STEPS]
        try:
            outcome: Outcome = OUTCOMES[self._call()]
        finally:
            if foreign:
                state.y[:] = self._y
        if not self._is_final:
            self._count(state.integers[DriverState.STEPS] - before)
        return outcome

    def _count(self, steps: int) -> None:
        """Add `steps` to the number of steps taken. After many steps, optimized code is compiled and used."""
        self._call.count(steps)
        if self._code.count(steps):
            self._call.give(jet=self._code.function)
        self._is_final = self._call.is_final and self._code.is_final
