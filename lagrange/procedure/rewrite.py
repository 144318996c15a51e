"""Rewrite procedures: bind function parameters, and remove values that are never read.

Binding turns a procedure for any right-hand side into one for a given right-hand side, without function pointers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import Block, Callee, Procedure, Statement, rebuilt, walk
from lagrange.procedure.verify import verify
from lagrange.procedure.visit import defined, operands, reads

Functions = Mapping[str, Procedure]


def bound(procedure: Procedure, functions: Functions, *, prefix: str = "") -> Procedure:
    """Return a procedure in which each function parameter is replaced by the entry of `functions` with its name.

    Unread parameters are dropped here and in callees, but the signatures of `functions` are unchanged. `prefix` is
    added to the names of all procedures except `functions`. Raises LagrangeError if a procedure calls a function
    parameter that `functions` lacks.
    """
    return _Binder(prefix).bound(procedure, tuple(sorted(functions.items())))


class _Binder:
    """Replaces function parameters of procedures by given functions. Each procedure is rewritten once."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.known: dict[tuple[Procedure, tuple[tuple[str, Procedure], ...]], Procedure] = {}
        self.kept: dict[Procedure, tuple[bool, ...]] = {}
        """For each procedure and each function parameter, True if the bound procedure still has that parameter."""

    def bound(self, procedure: Procedure, functions: tuple[tuple[str, Procedure], ...]) -> Procedure:
        key = procedure, functions
        if key not in self.known:
            self.known[key] = self._made(procedure, dict(functions))
        return self.known[key]

    def _made(self, procedure: Procedure, functions: Functions) -> Procedure:
        bound = {
            parameter.ref: functions[parameter.name]
            for parameter in procedure.parameters
            if parameter.name in functions
        }
        body = self._block(procedure.body, bound)
        read = reads(body)
        kept = tuple(parameter.ref in read and parameter.ref not in bound for parameter in procedure.parameters)
        for parameter, keep in zip(procedure.parameters, kept, strict=True):
            if keep and isinstance(parameter.type, Callee):
                raise LagrangeError(
                    f"procedure {procedure.name} calls its parameter {parameter.name}: give a function for it."
                )
        parameters = tuple(parameter for parameter, keep in zip(procedure.parameters, kept, strict=True) if keep)
        made = replace(procedure, name=self.prefix + procedure.name, parameters=parameters, body=body)
        verify(made)
        self.kept[made] = kept
        return made

    def _block(self, block: Block, bound: Mapping[int, Procedure]) -> Block:
        return tuple(
            self._call(statement, bound)
            if isinstance(statement, form.Call)
            else rebuilt(statement, lambda b: self._block(b, bound))
            for statement in block
        )

    def _call(self, call: form.Call, bound: Mapping[int, Procedure]) -> form.Call:
        if not isinstance(call.callee, Procedure):
            return call._replace(callee=bound.get(call.callee, call.callee))
        pairs = tuple(zip(call.callee.parameters, call.args, strict=True))
        functions = tuple(sorted((parameter.name, bound[arg]) for parameter, arg in pairs if arg in bound))
        made = self.bound(call.callee, functions)
        args = tuple(arg for arg, keep in zip(call.args, self.kept[made], strict=True) if keep)
        return call._replace(callee=made, args=args)


class Pruner:
    """Removes unread values from procedures that call each other. Each procedure is pruned once."""

    def __init__(self) -> None:
        self.known: dict[Procedure, Procedure] = {}

    def pruned(self, procedure: Procedure) -> Procedure:
        """Return a procedure without values that are never read, in it or in its callees."""
        if procedure not in self.known:
            body, got, before = procedure.body, _variables_read(procedure.body), None
            while got != before:
                body = _Pass(self, got).block(body)
                before, got = got, _variables_read(body)
            result = self.known[procedure] = replace(procedure, body=body)
            self.known[result] = result
        return self.known[procedure]


class _Pass:
    """One backward pass over a procedure, which removes statements whose results are never read.

    `got` are the ids of the variables that are read anywhere in the procedure. `needed` are the ids that later
    statements read.
    """

    def __init__(self, pruner: Pruner, got: frozenset[int]) -> None:
        self.pruner, self.got = pruner, got
        self.needed: set[int] = set()
        """Numbers that later statements read."""

    def block(self, block: Block) -> Block:
        """Return a block without statements whose results are never read."""
        kept: list[Statement] = []
        for statement in reversed(block):
            if not self.idle(statement):
                kept.append(self.statement(statement))
        return tuple(reversed(kept))

    def statement(self, statement: Statement) -> Statement:
        """Return a statement with pruned blocks and callees, and add the ids of its operands to `needed`."""
        self.needed.update(operands(statement))
        if isinstance(statement, form.Call) and isinstance(statement.callee, Procedure):
            return statement._replace(callee=self.pruner.pruned(statement.callee))
        return rebuilt(statement, self.block)

    def idle(self, statement: Statement) -> bool:
        """Return True if a statement can be removed: nothing reads what it defines or sets, or it is empty."""
        match statement:
            case form.Declare(ref=ref):
                return ref not in self.got
            case form.Set(variable=variable):
                return variable not in self.got
            case form.When(then=(), otherwise=()):
                return True
            case form.Loop() | form.Each() | form.Call():
                return False
        refs = defined(statement)
        return bool(refs) and self.needed.isdisjoint(refs)


def _variables_read(block: Block) -> frozenset[int]:
    """Return the ids of the variables that the statements of a block read."""
    return frozenset(statement.variable for statement in walk(block) if isinstance(statement, form.Get))
