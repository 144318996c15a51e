"""The race of methods for a system: which one gets how close, in what time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from lagrange.errors import StatementError, shown
from lagrange.evidence import work_precision
from lagrange.evidence.work_precision import TOLERANCES
from lagrange.machine.model import Model
from lagrange.show.race import Race
from lagrange.statement.given import require_values
from lagrange.statement.number import real_number
from lagrange.system import System


def race(
    system: System | Model,
    t_end: float | None = None,
    initial: Mapping[Any, Any] | None = None,
    *,
    methods: Iterable[Any] | None = None,
    tolerances: Iterable[float] = TOLERANCES,
    steps: Iterable[float] | None = None,
    parameters: Mapping[Any, Any] | None = None,
    reference: ArrayLike | str | Any = None,
    digits: int | None = None,
    outputs: int | None = None,
    relative: bool = False,
    repeats: int = 5,
    max_wall: float = 10.0,
) -> Race:
    """Measure error against time for integration methods, and return the Race: a table, a plot, a CSV file.

    `methods` are registered names or instances; without them ten of our own
    and two of SciPy's take part, one or two of a kind; those that the system does not suit are left out with a note.
    Adaptive ones run at each of `tolerances` (rtol; the absolute one follows the scale), others at each of `steps`,
    whose default fits the motion.
    An error is the largest of the final state, in the units of its entries; `relative` divides each entry by its
    largest magnitude along the run, and `outputs` looks at that many equally spaced times instead of the end, as a
    run gives them with `t_eval`. Times are the least of `repeats` warm runs, in seconds, as `lg.flow` makes them where
    only the end counts. A run that takes longer than `max_wall` seconds is ended, and finer ones are left out.

    Errors are against a run of `digits` digits, 22 by default, that is independent of everything compiled. A second
    such run bounds its own error, and none is reported below that. `reference` puts something else in its place:
    the final state (2n,), or the states (2n, outputs), or a method. Raises StatementError for a request that cannot
    be meant, RunError where there is no end to race for, or no reference.
    """
    if not isinstance(system, (System, Model)):
        raise StatementError(f"{shown(system)} is no system: give an lg.System, such as lg.scene('kepler').")
    end = real_number(system.statement.run.t_end if t_end is None else t_end, "t_end")
    span = (0.0, end)
    settings = work_precision.race_settings(
        span,
        tolerances=tolerances,
        steps=steps,
        repeats=repeats,
        max_wall=max_wall,
        outputs=outputs,
        relative=relative,
        digits=digits,
    )
    require_values(system.statement)
    model = system if isinstance(system, Model) else system.compile()
    result = work_precision.race(model, span, initial, parameters, methods, settings, reference)
    return Race(result, model.statement.name, span, relative=relative)
