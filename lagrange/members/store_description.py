"""Describe an ensemble for its store, and name its results in stores and tables."""

from __future__ import annotations

import hashlib
import importlib.metadata
import tomllib
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError, listing, shown
from lagrange.members.jobs import Job
from lagrange.members.results import OUTPUTS, STATE, Column
from lagrange.members.table import MemberTable
from lagrange.statement.expression import real_number
from lagrange.statement.scene.writer import scene_text
from lagrange.trajectory.plan import Stepped

MEMBER, CHECKSUM, BLOCK, VARIABLE = "member", "checksum", "block", "variable"
"""Names in a store: the dimension of members, the variable with checksums, and the two dimensions of this variable."""

OVER = "÷"
"""Character that replaces a slash in the names of a store's variables, because zarr takes a slash for a folder."""


def stored_names(column: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the variables in a store that contain a result column.

    A column of states has one variable for each entry of the state, named by `names`. Other columns have one variable.
    """
    if column == STATE:
        return tuple(f"{name}_end" for name in names)
    return names if column == OUTPUTS else (column.replace("/", OVER),)


def start_name(label: str, names: Collection[str]) -> str:
    """Return the name of the variable in a store with the values of `label`, a key that varies between members.

    If the key is an entry of the state, one of `names`, the name gets the suffix `_start`, because the entry's own name
    belongs to its values at output times.
    """
    return f"{label}_start" if label in names else label


def check_names(columns: Sequence[Column], names: Sequence[str], labels: Sequence[str], *, store: bool) -> None:
    """Raise StatementError if a coordinate, velocity or varying parameter has the same name as a result.

    `columns` describe the results, `names` are the names of the entries of the state, and `labels` the names of the
    values that vary. If `store` is True, the name must also differ from that of the checksums in a store.
    """
    kept = {column.name for column in columns}
    taken = {MEMBER, *kept - {STATE, OUTPUTS}, *((CHECKSUM,) if store else ())}
    taken.update(
        dimension for column in columns if column.name not in (STATE, OUTPUTS) for dimension in column.dimensions
    )
    taken.update(f"{name}_start" for name in names if name in labels)
    if STATE in kept:
        taken.update(f"{name}_end" for name in names)
    result_names = [*(names if kept & {STATE, OUTPUTS} else ()), *labels]
    twice = next((name for name in result_names if name in taken), None)
    if twice is not None:
        raise StatementError(
            f"the system has the name {twice!r}, which is also the name of a result of the ensemble: rename it in the "
            "system, or keep another result."
        )


VERSIONS = ("numpy", "llvmlite")
"""Packages whose versions a store records, because they may affect the last digits of results."""

LONG_ENTRIES = ("statement", "steps", "values", "events", "expressions")
"""Entries of an ensemble's description whose values are not printed in messages: long texts and checksums."""


def origin(job: Job, table: MemberTable, block: int) -> dict[str, Any]:
    """Return the description of an ensemble for its store: versions, statement, method, options and initial values.

    It can be written as JSON. A store can be continued only by an ensemble with the same description. `block` is the
    number of members in a block of the store.
    """
    problem, options = job.problem, job.options
    varied = hashlib.sha256()
    for values in table.varied.stated.values():
        varied.update(np.ascontiguousarray(values).tobytes())
    # Numbers of NumPy and SymPy become floats for JSON.
    stated = {name: getattr(options, name) for name in ("rtol", "atol", "step")}
    numbers = {name: None if value is None else real_number(value, name) for name, value in stated.items()}
    events = []
    for event in problem.events:
        resets = [[str(key), _exactly(value)] for key, value in {**event.reset, **event.settings}.items()]
        events.append([_exactly(event.expression), event.direction, event.terminal, resets])
    return {
        "lagrange": importlib.metadata.version("lagrange-mechanics"),
        **{name: _version(name) for name in VERSIONS},
        "statement": scene_text(problem.model.statement),
        "target": problem.model.target,
        "method": repr(options.method),
        "steps": _steps(options.method),
        **numbers,
        "max_steps": options.step_limit,
        "span": [problem.t0, problem.t1],
        "t_eval": None if problem.t_eval is None else problem.t_eval.tolist(),
        "events": events,
        "keep": [column.name for column in job.columns],
        "expressions": [_exactly(reduction.expression) for reduction in job.keep.reductions],
        "occurrences": job.keep.events,
        "varies": list(table.labels),
        "values": varied.hexdigest(),
        "drawn": [dict(reduction) for reduction in table.varied.drawn],
        "state": table.state.tolist(),
        "parameters": table.parameters.tolist(),
        "axes": {name: len(values) for name, values in table.varied.axes.items()},
        "members": len(table),
        "checksums": "blake2b",
        "block": block,
    }


def _exactly(expression: Any) -> str:
    """Return an expression as text with all digits of its numbers, which `str` would round."""
    return str(sympy.srepr(expression))


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _steps(method: Any) -> str | None:
    """Return a checksum of the steps of a method, or None for a method that has no step program.

    It is needed because methods with the same name may have different coefficients.
    """
    if not isinstance(method, Stepped):
        return None
    program, numbers = method.program, dict[int, str]()
    waiting = list(program.numbers)
    while waiting:
        number = waiting.pop()
        if number.id not in numbers:
            numbers[number.id] = repr(number)
            waiting.extend(number.args)
    # The text of a graph or a function has an address, which differs between processes.
    parts = program.name, program.law, program.actions, program.results, program.errors, program.control
    written = f"{parts}\n{sorted(numbers.items())}"
    return hashlib.sha256(written.encode()).hexdigest()


def difference(stored: Mapping[str, Any], current: Mapping[str, Any]) -> str:
    """Return a text that lists the entries in which two descriptions of an ensemble differ, or "" if they are equal.

    `stored` is the description in a store, and `current` the description of the call's ensemble.
    """
    differ = [name for name in current if stored.get(name) != current[name]]
    if not differ:
        return ""
    labels = [f"{name} (its {listing(_parts(stored, current))})" if name == "statement" else name for name in differ]
    short = next((name for name in differ if name not in LONG_ENTRIES), None)
    return listing(labels) + (
        f": {short} was {shown(stored.get(short))} and is {shown(current[short])}" if short else ""
    )


def _parts(stored: Mapping[str, Any], current: Mapping[str, Any]) -> list[str]:
    """Return the names of the parts of a statement, such as "parameters", in which those of two ensembles differ.

    `stored` is the description of the ensemble in a store, and `current` that of the call's ensemble.
    """
    try:
        old = tomllib.loads(str(stored.get("statement")))
    except ValueError:
        return ["form: a development version before lagrange 0.1.0 wrote it as JSON"]
    new = tomllib.loads(current["statement"])
    names = [name for name in {**new, **old} if name != "definitions" and old.get(name) != new.get(name)]
    return names or ["definitions"]
