"""Replace function parameters of procedures by known functions, and drop parameters that are never used.

This turns a procedure for any right-hand side into one for a given right-hand side, without function pointers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lagrange.errors import LagrangeError
from lagrange.procedure.form import (
    Block,
    Call,
    Callee,
    Procedure,
    Statement,
    rebuilt,
)
from lagrange.procedure.verify import verify
from lagrange.procedure.visit import reads

Functions = Mapping[str, Procedure]


def bound(procedure: Procedure, functions: Functions, *, prefix: str = "") -> Procedure:
    """Return a procedure in which `functions` replace the parameters with their names.

    Parameters that nothing reads are dropped, here and in callees, but the signatures of `functions` stay. `prefix` is
    added to the names of all procedures except `functions`. Raises LagrangeError if a procedure calls a function
    parameter that `functions` lacks.
    """
    return _Binder(prefix).bound(procedure, tuple(sorted(functions.items())))


class _Binder:
    """Binds procedures, each once for the same functions."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.known: dict[tuple[Procedure, tuple[tuple[str, Procedure], ...]], Procedure] = {}
        self.kept: dict[Procedure, tuple[bool, ...]] = {}
        """For each procedure and parameter, True if its bound form still has the parameter."""

    def bound(self, procedure: Procedure, functions: tuple[tuple[str, Procedure], ...]) -> Procedure:
        key = procedure, functions
        if key not in self.known:
            self.known[key] = self._made(procedure, dict(functions))
        return self.known[key]

    def _made(self, procedure: Procedure, functions: Functions) -> Procedure:
        given = {one.ref: functions[one.name] for one in procedure.parameters if one.name in functions}
        body = self._block(procedure.body, given)
        read = reads(body)
        kept = tuple(one.ref in read and one.ref not in given for one in procedure.parameters)
        for one, keep in zip(procedure.parameters, kept, strict=True):
            if keep and isinstance(one.type, Callee):
                raise LagrangeError(f"procedure {procedure.name} calls {one.name}, which is not given.")
        parameters = tuple(one for one, keep in zip(procedure.parameters, kept, strict=True) if keep)
        made = replace(procedure, name=self.prefix + procedure.name, parameters=parameters, body=body)
        verify(made)
        self.kept[made] = kept
        return made

    def _block(self, block: Block, given: Mapping[int, Procedure]) -> Block:
        return tuple(self._statement(one, given) for one in block)

    def _statement(self, statement: Statement, given: Mapping[int, Procedure]) -> Statement:
        if isinstance(statement, Call):
            return self._call(statement, given)
        return rebuilt(statement, lambda block: self._block(block, given))

    def _call(self, call: Call, given: Mapping[int, Procedure]) -> Call:
        if not isinstance(call.callee, Procedure):
            return call._replace(callee=given.get(call.callee, call.callee))
        pairs = tuple(zip(call.callee.parameters, call.args, strict=True))
        functions = tuple(sorted((one.name, given[arg]) for one, arg in pairs if arg in given))
        made = self.bound(call.callee, functions)
        args = tuple(arg for arg, keep in zip(call.args, self.kept[made], strict=True) if keep)
        return call._replace(callee=made, args=args)
