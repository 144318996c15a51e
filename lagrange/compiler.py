"""The compiler on one page: every stage, its input, its output, and its purpose. Every stage is called here.

    statement   T, V, forces, ... in SymPy   -> Statement    checked once, in the user's symbols
    equations   Statement                    -> Equations    p, f, M, h, a as nodes of one graph, each computed once
    program     Equations, a name            -> Program      straight-line, parameters hoisted, checked
    procedure   plain Python functions       -> Procedure    the typed language in which algorithms are written
    algorithm   Programs, a step             -> Procedures   solvers, steps, series, events, dense output, each once
    machine     Program, Procedures          -> Kernel       numpy or machine code, behind one protocol
    model       all of these                 -> Model        numbers in, numbers out; kernels compiled at first use
    evidence    Model, Statement             -> report       compiled against numerical differentiation of T and V
    export      Model, a target              -> files        source text for other solvers, each with a self-test
    page        Model, Derivation            -> file         a web page that computes with exported JavaScript

With coordinates q, velocities v and L = T - V: p = dL/dv are the momenta, f = dL/dq plus the generalized forces,
M = d2L/dv2 the mass matrix, h the right-hand side of M a = h, and a the accelerations.
A stage imports only the stages above it. To run a model, `lagrange.trajectory.run` takes a Model and returns a
Solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from os import PathLike

from lagrange.equations.euler_lagrange import Equations, euler_lagrange, with_needed_inputs
from lagrange.equations.regularity import allowed_equations, with_solved_multipliers
from lagrange.evidence.quick_check import quick_check
from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, Kernel, Machine, MissingTargetError, Series
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.program.catalogue import lower_nodes, program_of
from lagrange.program.switching import Switched
from lagrange.program.taylor import series_program
from lagrange.recipes.model import Model
from lagrange.show.files.loaded_run import loaded_run
from lagrange.statement.display import announced
from lagrange.statement.expression import one_of
from lagrange.statement.given.function import with_inputs
from lagrange.statement.run_settings import PreparationTooLongError, check_time
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.solution import Solution

MACHINES = {"llvm": "lagrange.machine.llvm_machine:LlvmMachine", "numpy": "lagrange.machine.numpy_machine:NumpyMachine"}
"""Class that compiles for each target, as "module:class" by the name of the target. The module is imported at first
use, so that numpy needs no llvmlite."""


@dataclass(frozen=True)
class Stages:
    """Compiles the functions of a model when they are first needed, from its `equations` and for its `machine`.

    A model calls it by the protocol `KernelProvider`.
    """

    equations: Equations
    machine: Machine

    def kernel(self, name: str) -> Kernel:
        """Return the compiled function that computes a quantity of the model, by its `name` such as "rhs"."""
        check_time()
        return self.machine.load(program_of(name, self.equations))

    def interpreted(self, name: str) -> Kernel:
        """Return the function that computes the quantity `name`, such as "rhs", by the interpreter.

        For few evaluations it is faster than a compiled one, because nothing is compiled.
        """
        return InterpretedKernel(program_of(name, self.equations))

    def function(self, name: str, nodes: Sequence[Node]) -> Kernel:
        """Return a function, not compiled, that evaluates `nodes` of the equations' graph. Messages call it `name`."""
        return InterpretedKernel(lower_nodes(name, nodes, self.equations))

    def series(self, watched: tuple[Node, ...]) -> tuple[Series, Switched]:
        """Return the compiled Taylor series of the motion and of the event functions `watched`.

        The second result describes the switching surfaces of the system, which the series watches, too.
        """
        check_time()
        program, switched = series_program(self.equations, watched)
        return self.machine.series(program), switched

    @property
    def rebuild(self) -> Callable[..., Model]:
        """Function that returns the model of a statement for the same target, for unpickling and for other statements.

        It can be pickled. Its pickle is small, because it contains no equations.
        """
        return partial(_on_machine, self.machine.name)


def reached(statement: Statement, equations: Equations, states: FloatArray, parameters: FloatArray) -> list[FloatArray]:
    """Return for each column of `states` (2n, k) the nearest state (2n,) on the constraints of a system, in a list.

    `equations` are the equations of the statement, and `parameters` the values of the parameters. States whose
    projection fails are left out.
    """
    projection = Projection(Model(statement, equations, Stages(equations, machine("numpy"))), 0.0, parameters)
    projected = (projection.reached(state) for state in states.T)
    return [state for state in projected if state is not None]


def _on_machine(target: str, statement: Statement, kept: Sequence[int] | None = None) -> Model:
    """Return the model of a pickled statement for its target, or for numpy if that target is not installed.

    `kept` has the indices of the independent constraints, so that they need not be determined again. It is None if they
    are not known.
    """
    try:
        on = machine(target)
    except MissingTargetError:
        on = machine("numpy")
    return model_of(statement, on, None if kept is None else euler_lagrange(statement, kept))


def model_of(statement: Statement, on: Machine, equations: Equations | None = None) -> Model:
    """Return the model of a statement on the machine `on`; its kernels are compiled at first use.

    Functions of time without a formula or values become inputs. `equations` are the equations of the statement, None if
    they are not derived yet; with inputs they are derived again. Raises StatementError for undefined functions of
    coordinates.
    """
    statement.require_formulas()
    statement = with_solved_multipliers(with_inputs(statement) if statement.given else statement)
    laws = allowed_equations(statement, reached) if equations is None or statement.inputs else equations
    if statement.inputs:
        statement, laws = with_needed_inputs(statement, laws)
    return Model(statement, laws, Stages(laws, on))


def compile_model(statement: Statement, equations: Equations, target: str = "llvm", *, check: bool = True) -> Model:
    """Return a model whose right-hand side is compiled for a target, and checked if `check` is true.

    Other kernels of the model, such as energy and Jacobian, are compiled when they are first used. Raises
    StatementError for an unknown target, RunError if the check fails.
    """
    with announced("compiling", statement.name, enabled=True):
        model = model_of(statement, machine(target), equations)
        try:
            model.kernel("rhs")
            if check:
                quick_check(model)
        except PreparationTooLongError as late:
            late.model = model
            raise
        return model


def machine(target: str) -> Machine:
    """Return the machine, the back end that compiles and runs programs, of a target such as "llvm".

    Raises StatementError for an unknown target, and MissingTargetError for a target that is not installed.
    """
    one_of(target, MACHINES, "there is no target {given}; the targets are {known}.")
    try:
        module, _, name = MACHINES[target].partition(":")
        result: Machine = getattr(import_module(module), name)()
    except (ImportError, OSError) as error:  # OSError: a shared library of a package cannot be loaded
        raise MissingTargetError(
            f"target {target!r} cannot be loaded ({error}): repair or install the package named in brackets"
            + ("." if target == "numpy" else ", or use system.compile('numpy'), or run(..., target='numpy').")
        ) from error
    return result


def load(path: str | PathLike[str]) -> Solution:
    """Return the run in the file `path`, which `solution.to_npz` wrote, with its system: a Solution.

    Between its outputs the run has only the states that the file stores for animations. The file has numbers and a
    scene; no code in it is executed. Raises StatementError for a file that cannot be read, or is not from `to_npz`.
    """
    return loaded_run(path, lambda statement, target: model_of(statement, machine(target)))
