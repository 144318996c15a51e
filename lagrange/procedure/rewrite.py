"""Rewrite procedures: bind function parameters, remove values that are never read, unpack short vectors.

Binding turns a procedure for any right-hand side into one for a given right-hand side, without function pointers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    CONSTANT,
    REAL,
    VECTOR_STATEMENTS,
    WHOLE,
    Block,
    Callee,
    Kind,
    Procedure,
    Statement,
    Vector,
    rebuilt,
    walk,
)
from lagrange.procedure.verify import verify
from lagrange.procedure.visit import defined, operands, reads, renamed

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
                raise LagrangeError(f"procedure {procedure.name} calls {parameter.name}, which is not given.")
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

    `got` are the ids of the variables that are read anywhere in the procedure.
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
        """Return a statement with pruned blocks and callees, and record the ids of its operands as needed."""
        self.needed.update(operands(statement))
        if isinstance(statement, form.Call) and isinstance(statement.callee, Procedure):
            return statement._replace(callee=self.pruner.pruned(statement.callee))
        return rebuilt(statement, self.block)

    def idle(self, statement: Statement) -> bool:
        """Return True if a statement has no effect on results."""
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


def unpacked(procedure: Procedure) -> Procedure:
    """Return a procedure in which each entry of a vector is a single value. It is unchanged if it has no vectors.

    Callees keep their vectors; their printers unpack them.
    """
    statements = list(walk(procedure.body))
    if not any(isinstance(statement, VECTOR_STATEMENTS) for statement in statements):
        return procedure
    refs = [parameter.ref for parameter in procedure.parameters]
    refs += [
        ref
        for statement in statements
        for ref in ((statement.ref,) if isinstance(statement, form.Declare) else defined(statement))
    ]
    return replace(procedure, body=_Unpacker(max(refs) + 1).block(procedure.body))


class _Unpacker:
    """Replaces vectors in blocks by single values. `entries` maps the id of a vector to the ids of its entries."""

    def __init__(self, first: int) -> None:
        self.unused = count(first)
        self.entries: dict[int, tuple[int, ...]] = {}
        self.same: dict[int, int] = {}
        """Vector entries that are read as single values: from the number of that value to the number of the entry."""
        self.out: list[Statement] = []

    def block(self, block: Block) -> Block:
        """Return a block in which vectors are replaced by their entries."""
        outside, self.out = self.out, []
        for statement in block:
            statement = renamed(statement, self.same)
            match statement:
                case form.SineCosine(angle=angle) if angle in self.entries:
                    pairs = [
                        form.SineCosine(next(self.unused), next(self.unused), entry) for entry in self.entries[angle]
                    ]
                    self.out += pairs
                    self.entries[statement.sine] = tuple(pair.sine for pair in pairs)
                    self.entries[statement.cosine] = tuple(pair.cosine for pair in pairs)
                case form.Declare(ref=ref, kind=Vector(kind=kind)):
                    first, self.entries[ref] = self.entries[statement.value], self.numbers(statement.kind)
                    self.out += [
                        form.Declare(entry, kind, x) for entry, x in zip(self.entries[ref], first, strict=True)
                    ]
                case form.Get(ref=ref, kind=Vector(kind=kind)):
                    self.entries[ref] = self.numbers(statement.kind)
                    pairs_of = zip(self.entries[ref], self.entries[statement.variable], strict=True)
                    self.out += [form.Get(entry, kind, variable) for entry, variable in pairs_of]
                case form.Set(variable=variable, value=value) if value in self.entries:
                    pairs_of = zip(self.entries[variable], self.entries[value], strict=True)
                    self.out += [form.Set(entry, x) for entry, x in pairs_of]
                case form.VectorLet():
                    self.entries[statement.ref] = self.vector(statement)
                case form.Reduce(op="entry"):
                    self.same[statement.ref] = self.entries[statement.vector][statement.place]
                case form.Reduce():
                    self.reduce(statement)
                case form.VectorLoad(vector=vector, place=first, mask=mask):
                    indices = self.side_by_side(first, vector.width)
                    flags = None if mask is None else self.entries[mask]
                    self.entries[statement.ref] = self.loaded(statement, indices, flags)
                case form.Gather(places=chosen, mask=mask):
                    flags = None if mask is None else self.entries[mask]
                    self.entries[statement.ref] = self.loaded(statement, self.entries[chosen], flags)
                case form.VectorStore(place=first, value=value):
                    self.store(statement, self.side_by_side(first, len(self.entries[value])))
                case form.Scatter(places=chosen):
                    self.store(statement, self.entries[chosen])
                case _:
                    self.out.append(rebuilt(statement, self.block))
        made, self.out = tuple(self.out), outside
        return made

    def let(self, kind: Kind, op: str, args: tuple[int, ...], data: float | None = None) -> int:
        """Add an operation, and return the id of its result. `data` is the value of a constant."""
        ref = next(self.unused)
        self.out.append(form.Let(ref, kind, op, args, data))
        return ref

    def numbers(self, vector: Kind | Vector) -> tuple[int, ...]:
        """Return new ids for the entries of a vector, or one id for a single value."""
        return tuple(next(self.unused) for _ in range(vector.width if isinstance(vector, Vector) else 1))

    def vector(self, let: form.VectorLet) -> tuple[int, ...]:
        """Add an operation for each entry of a vector, and return the ids of the results."""
        args = [self.entries.get(arg, (arg,)) for arg in let.args]
        if let.op == "permute":
            entries = [entry for arg in args for entry in arg]
            return tuple(entries[index] for index in let.places)
        return tuple(self.let(let.vector.kind, let.op, operands) for operands in zip(*args, strict=True))

    def reduce(self, reduce: form.Reduce) -> None:
        """Add the operations of a sum over a vector, or of the test whether any of its flags is true."""
        op, left = "or" if reduce.op == "any" else "add", list(self.entries[reduce.vector])
        while len(left) > 1:
            half = len(left) // 2
            refs = [reduce.ref] if half == 1 else [next(self.unused) for _ in range(half)]
            pairs = zip(refs, left[:half], left[half:], strict=True)
            self.out += [form.Let(ref, reduce.kind, op, (a, b)) for ref, a, b in pairs]
            left = refs

    def side_by_side(self, first: int, width: int) -> tuple[int, ...]:
        """Return the ids of `width` successive indices, beginning with `first`."""
        steps = [self.let(WHOLE, CONSTANT, (), k) for k in range(1, width)]
        return first, *(self.let(WHOLE, "add", (first, step)) for step in steps)

    def loaded(
        self, load: form.VectorLoad | form.Gather, indices: tuple[int, ...], flags: tuple[int, ...] | None
    ) -> tuple[int, ...]:
        """Add the reads of an array at the indices, and return the ids of the results.

        Where a flag is false, the result is zero and memory is not read. `flags` is None without a mask.
        """
        kind, refs = load.vector.kind, []
        for k, index in enumerate(indices):
            ref = next(self.unused)
            refs.append(ref)
            read = form.Load(ref, kind, load.array, index)
            if flags is None:
                self.out.append(read)
                continue
            variable, inside = next(self.unused), next(self.unused)
            zero = self.let(kind, CONSTANT, (), 0.0 if kind is REAL else 0)
            then = (read._replace(ref=inside), form.Set(variable, inside))
            self.out += [form.Declare(variable, kind, zero), form.When(flags[k], then), form.Get(ref, kind, variable)]
        return tuple(refs)

    def store(self, store: form.VectorStore | form.Scatter, indices: tuple[int, ...]) -> None:
        """Add the writes of a vector's entries to an array at the indices, under the mask of the statement."""
        for k, (index, value) in enumerate(zip(indices, self.entries[store.value], strict=True)):
            written = form.Store(store.array, index, value)
            self.out.append(written if store.mask is None else form.When(self.entries[store.mask][k], (written,)))
