"""The review of steps in machine code: one call finds the zeros of events on a whole burst of them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.machine.backend import DensePath, FloatArray
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm.address import workspace
from lagrange.machine.llvm.called import compiled
from lagrange.machine.review import Reviewed, WatchedEvents
from lagrange.procedure.dense.block import LANES, block_size
from lagrange.procedure.events.step_review import review
from lagrange.procedure.events.step_samples import work_size
from lagrange.procedure.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.program.program import Program

ROOM = 64
"""Zeros that one call has room for at least; a burst has room for one on each of its steps."""


class LlvmReview:
    """The review of events for one set of parameters; see `Review`."""

    def __init__(self, program: Program, parameters: FloatArray, dense: DensePath, screen: DensePath | None) -> None:
        self._written = dense.polynomial()
        # What solves for its stages takes steps that a cubic through their ends says little of.
        screens = screen is not None and not self._written.both
        self._screen = screen.polynomial() if screen is not None and screens else self._written
        self._kernel = kernel = _compiled_events(program)
        self._prepared = kernel.prepare(parameters)
        n, events = program.states, program.shape[0]
        self._code = compiled(review())
        written = self._written
        given: dict[str, Any] = {
            "polynomial": written.function,
            "given": written.given,
            "degree": dense.degree,
            "both": int(written.both),
            **{name: np.zeros(block_size(n, LANES) + LANES) for name in ("own", "beside")},
            "screen": self._screen.function,
            "screen_given": self._screen.given,
            # What a block polynomial is given begins with the law over columns and its parameters.
            "law": int(self._screen.given[0]),
            "law_parameters": int(self._screen.given[1]),
            "screens": screens,
            "path_work": workspace(max(written.work, self._screen.work)),
            "c": workspace((dense.degree + 1) * n * LANES + LANES),
            "kernel": kernel.columns_address,
            "parameters": self._prepared,
            "dimension": n,
            "events": events,
            "factors": 1 + RELATIVE_PERTURBATION * perturbation_factors(n + 1),
            "noted": np.zeros(3 * events, dtype=np.int64),
            "work": workspace(work_size(n, events)),
        }
        self._dimension, self._kept = n, given
        self._words = self._code.words()
        self._code.give(self._words, given)

    def __call__(
        self, times: FloatArray, states: FloatArray, begin: int, events: WatchedEvents, *, last: int, rounded: float
    ) -> Reviewed:
        """Review steps; see `Review`."""
        steps = len(times) - 1
        room = ROOM + steps - begin
        which, where = (np.empty(room, dtype=np.int64) for _ in range(2))
        when, there = np.empty(room), np.empty((room, self._dimension))
        run: dict[str, Any] = {"times": times, "states": states, "steps": steps, "begin": begin, "end": steps}
        run |= {"which": which, "where": where, "when": when, "there": there, "room": room}
        self._code.give(self._words, {**run, **events._asdict(), "last": last, "rounded": rounded})
        step, found = self._code.run_on(self._words)
        # Copies: what happened would keep room for all that might have happened.
        return Reviewed(step, which[:found].copy(), where[:found].copy(), when[:found].copy(), there[:found].copy())


@lru_cache(maxsize=64)
def _compiled_events(program: Program) -> LlvmKernel:
    """Return the events over columns, kept for other runs."""
    return LlvmKernel(program)
