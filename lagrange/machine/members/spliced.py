"""A procedure in lanes inside another function: its arguments and results are vectors."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import splat
from lagrange.machine.llvm.procedures import INLINE_ANGLES, number_of_angles
from lagrange.machine.members.memory import HeldMemory
from lagrange.machine.members.printer import MemberPrinter, MemberProgram
from lagrange.procedure.form import FLAG, Kind, Leave, Procedure
from lagrange.procedure.spread import COMMON, OWN
from lagrange.procedure.visit import visits


class SplicedPrinter(MemberPrinter):
    """Prints a procedure for all lanes. Each lane has its own numbers, and lanes share the arrays."""

    def __init__(self, e: Emitter, program: MemberProgram, procedure: Procedure) -> None:
        signature = tuple(OWN if isinstance(one.type, Kind) else COMMON for one in procedure.parameters)
        super().__init__(program, procedure, signature, e)
        self.mask = splat(e, "true", FLAG, self.lanes)
        self.angles_inline = number_of_angles(procedure.body) <= INLINE_ANGLES
        self.found: list[str] = []

    def results(self, arguments: Sequence[str]) -> list[str]:
        """Print the procedure for some arguments, and return its results, vectors over the lanes."""
        for one, argument in zip(self.procedure.parameters, arguments, strict=True):
            if isinstance(one.type, Kind):
                self.define(one.ref, argument, one.type)
            else:
                self.types[one.ref], self.places[one.ref] = one.type, HeldMemory(argument, own=False)
        self.block(self.procedure.body)
        return self.found

    @visits(Leave)
    def leave(self, leave: Leave) -> None:
        """Store the results; a spliced procedure does not return."""
        self.found = [self.operand(ref, self.lanes) for ref in leave.values]
