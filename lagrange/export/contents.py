"""`system.export`: choose the exported quantities, integrators and run, compute their tests, and write the files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import methodcaller
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.algorithm.kernel.body import PreparedLayout
from lagrange.algorithm.kernel.kernels import guarded, kernel, prepare
from lagrange.algorithm.series.exported_integrator import TaylorProcedures
from lagrange.algorithm.step.error_control import adaptive_run, one_step
from lagrange.algorithm.step.memory import Layout
from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.export.module import (
    COMMENT_WIDTH,
    ExportedIntegrator,
    ExportedQuantity,
    ExportedRun,
    SourceModule,
    ValueNames,
    ascii_name,
    statement_lines,
    wrapped,
)
from lagrange.export.programs import check_of, in_python, prepared_numbers, step_check
from lagrange.export.target import QUANTITIES, SOLVED, Target, able_targets, check_operations, find
from lagrange.graph import node
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import with_zero_inputs
from lagrange.procedure.form import Procedure
from lagrange.procedure.rewrite import Pruner, bound
from lagrange.program.program import Program
from lagrange.program.step import LAWS, StepProgram
from lagrange.show.files.atomic_file import real_path, write_together
from lagrange.statement.coordinate import name_of
from lagrange.statement.event import Event, declare_events
from lagrange.statement.expression import entries, refusing_deep
from lagrange.statement.given.function import open_functions
from lagrange.statement.parameters import label_of, table_of
from lagrange.statement.statement import energy_unit, length_unit, unit_of
from lagrange.trajectory.constraints.consistent import complete_start
from lagrange.trajectory.methods import registry
from lagrange.trajectory.methods.splitting import check_separable
from lagrange.trajectory.methods.tolerances import STEPS_UNDER_BRIEF_FORCE

DEFAULT = ("rhs", "energy")  # Default contents of an export

STEP, MAIN, TAYLOR = "step", "main", "taylor"
STEP_METHOD, ADAPTIVE_METHOD = "rk4", "dop853"  # Default methods of the contents "step" and "main"
INTERVALS = 1000  # Default number of intervals between the rows that `main` writes
MAIN_RTOL = 1e-12  # Relative tolerance of `main`, unless that of the scene is tighter


@dataclass(frozen=True)
class ExportContents:
    """The contents of an export: names of quantities, and pairs of the name of a method and its step program.

    `main` is True if a program or model that runs from the initial state is exported. `taylor` is True if the Taylor
    integrator is exported.
    """

    quantities: tuple[str, ...]
    methods: tuple[tuple[str, StepProgram], ...]
    main: bool
    taylor: bool


def contents_of(
    target: Target,
    model: Model,
    contents: Sequence[str] | None,
    events: Sequence[Event],
    parameters: Mapping[Any, Any] | None,
) -> ExportContents:
    """Return the contents of an export: those that are requested by name, and others that the requested ones need.

    `contents` are the requested names, or None for the default contents. `events` are the events to export, and
    `parameters` values that replace the stated ones. Raises StatementError for contents that the system or the target
    does not have.
    """
    requested = [*DEFAULT, *(["events"] if events else [])]
    if contents is not None:
        requested = [] if isinstance(contents, str) else entries(contents, "contents") or []
    if not requested or not all(isinstance(entry, str) for entry in requested):
        raise StatementError(f"contents is {shown(contents)}: give a list of names, such as ['rhs', 'energy'].")
    names = list(dict.fromkeys((*target.always, *requested)))
    quantities = [name for name in QUANTITIES if name in names]
    methods = [name for name in names if name not in (*QUANTITIES, STEP, MAIN, TAYLOR)]
    methods += [STEP_METHOD] * (STEP in names)
    runs_itself = TAYLOR in names or any(_is_adaptive(name) for name in methods)
    if MAIN in names and not runs_itself and target.contents & {"steps", "runs"}:
        methods.append(ADAPTIVE_METHOD)
    _refuse(target, model, names, methods, events)
    if MAIN in names and MAIN not in target.always:
        _refuse_without_inputs(model, parameters)
    steps = tuple((name, step_of(name)) for name in dict.fromkeys(methods))
    if (steps or not quantities) and "rhs" not in quantities:
        quantities.insert(0, "rhs")
    return ExportContents(tuple(quantities), steps, MAIN in names, TAYLOR in names)


def _is_adaptive(name: str) -> bool:
    return name in registry.names() and registry.find(name).claims.adaptive


def _refuse(
    target: Target, model: Model, names: Sequence[str], methods: Sequence[str], events: Sequence[Event]
) -> None:
    """Raise StatementError for contents that the system or the target does not have.

    `names` are the requested contents, `methods` are the requested or necessary integration methods, and `events` are
    the events to export.
    """
    known = [*QUANTITIES, STEP, MAIN, TAYLOR]
    for name in methods:
        if name not in registry.names():
            raise StatementError(
                f"contents has the unknown name {shown(name)}: choose from {listing(known)}, and the names of explicit "
                f"methods, such as 'dop853'.{suggestion(name, [*known, *filter(_explicit, registry.names())])}"
            )
        if step_of(name).law == "accelerations":
            check_separable(name, model)
    title = model.statement.name
    if "multipliers" in names and not model.equations.constraints.names:
        raise StatementError(f"{title} has no constraints, and so no multipliers: leave them out of contents.")
    if "positions" in names and not model.statement.positions:
        raise StatementError(
            f"{title} states no positions to export: state them, or leave 'positions' out of contents."
        )
    if "energies" in names and model.statement.lagrangian_alone:
        raise StatementError(f"{title} states its Lagrangian alone, not T and V: leave 'energies' out of contents.")
    if "events" in names and not events:
        raise StatementError(
            f"{title} has no events to export: give them, as in system.export(..., events=[theta.dot]), or leave "
            "'events' out of contents."
        )
    if events and "events" not in names:
        raise StatementError("events are given, but contents has no 'events': add it, or leave out events.")
    if TAYLOR in names and model.statement.inputs:
        raise StatementError(
            f"taylor needs every derivative of {listing(name_of(u) for u in open_functions(model.statement))}, which "
            "has no formula: export a method such as 'dop853', or give it values with system.substitute()."
        )
    if "runs" in target.contents:
        _refuse_runs(target, methods)
    steps = bool(methods) and "runs" not in target.contents
    requested = {"steps": steps, "main": MAIN in names, "taylor": TAYLOR in names}
    lacking = [kind for kind, asked in requested.items() if asked and kind not in target.contents]
    if lacking:
        what = listing(methods) if lacking[0] == "steps" else lacking[0]
        able = able_targets(lambda candidate: lacking[0] in candidate.contents)
        raise StatementError(f"target {target.name!r} has no {what}: leave it out of contents, or take {able}.")


def _refuse_without_inputs(model: Model, parameters: Mapping[Any, Any] | None) -> None:
    """Raise StatementError if an input, a known function of time without a formula, has no value in `parameters`.

    An exported run needs the values, because inputs are constant during the run. The derivatives of an input need no
    values, because they are zero.
    """
    if isinstance(parameters, np.ndarray):  # an array has the values of all parameters
        return
    stated = {label_of(key) for key in table_of(parameters, "parameters", "parameter to value")}
    rates = {rate for _, rate in model.statement.inputs}
    missing = [symbol.name for symbol, _ in model.statement.inputs if symbol not in rates and symbol.name not in stated]
    if missing:
        raise StatementError(
            f"main runs the system, and its {'input' if len(missing) == 1 else 'inputs'} {listing(missing)} "
            f"{'has' if len(missing) == 1 else 'have'} no value: give a constant value, as in parameters="
            f"{{'{missing[0]}': 1.0}}, or leave main out of contents and call the step with your own values."
        )


def _refuse_runs(target: Target, methods: Sequence[str]) -> None:
    """Raise StatementError for `methods` that do not fit a target whose files integrate with one method only.

    Such a target has at most one method, and the method must have error control.
    """
    plain = [name for name in methods if not _is_adaptive(name)]
    if plain:
        raise StatementError(
            f"target {target.name!r} runs with error control, which {listing(plain)} "
            f"{'does' if len(plain) == 1 else 'do'} not have: leave it out of contents, or give a method such as "
            "'dop853'."
        )
    if len(methods) > 1:
        raise StatementError(
            f"target {target.name!r} has one method, and contents has {listing(methods)}: leave all but one out."
        )


def _explicit(name: str) -> StepProgram | None:
    """Return the step program of an explicit method by name, or None for any other method."""
    program = getattr(registry.find(name), "program", None)
    explicit = isinstance(program, StepProgram) and not program.solves and program.starter is None
    return program if explicit else None


def step_of(name: str) -> StepProgram:
    """Return the step program of an explicit method by name. Raises StatementError for any other method."""
    program = _explicit(name)
    if program is not None:
        return program
    raise StatementError(
        f"the method {name!r} cannot be exported: give an explicit method, such as 'rk4', 'verlet' or 'dop853'."
    )


def module_of(
    model: Model, requested: ExportContents, events: Sequence[Event], parameters: Mapping[Any, Any] | None = None
) -> SourceModule:
    """Return the data of an export that all languages share: the contents `requested`, with `events`, and their tests.

    `parameters` replace default values. Raises StatementError for missing values, and if no test state has values.
    """
    statement = model.statement
    values = tuple(map(float, model.parameter_array(with_zero_inputs(model.statement, parameters))))
    state = statement.state_names
    programs = {name: _program(name, model, events) for name in requested.quantities}
    projected = (bool(requested.methods) or requested.taylor) and bool(model.equations.constraints.names)
    called = [*(LAWS[step.law].quantity for _, step in requested.methods), *(["projection"] if projected else [])]
    every = programs | {name: model.law(name).program for name in called}
    alone = divisors(model) if any(name in SOLVED for name in programs) else None
    prepared = PreparedLayout.of([*every.values(), alone] if alone else [*every.values()])
    names = names_of(model)
    procedures = {name: kernel(item, prepared, name, ABOUT[name], names=names.of(item)) for name, item in every.items()}
    if alone:
        divided = kernel(alone, prepared, "divisors", ABOUT["divisors"], names=names.of(alone))
        procedures |= {name: guarded(procedures[name], divided) for name in (*SOLVED, "local") if name in procedures}
    prune = Pruner().pruned
    integrators = tuple(_integrator(name, step, model, procedures, prune) for name, step in requested.methods)
    tested = fixed(alone, prepared) if alone else ()
    preparing = prepare(prepared, PREPARE, names=names.of(prepared.program), divisors=tested)
    size = prepared.size
    if requested.taylor:
        least = STEPS_UNDER_BRIEF_FORCE if model.equations.structure.brief else 0
        program, projection = model.series()[0].program, procedures.get("projection")
        known = {"relations": bool(model.equations.first_order), "rotations": bool(statement.rotations)}
        series = TaylorProcedures(program, prepared.size, least, projection, **known)
        preparing, size = series.prepare(preparing), prepared.size + series.numbers.size
        integrators = (*integrators, ExportedIntegrator(TAYLOR, prune(series.taylor()), adaptive=True))
    preparing = prune(preparing)
    p = prepared_numbers(preparing, size, statement, values)
    procedures |= {name: prune(procedures[name]) for name in programs}
    quantities = _quantities(model, programs, procedures)
    about = MASS + GRADIENT * bool(model.equations.constraints.names)
    return SourceModule(
        name=ascii_name(statement.name).lower(),
        statement=(*statement_lines(statement, events), *wrapped(about, COMMENT_WIDTH)),
        state=state,
        parameters=names.parameters,
        names=names,
        inputs=tuple(symbol.name for symbol, _ in statement.inputs),
        values=values,
        units={name: unit for name in (*state, *names.parameters, "t") if (unit := unit_of(statement, name))},
        prepare=preparing,
        prepared=size,
        quantities=quantities,
        integrators=integrators,
        checks=tuple(
            check_of(item.name, item.program, in_python(item.procedure, p, len(item.results)), statement, values)
            for item in quantities
        ),
        step_checks=tuple(step_check(item, p, statement) for item in integrators),
        run=_run(model, np.array(values)) if requested.main else None,
        divisors=alone,
        about=" ".join(statement.about.split()),
    )


def names_of(model: Model) -> ValueNames:
    """Return names for values in an exported file: state, parameters, and entries of [[M, G^T], [G, 0]].

    M is the mass matrix, and G has the gradients of the constraints. The name of an entry contains the names of its
    two coordinates, or of its constraint and its coordinate.
    """
    statement, equations = model.statement, model.equations
    rows, entries = [*statement.names, *equations.constraints.names], dict[node.Node, str]()
    for i, row in enumerate(equations.matrix):
        for j, entry in enumerate(row[: i + 1]):
            mass = i < len(statement.names)
            entries.setdefault(entry, f"mass_{rows[j]}_{rows[i]}" if mass else f"gradient_{rows[i]}_{rows[j]}")
    parameters = tuple(p.name for p in statement.parameters)
    matrix = model.function("matrix", tuple(entries)).program
    return ValueNames(statement.state_names, parameters, tuple(entries.values()), matrix)


MASS = "mass_a_b: the entry of the mass matrix for the coordinates a and b"
GRADIENT = "; gradient_c_a: the derivative of the constraint c by the coordinate a, or by its velocity"
"""Comments for an exported file that explain the names of matrix entries."""

PREPARE = "Write the parameters into p, then the values that depend on parameters alone."


def _program(name: str, model: Model, events: Sequence[Event]) -> Program:
    statement = model.statement
    stated: dict[str, list[Any]] = {
        "events": [event.expression for event in events],
        "positions": [entry for point in statement.drawn.values() for entry in point],
        "energies": [statement.kinetic, statement.potential],
    }
    if name not in stated:
        return model.law(name).program
    return model.function(name, tuple(map(model.equations.translate, stated[name]))).program


def _integrator(
    name: str,
    step: StepProgram,
    model: Model,
    procedures: Mapping[str, Procedure],
    prune: Callable[[Procedure], Procedure],
) -> ExportedIntegrator:
    """Return the integrator of the method `name`: a procedure for one step, or for a run with error control.

    `procedures` has by name the right-hand side that the method calls, and the projection onto constraints if there are
    constraints. `prune` removes values that no statement reads.
    """
    identifier, law = name.replace("-", "_"), procedures[LAWS[step.law].quantity]
    laws = {"law": law, "jacobian": law}
    if "projection" in procedures:
        laws["projection"] = procedures["projection"]
    layout, control = Layout(step, model.layout.size, block=1, projected="projection" in laws), step.control
    relations = bool(model.equations.first_order)
    if control is None:
        form = one_step.form(layout=layout, relations=relations)
    else:
        unlimited = tuple(model.equations.following) if model.equations.rates_are_solved else ()
        form = adaptive_run.form(layout=layout, control=control, relations=relations, unlimited=unlimited)
    procedure = replace(
        bound(form, laws, prefix=f"{identifier}_"),
        name=identifier,
        about=f"{form.about} The method is {step.name}.",
    )
    return ExportedIntegrator(identifier, prune(procedure), control is not None)


ABOUT = {
    "rhs": "The right-hand side of y' = f(t, y).",
    "accelerations": "The accelerations.",
    "energy": "The energy v.p - L, which is T + V where T is quadratic in the velocities.",
    "jacobian": "The derivative of the right-hand side by the state, by rows.",
    "mass_matrix": "The mass matrix, by rows.",
    "energies": "The kinetic energy T and the potential energy V, as stated.",
    "momenta": "The conjugate momenta dL/dv.",
    "projection": "Corrections onto the constraints.",
    "divisors": "The entries of the matrix that are divided by.",
    "local": "The derivatives of a local state about a start, then the state that it is: coordinates and velocities.",
    "positions": "The named points, coordinate by coordinate.",
    "multipliers": "The multipliers of the constraints.",
    "events": "The event functions, each zero where its event is.",
}


def _quantities(
    model: Model, programs: Mapping[str, Program], procedures: Mapping[str, Procedure]
) -> tuple[ExportedQuantity, ...]:
    energy = energy_unit(model.statement)
    units = {"energy": energy, "energies": energy, "positions": length_unit(model.statement)}
    return tuple(
        ExportedQuantity(
            *(name, ABOUT[name], program, procedures[name], _results(name, model, program), program.shape),
            unit=units.get(name, ""),
        )
        for name, program in programs.items()
    )


def _results(name: str, model: Model, program: Program) -> tuple[str, ...]:
    """Return the names of the results of a quantity in order: theta_dot and theta_ddot for "rhs" of a pendulum."""
    names, points = model.statement.names, model.statement.drawn.items()
    velocities, accelerations = ([f"{each}{suffix}" for each in names] for suffix in ("_dot", "_ddot"))
    rates = [*velocities, *accelerations]
    return tuple(
        {
            "rhs": rates,
            "accelerations": accelerations,
            "jacobian": [f"d{rate}/d{entry}" for rate in rates for entry in (*names, *velocities)],
            "mass_matrix": [f"M[{a},{b}]" for a in names for b in names],
            "momenta": [f"p_{each}" for each in names],
            "multipliers": [f"lambda_{each}" for each in model.equations.stated.names],
            "energy": ["energy"],
            "energies": ["kinetic", "potential"],
            "positions": [f"{each}_{axis}" for each, entries in points for axis in "xyz"[: len(entries)]],
            "events": [f"event{k}" for k in range(len(program.outputs))],
        }[name]
    )


def _run(model: Model, parameters: FloatArray) -> ExportedRun:
    settings = model.statement.run
    start = complete_start(model, 0.0, np.array(model.statement.initial), parameters)
    rtol = MAIN_RTOL if settings.rtol is None else min(MAIN_RTOL, settings.rtol)
    return ExportedRun(tuple(start.tolist()), settings.t_end, INTERVALS, rtol)


# --- divisors in formulas of accelerations, which are tested for zero


def divisors(model: Model) -> Program | None:
    """Return a program that computes the divisors in the formulas of the accelerations, or None without divisors.

    A block with one unknown in the linear system for the accelerations is solved by a division by its matrix entry. No
    factorization tests this entry for zero. Entries that are nonzero constants are left out.
    """
    equations = model.equations
    alone = [equations.matrix[block[0]][block[0]] for block in equations.plan.blocks if len(block) == 1]
    entries = tuple(dict.fromkeys(entry for entry in alone if entry.kind is not node.Kind.CONSTANT or not entry.data))
    return model.function("divisors", entries).program if entries else None


def fixed(entries: Program, prepared: PreparedLayout) -> list[int]:
    """Return the indices in the array p of the outputs of the program `entries` that depend on parameters alone.

    `prepared` is the layout of p: the parameters, then all values that depend on parameters alone.
    """
    slots, code = prepared.of_program(entries), entries.instructions
    return [
        code[ref].place if code[ref].op == "parameter" else slots[ref]
        for ref in entries.outputs
        if code[ref].op == "parameter" or ref in slots
    ]


@dataclass(frozen=True)
class Exported:
    """The result of an export: paths of the written files, and shell lines to run in their folder.

    `commands` build and run the self-test, whose exit status is 0 if all results are right. `run_commands` build and
    run `main`, which writes a table; empty if `main` is not among the contents.
    """

    files: tuple[Path, ...]
    commands: tuple[str, ...]
    run_commands: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lines = [f"wrote {path}" for path in self.files]
        return "\n".join(
            [*lines, f"to test them, in {self.files[0].parent}:", *(f"  {command}" for command in self.commands)]
        )


@refusing_deep
def export(
    model: Model,
    target: str,
    path: str | os.PathLike[str],
    contents: Sequence[str] | None,
    events: Any,
    parameters: Mapping[Any, Any] | None,
) -> Exported:
    """Write a model as source files of a target into the folder `path`, which is created if it is missing.

    `contents` are the names of quantities and methods to export, None for the defaults. `events` are the events to
    export, and `parameters` values that replace the stated ones. After an error, folders that were created are removed.
    Raises StatementError for an unknown target, and for contents that the system or the target does not have.
    """
    chosen = find(target)
    declared = () if events is None else declare_events(events, model.statement, constant="an export")
    folder = real_path(path)
    try:
        created = [ancestor for ancestor in (folder, *folder.parents) if not ancestor.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StatementError(
            f"the folder {shown(str(folder), 120)} cannot be made ({error.strerror}): name another folder for the "
            "files."
        ) from error
    try:
        module = module_of(model, contents_of(chosen, model, contents, declared, parameters), declared, parameters)
        check_operations(chosen, module)
        files = chosen.files(module)
        data = {name: text.encode("ascii") if isinstance(text, str) else text for name, text in files.items()}
        written = write_together(folder, {name: methodcaller("write", content) for name, content in data.items()})
    except BaseException:
        for new_folder in created:
            new_folder.rmdir()
        raise
    runs = [] if module.run is None else chosen.run_commands(module)
    return Exported(tuple(written), tuple(chosen.commands(module)), tuple(runs))
