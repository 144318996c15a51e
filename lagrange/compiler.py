"""The compiler on one page: every stage, what goes in, what comes out, and why.

    statement   T, V, forces, ... in SymPy   -> Statement    checked once, in the user's symbols
    equations   Statement                    -> Equations    p, f, M, h, a as nodes of one graph, each computed once
    program     Equations, a name            -> Program      straight-line, parameters hoisted, checked
    machine     Program                      -> Kernel       numpy or machine code, behind one protocol
    model       all of these                 -> Model        numbers in, numbers out; kernels made when asked for
    evidence    Model, Statement             -> verdict      compiled against numerical differentiation of T and V

A stage knows nothing of the stages behind it. A run goes on from here: `lagrange.run` takes a Model to a
Solution.
"""

from __future__ import annotations

from importlib import import_module

from lagrange.equations.euler_lagrange import Equations
from lagrange.errors import StatementError
from lagrange.evidence.quick import quick_check
from lagrange.machine.backend import Machine
from lagrange.machine.model import Model
from lagrange.statement.choice import one_of
from lagrange.statement.statement import Statement

MACHINES = {"llvm": "lagrange.machine.llvm_machine:LlvmMachine", "numpy": "lagrange.machine.numpy_machine:NumpyMachine"}
"""Every target by name. A machine is imported when it is first asked for: numpy runs where llvmlite is missing."""


def compile_model(statement: Statement, equations: Equations, target: str = "llvm", *, check: bool = True) -> Model:
    """Compile the right-hand side for a target, and check it at a point unless told not to.

    Other kernels of the model (energy, Jacobian, a batch of states) are compiled when they are first used.
    Raises StatementError for an unknown target, RunError if the check fails.
    """
    model = Model(statement, equations, machine(target))
    model.kernel("rhs")
    if check:
        quick_check(model)
    return model


def machine(target: str) -> Machine:
    """Return the machine of a target. Raises StatementError for an unknown one, or one that is not installed."""
    one_of(target, MACHINES, "there is no target {given}; the targets are {known}.")
    module, _, name = MACHINES[target].partition(":")
    try:
        made: Machine = getattr(import_module(module), name)()
    except ImportError as error:
        raise StatementError(
            f"target {target!r} needs a package that is missing ({error}): use target='numpy'."
        ) from error
    return made
