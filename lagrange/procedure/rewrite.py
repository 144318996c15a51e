"""Rewrite procedures: bind function parameters, remove values that are never read, replace vectors by arrays.

Binding turns a procedure for any right-hand side into a procedure for a given right-hand side, without function
pointers.

For languages without vectors each vector becomes a local array. Operations on vectors become loops over their entries,
which compilers turn into vector instructions. Successive operations share a loop. A value that only its own loop reads
has no array.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import count

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    CONSTANT,
    REAL,
    WHOLE,
    Array,
    Block,
    Callee,
    Procedure,
    Statement,
    Vector,
    rebuilt,
    walk,
)
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
        """Ids of the values that later statements read."""

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


def without_vectors(procedure: Procedure) -> Procedure:
    """Return a procedure that computes the same numbers with arrays and loops in place of vectors."""
    return replace(procedure, body=_Rewriter(procedure).inside(procedure.body))


class _Rewriter:
    """Rewrites one procedure without vectors. `deferred` are the statements on vectors for the next loop.

    The loop has `width` iterations. A value in a loop has the id of its vector. `arrays` has the array with the
    entries of a vector or of a variable that is a vector, `copied` the single value of a vector with equal entries,
    and `whole` the array of which an array is a part, all by id.
    """

    def __init__(self, procedure: Procedure) -> None:
        statements = list(walk(procedure.body))
        self.uses = Counter(ref for statement in statements for ref in operands(statement))
        ids = [parameter.ref for parameter in procedure.parameters]
        ids += [ref for statement in statements for ref in defined(statement)]
        ids += [statement.ref for statement in statements if isinstance(statement, form.Declare)]
        self.unused = count(max(ids, default=0) + 1)
        self.out: list[Statement] = []
        self.vectors: dict[int, Vector] = {}
        self.arrays: dict[int, int] = {}
        self.copied: dict[int, int] = {}
        self.whole: dict[int, int] = {}
        self.deferred: list[Statement] = []
        self.width = 0

    def inside(self, block: Block) -> Block:
        """Return the statements that replace the statements of a block."""
        outside, self.out = self.out, []
        for statement in block:
            self.statement(statement)
        self.add_loop()
        replacements, self.out = tuple(self.out), outside
        return replacements

    def statement(self, statement: Statement) -> None:
        """Add the statements that replace one statement, or defer it to the next loop over the entries of vectors."""
        match statement:
            case form.VectorLet(ref=ref, vector=vector, op="permute"):
                self.vectors[ref] = vector
                self.permute(statement)
            case form.VectorLet(ref=ref, vector=vector) | form.Get(ref=ref, kind=Vector() as vector):
                self.defer(statement, ref, vector)
            case form.VectorLoad(ref=ref, vector=vector, array=array):
                self.separate(array, form.VectorStore)
                self.defer(statement, ref, vector)
            case form.VectorStore(array=array, value=value):
                self.separate(array, form.VectorLoad)
                self.defer(statement, value, self.vectors[value])
            case form.SineCosine(sine=sine, cosine=cosine, angle=angle) if angle in self.vectors:
                for op, ref in (("sin", sine), ("cos", cosine)):
                    vector = Vector(REAL, self.vectors[angle].width)
                    self.defer(form.VectorLet(ref, vector, op, (angle,)), ref, vector)
            case form.Declare(ref=ref, kind=Vector() as vector, value=value):
                self.arrays[ref] = self.reserved(vector)
                self.defer(form.Set(ref, value), ref, vector)
            case form.Set(variable=variable) if variable in self.vectors:
                self.defer(statement, variable, self.vectors[variable])
            case form.Reduce(ref=ref, kind=kind, op="entry", vector=vector_ref, place=place):
                self.add_loop()
                self.out.append(form.Load(ref, kind, self.array_of(vector_ref), self.number(place)))
            case form.Let() | form.Get():
                self.out.append(statement)
            case form.Part(ref=ref, array=array):
                self.whole[ref] = self.whole.get(array, array)
                self.out.append(statement)
            case _:
                self.add_loop()
                self.out.append(rebuilt(statement, self.inside))

    def defer(self, statement: Statement, ref: int, vector: Vector) -> None:
        """Defer a statement to the next loop. It computes, sets or stores the vector with the id `ref`."""
        if vector.width != self.width:
            self.add_loop()
        self.vectors[ref], self.width = vector, vector.width
        self.deferred.append(statement)

    def separate(self, array: int, access: type[form.VectorLoad] | type[form.VectorStore]) -> None:
        """Add the loop of the deferred statements if a statement of the class `access` uses the memory of an array."""
        memory = self.whole.get(array, array)
        accessed = [other.array for other in self.deferred if isinstance(other, access)]
        if any(self.whole.get(other, other) == memory for other in accessed):
            self.add_loop()

    def permute(self, let: form.VectorLet) -> None:
        """Copy entries of vectors and single values to an array, or note that all entries are one single value."""
        entries: list[tuple[int, int | None]] = []
        for arg in let.args:
            if arg in self.vectors and arg not in self.copied:
                entries += [(arg, k) for k in range(self.vectors[arg].width)]
            else:
                width = self.vectors[arg].width if arg in self.vectors else 1
                entries += [(self.copied.get(arg, arg), None)] * width
        chosen = [entries[k] for k in let.places]
        if len(dict.fromkeys(chosen)) == 1 and chosen[0][1] is None:
            self.copied[let.ref] = chosen[0][0]
            return
        computed = {ref for statement in self.deferred for ref in defined(statement)}
        if not computed.isdisjoint(ref for ref, _ in chosen):
            self.add_loop()
        array = self.arrays[let.ref] = self.reserved(let.vector)
        for place, (ref, k) in enumerate(chosen):
            value = ref
            if k is not None:
                value = next(self.unused)
                self.out.append(form.Load(value, let.vector.kind, self.arrays[ref], self.number(k)))
            self.out.append(form.Store(array, self.number(place), value))

    def add_loop(self) -> None:
        """Add a loop over the entries of vectors, with the deferred statements."""
        if not self.deferred:
            return
        index, body = next(self.unused), list[Statement]()
        inside = Counter(ref for statement in self.deferred for ref in operands(statement))
        known: dict[int, int] = {}

        def entry(ref: int) -> int:
            """Return the id of the present entry of a vector; it is read from the array of the vector once."""
            if ref in self.copied:
                return self.copied[ref]
            if ref not in known:
                known[ref] = next(self.unused)
                body.append(form.Load(known[ref], self.vectors[ref].kind, self.arrays[ref], index))
            return known[ref]

        for statement in self.deferred:
            match statement:
                case form.VectorLet(ref=ref, vector=vector, op=op, args=args):
                    body.append(form.Let(ref, vector.kind, op, tuple(map(entry, args))))
                case form.VectorLoad(ref=ref, vector=vector, array=array, place=place):
                    body.append(form.Load(ref, vector.kind, self.part(array, place), index))
                case form.Get(ref=ref, variable=variable):
                    body.append(form.Load(ref, self.vectors[ref].kind, self.arrays[variable], index))
                case form.VectorStore(array=array, place=place, value=value):
                    body.append(form.Store(self.part(array, place), index, entry(value)))
                case form.Set(variable=variable, value=value):
                    body.append(form.Store(self.arrays[variable], index, entry(value)))
            for ref in defined(statement):
                known[ref] = ref
                if self.uses[ref] > inside[ref]:
                    self.arrays[ref] = self.reserved(self.vectors[ref])
                    body.append(form.Store(self.arrays[ref], index, ref))
        self.out.append(form.Each(index, self.number(self.width), tuple(body)))
        self.deferred = []

    def array_of(self, ref: int) -> int:
        """Return the array with the entries of a vector. A vector with equal entries gets its array now."""
        if ref in self.copied:
            array = self.arrays[ref] = self.reserved(self.vectors[ref])
            for k in range(self.vectors[ref].width):
                self.out.append(form.Store(array, self.number(k), self.copied[ref]))
        return self.arrays[ref]

    def number(self, value: int) -> int:
        """Add a whole constant, and return its id."""
        ref = next(self.unused)
        self.out.append(form.Let(ref, WHOLE, CONSTANT, (), value))
        return ref

    def reserved(self, vector: Vector) -> int:
        """Add a local array for the entries of a vector, and return its id."""
        ref = next(self.unused)
        self.out.append(form.Reserve(ref, Array(vector.kind, vector.width)))
        return ref

    def part(self, array: int, start: int) -> int:
        """Add the definition of a part of an array, and return its id. `start` is the id of its first index."""
        ref = next(self.unused)
        self.out.append(form.Part(ref, array, start))
        return ref
