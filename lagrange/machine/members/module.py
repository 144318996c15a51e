"""LLVM modules that run procedures for many members at once, and their entry points."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import declarations as all_declarations
from lagrange.machine.llvm.operations import separated, together, type_of
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA
from lagrange.machine.llvm.sine_cosine import angle_function
from lagrange.machine.members.operations import declarations
from lagrange.machine.members.printer import MemberProgram
from lagrange.procedure.form import FLAG, WHOLE, Kind, Procedure
from lagrange.procedure.spread import Signature


def members_module(procedure: Procedure, signature: Signature, lanes: int) -> str:
    """Return the IR of a function that runs a procedure for `lanes` members; see `entry`."""
    program = MemberProgram(lanes)
    made = [entry(program, procedure, signature), *program.functions()]
    angles = [angle_function(lanes), angle_function(1)]
    return "\n".join([all_declarations(), declarations(lanes), *angles, *made, METADATA, ATTRIBUTES])


def entry(program: MemberProgram, procedure: Procedure, signature: Signature) -> str:
    """Return the IR of the entry function, which has the name of the procedure.

    Its first argument has a bit for each active member, and its last one points to the results. Each member's own
    number, an argument or a result, takes eight bytes of memory; a flag is an integer there. Callers cannot pass a part
    of an array that begins at an index of each member's own.
    """
    e, lanes = Emitter(), program.lanes
    flags = type_of(FLAG, lanes)
    mask = e.value(f"bitcast i{lanes} {e.value(f'trunc i64 %active to i{lanes}')} to {flags}")
    given, args = ["i64 %active"], [f"{flags} {mask}"]
    for parameter, share in zip(procedure.parameters, signature, strict=True):
        kind, name = parameter.type, f"%{parameter.name}"
        if not isinstance(kind, Kind):
            given.append(f"ptr noalias {name}")
            args.append(f"ptr {name}")
        elif share.own:
            given.append(f"ptr {name}")
            args.append(f"{type_of(kind, lanes)} {_read(e, name, kind, lanes)}")
        else:
            given.append(f"{type_of(kind)} {name}")
            args.append(f"{type_of(kind)} {name}")
    called = program.name(procedure, signature)
    own = program.spreads.of(procedure, signature).results
    types = [type_of(kind, lanes if one else 1) for kind, one in zip(procedure.results, own, strict=True)]
    call = f"call {together(types)} @{called}({', '.join(args)})"
    if types:
        value = e.value(call)
        _write(e, value, types, procedure.results, lanes)
    else:
        e.do(call)
    e.do("ret void")
    return e.function(f"define void @{procedure.name}({', '.join([*given, 'ptr %results'])}) #0")


def _read(e: Emitter, pointer: str, kind: Kind, lanes: int) -> str:
    """Return the numbers of all members, read from memory."""
    if kind is not FLAG:
        return e.load(pointer, type_of(kind, lanes))
    whole = type_of(WHOLE, lanes)
    return e.value(f"icmp ne {whole} {e.load(pointer, whole)}, zeroinitializer")


def _write(e: Emitter, value: str, types: Sequence[str], kinds: Sequence[Kind], lanes: int) -> None:
    """Write the results to memory, one row with an entry for each member."""
    for k, (one, kind, found) in enumerate(zip(types, kinds, separated(e, types, value), strict=True)):
        if kind is FLAG:
            one = type_of(WHOLE, lanes if one.startswith("<") else 1)
            found = e.value(f"zext {type_of(FLAG, lanes if one.startswith('<') else 1)} {found} to {one}")
        e.store(found, e.address("%results", k * lanes), one)
