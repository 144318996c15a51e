"""The compiler on one page: every stage, what goes in, what comes out, and why. Every stage is called here.

    statement   T, V, forces, ... in SymPy   -> Statement    checked once, in the user's symbols
    equations   Statement                    -> Equations    p, f, M, h, a as nodes of one graph, each computed once
    program     Equations, a name            -> Program      straight-line, parameters hoisted, checked
    machine     Program                      -> Kernel       numpy or machine code, behind one protocol
    model       all of these                 -> Model        numbers in, numbers out; kernels made when asked for
    evidence    Model, Statement             -> report       compiled against numerical differentiation of T and V
    export      Model, a target              -> files        source text for other solvers, each with a self-test
    page        Model, Derivation            -> file         a web page that computes with exported JavaScript

A stage knows nothing of the stages behind it. A run goes on from here: `lagrange.trajectory.run` takes a Model to a
Solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

from lagrange.equations.euler_lagrange import Equations
from lagrange.equations.inputs import with_needed_inputs
from lagrange.equations.multiplier_forces import with_solved_multipliers
from lagrange.equations.regularity import allowed_equations
from lagrange.errors import StatementError
from lagrange.evidence.quick import quick_check
from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, Kernel, Machine, Series
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.program.catalogue import lower_nodes, program_of
from lagrange.program.switching import Switched
from lagrange.program.taylor import series_program
from lagrange.recipes.model import Model
from lagrange.statement.choice import one_of
from lagrange.statement.given import require_formulas, with_inputs
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.projection import Projection

MACHINES = {"llvm": "lagrange.machine.llvm_machine:LlvmMachine", "numpy": "lagrange.machine.numpy_machine:NumpyMachine"}
"""Every target by name. A machine is imported when it is first asked for: numpy runs where llvmlite is missing."""


@dataclass(frozen=True)
class Stages:
    """The stages behind the equations, each run when a model asks for it; see `lagrange.machine.model.Made`."""

    equations: Equations
    machine: Machine

    def kernel(self, name: str) -> Kernel:
        """Return the kernel of a quantity."""
        return self.machine.load(program_of(name, self.equations))

    def interpreted(self, name: str) -> Kernel:
        """Return a quantity for a few states, for which compiling would take longer."""
        return InterpretedKernel(program_of(name, self.equations))

    def function(self, name: str, nodes: Sequence[Node]) -> Kernel:
        """Return any nodes of the equations' graph as a function, interpreted."""
        return InterpretedKernel(lower_nodes(name, nodes, self.equations))

    def series(self, watched: tuple[Node, ...]) -> tuple[Series, Switched]:
        """Return the Taylor series of the motion with what is watched, and its switching surfaces."""
        program, switched = series_program(self.equations, watched)
        return self.machine.series(program), switched

    @property
    def again(self) -> Callable[[Statement], Model]:
        """What makes the model of a statement on the same machine; it pickles without the equations of this one."""
        return partial(_on_machine, self.machine.name)


def reached(statement: Statement, equations: Equations, states: FloatArray, parameters: FloatArray) -> list[FloatArray]:
    """Return the projections of states (2n, k) onto the constraints, those that exist."""
    projection = Projection(Model(statement, equations, Stages(equations, machine("numpy"))), 0.0, parameters)
    found = (projection.reached(state) for state in states.T)
    return [state for state in found if state is not None]


def _on_machine(target: str, statement: Statement) -> Model:
    """Return a model that was pickled, on its machine; by numpy, as its target says, where that is not installed."""
    try:
        on = machine(target)
    except StatementError:
        on = machine("numpy")
    return model_of(statement, on)


def model_of(statement: Statement, on: Machine, equations: Equations | None = None) -> Model:
    """Return a model whose kernels are compiled when they are first used; open given functions are inputs.

    `equations` are those of the statement, made anew where it has inputs. Raises StatementError for a statement with
    functions of coordinates that are not written out.
    """
    require_formulas(statement)
    statement = with_solved_multipliers(with_inputs(statement))
    laws = allowed_equations(statement, reached) if equations is None or statement.inputs else equations
    if statement.inputs:
        statement, laws = with_needed_inputs(statement, laws)
    return Model(statement, laws, Stages(laws, on))


def compile_model(statement: Statement, equations: Equations, target: str = "llvm", *, check: bool = True) -> Model:
    """Compile the right-hand side for a target, and check it at a point unless told not to.

    Other kernels of the model (energy, Jacobian, a batch of states) are compiled when they are first used.
    Raises StatementError for an unknown target, RunError if the check fails.
    """
    model = model_of(statement, machine(target), equations)
    model.kernel("rhs")
    if check:
        quick_check(model)
    return model


def machine(target: str) -> Machine:
    """Return the machine of a target. Raises StatementError for an unknown one, or one that is not installed."""
    one_of(target, MACHINES, "there is no target {given}; the targets are {known}.")
    try:
        made: Machine = _loaded(MACHINES[target])()
    except ImportError as error:
        raise StatementError(
            f"target {target!r} needs a package that is missing ({error}): use target='numpy'."
        ) from error
    return made


def _loaded(place: str) -> Any:
    """Return what a module has under a name, from "module:name"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
