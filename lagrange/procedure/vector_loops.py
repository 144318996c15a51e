"""Rewrite a procedure without vectors, for languages that have none: each vector becomes a local array.

Operations on vectors become loops over their entries, which compilers turn into vector instructions. Successive
operations share a loop. A value that only its own loop reads has no array.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import count

from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, REAL, WHOLE, Array, Block, Procedure, Statement, Vector, rebuilt, walk
from lagrange.procedure.verify import verify
from lagrange.procedure.visit import defined, operands


def without_vectors(procedure: Procedure) -> Procedure:
    """Return a procedure that computes the same numbers with arrays and loops in place of vectors."""
    rewritten = replace(procedure, body=_Rewriter(procedure).inside(procedure.body))
    verify(rewritten)
    return rewritten


class _Rewriter:
    """Rewrites one procedure. `waiting` are the statements on vectors for the next loop, which has `width` iterations.

    A value in a loop has the id of its vector. `arrays` has the array with the entries of a vector or of a variable
    that is one, `copied` the single value of a vector with equal entries, and `whole` the array of which an array is
    a part, all by id.
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
        self.waiting: list[Statement] = []
        self.width = 0

    def inside(self, block: Block) -> Block:
        """Return the statements that replace those of a block."""
        outside, self.out = self.out, []
        for statement in block:
            self.statement(statement)
        self.add_loop()
        replacements, self.out = tuple(self.out), outside
        return replacements

    def statement(self, statement: Statement) -> None:
        """Add the statements that replace one, or let it wait for the next loop."""
        match statement:
            case form.VectorLet(ref=ref, vector=vector, op="permute"):
                self.vectors[ref] = vector
                self.permute(statement)
            case form.VectorLet(ref=ref, vector=vector) | form.Get(ref=ref, kind=Vector() as vector):
                self.wait(statement, ref, vector)
            case form.VectorLoad(ref=ref, vector=vector, array=array):
                self.separate(array, form.VectorStore)
                self.wait(statement, ref, vector)
            case form.VectorStore(array=array, value=value):
                self.separate(array, form.VectorLoad)
                self.wait(statement, value, self.vectors[value])
            case form.SineCosine(sine=sine, cosine=cosine, angle=angle) if angle in self.vectors:
                for op, ref in (("sin", sine), ("cos", cosine)):
                    vector = Vector(REAL, self.vectors[angle].width)
                    self.wait(form.VectorLet(ref, vector, op, (angle,)), ref, vector)
            case form.Declare(ref=ref, kind=Vector() as vector, value=value):
                self.arrays[ref] = self.reserved(vector)
                self.wait(form.Set(ref, value), ref, vector)
            case form.Set(variable=variable) if variable in self.vectors:
                self.wait(statement, variable, self.vectors[variable])
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

    def wait(self, statement: Statement, ref: int, vector: Vector) -> None:
        """Let a statement wait for the next loop. It computes, sets or stores the vector with the id `ref`."""
        if vector.width != self.width:
            self.add_loop()
        self.vectors[ref], self.width = vector, vector.width
        self.waiting.append(statement)

    def separate(self, array: int, access: type[form.VectorLoad] | type[form.VectorStore]) -> None:
        """Add the loop of the waiting statements if one of the class `access` has the same memory as an array."""
        memory = self.whole.get(array, array)
        accessed = [other.array for other in self.waiting if isinstance(other, access)]
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
        computed = {ref for waiting in self.waiting for ref in defined(waiting)}
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
        """Add a loop over the entries of vectors, with the waiting statements."""
        if not self.waiting:
            return
        index, body = next(self.unused), list[Statement]()
        inside = Counter(ref for statement in self.waiting for ref in operands(statement))
        known: dict[int, int] = {}

        def entry(ref: int) -> int:
            """Return the id of the present entry of a vector; it is read from the array of the vector once."""
            if ref in self.copied:
                return self.copied[ref]
            if ref not in known:
                known[ref] = next(self.unused)
                body.append(form.Load(known[ref], self.vectors[ref].kind, self.arrays[ref], index))
            return known[ref]

        for statement in self.waiting:
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
        self.waiting = []

    def array_of(self, ref: int) -> int:
        """Return the array with the entries of a vector; one with equal entries gets its array now."""
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
