"""Rewrite a procedure to run many members of an ensemble at once, one in each lane of vectors.

A member is one of several runs of the procedure with different arguments. A value that is the same for all members is
computed once. Any other value becomes a vector with one entry for each member. A condition that differs between members
becomes a mask: a branch is entered if any member takes it, and has no effect for the other members. A loop runs until
no member is left in it. The results of a member do not depend on the numbers of other members.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Block, Parameter, Procedure, Record, Vector, of_width
from lagrange.procedure.lane_values import (
    Analyses,
    MemberMemory,
    MemberStatements,
    MemberVariable,
    Signature,
    Variation,
    is_cheap,
    leaves,
    signature_of,
    variation_of,
)
from lagrange.procedure.visit import Visitor, visits

ACTIVE = "active"
"""Name of the first argument of the procedure that Python calls: 1 for each member that takes part, else 0."""

UNROLLED = 64
"""Largest total number of statements for which the iterations of an `each` are written out."""


class MemberProcedures:
    """Rewrites procedures so that one call runs `lanes` members (2, 4 or 8), each in its own lane of vectors.

    A procedure is rewritten once for every signature, which says which arguments differ between members.
    """

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.analyses: Analyses = {}
        self.known: dict[tuple[Procedure, Signature], Procedure] = {}
        self.numbers = count()

    def of(self, procedure: Procedure, signature: Signature) -> Procedure:
        """Return a version of a procedure that runs all members at once.

        `signature` says which arguments differ between members. The first parameter of the new procedure is the mask of
        the members to run. A number that differs becomes a vector with a lane for each member. In an array that
        differs, entry i of all members is contiguous. Members may begin at different indices of one array; the vector
        of these indices is then a further parameter after the array.
        """
        key = procedure, signature
        if key not in self.known:
            name = f"{procedure.name}.{next(self.numbers)}"
            self.known[key] = _Rewriter(self, procedure, signature).procedure_in_lanes(name)
        return self.known[key]

    def entry(self, procedure: Procedure, signature: Signature) -> Procedure:
        """Return a version of `procedure` that runs all members, for callers that cannot pass SIMD vectors.

        It takes an array with a number for each member where `of` takes a vector. `signature` says which arguments
        differ between members: each number that differs becomes such an array. The first argument has a whole number
        for each member, above zero if the member is to run. The last arguments are such arrays for the results, named
        `result0` and so on. Flags among the results become wholes.
        """
        called = self.of(procedure, signature)
        p = MemberStatements(self.lanes)
        first = p.constant(WHOLE, 0)
        parameters = [Parameter(p.new(), ACTIVE, Array(WHOLE, self.lanes, read=True))]
        args = [p.put("less", FLAG, first, p.loaded(parameters[0].ref, first, WHOLE))]
        for parameter, lane_parameter in zip(procedure.parameters, called.parameters[1:], strict=True):
            kind = lane_parameter.type
            kind = Array(kind.kind, self.lanes, read=True) if isinstance(kind, Vector) else kind
            parameters.append(Parameter(p.new(), parameter.name, kind))
            ref = parameters[-1].ref
            args.append(
                p.loaded(ref, first, lane_parameter.type.kind) if isinstance(lane_parameter.type, Vector) else ref
            )
        for k, (ref, result) in enumerate(zip(p.call(called, args), procedure.numbers, strict=True)):
            parameters.append(Parameter(p.new(), f"result{k}", Array(REAL if result is REAL else WHOLE, self.lanes)))
            value = p.put("whole", WHOLE, ref) if result is FLAG else ref
            p.out.append(form.VectorStore(parameters[-1].ref, first, p.wide(value)))
        return replace(procedure, parameters=tuple(parameters), results=(), body=tuple(p.out), names={})


class _Rewriter(Visitor, MemberStatements):
    """Rewrites one procedure for many members. The signature says which arguments differ between members.

    Ids of the original procedure are called "old". `level` is the number of enclosing branches that only some
    members take.
    """

    def __init__(self, program: MemberProcedures, procedure: Procedure, signature: Signature) -> None:
        super().__init__(program.lanes)
        self.program, self.procedure, self.signature = program, procedure, signature
        self.variation = variation_of(procedure, signature, program.analyses)
        self.values: dict[int, int] = {}
        self.types: dict[int, Array | Record] = {}
        self.memory: dict[int, MemberMemory] = {}
        self.variables: dict[int, MemberVariable] = {}
        self.mask, self.level = self.new(FLAG, wide=True), 0
        self.open = True
        """False if the present block has ended with a return."""
        self.alive: MemberVariable | None = None
        """Mask of the members that have not left the procedure; None unless they may leave at different statements."""
        self.results: list[MemberVariable] = []
        """The results of members that have left."""

    def procedure_in_lanes(self, name: str) -> Procedure:
        """Return the procedure, rewritten to run all members at once, under the given name."""
        parameters = [Parameter(self.mask, "mask", self.vector(FLAG))]
        for parameter, variation in zip(self.procedure.parameters, self.signature, strict=True):
            parameters += self.parameter(parameter, variation)
        if self.variation.returns_early:
            self.alive = self.declared(self.mask)
            for kind in self.procedure.numbers:
                zero = self.constant(kind, {REAL: 0.0, WHOLE: 0, FLAG: False}[kind])
                self.results.append(self.declared(self.wide(zero)))
        self.block(self.procedure.body)
        if self.open and self.procedure.results:
            self.out.append(form.Leave(tuple(self.got(variable) for variable in self.results)))
        pairs = zip(self.procedure.numbers, self.variation.results, strict=True)
        results = tuple(of_width(kind, self.lanes if differs else 1) for kind, differs in pairs)
        body, about = tuple(self.out), self.procedure.about
        return Procedure(name, about, tuple(parameters), results, body, {}, self.procedure.noinline)

    def parameter(self, parameter: Parameter, variation: Variation) -> list[Parameter]:
        """Return the new parameters for an old one. `variation` says whether the argument differs between members."""
        match parameter.type:
            case form.Callee() | Vector():
                raise LagrangeError(
                    f"procedure {self.procedure.name} has {parameter.name}, which is neither a number nor an array."
                )
            case form.Kind() as kind:
                ref = self.values[parameter.ref] = self.new(kind, wide=variation.varying)
                return [Parameter(ref, parameter.name, of_width(kind, self.lanes if variation.varying else 1))]
            case Record() as record:
                held = self.memory_for(parameter.ref, record, variation)
                return [
                    Parameter(held.ref, parameter.name, replace(record, lanes=self.lanes if variation.varying else 1))
                ]
            case Array() as array:
                held = self.memory_for(parameter.ref, array, variation)
                kept = Array(array.kind, None, array.read) if variation.varying else array
                made = [Parameter(held.ref, parameter.name, kept)]
                if held.starts is not None:
                    made.append(Parameter(held.starts, f"{parameter.name}.places", self.vector(WHOLE)))
                return made

    def memory_for(self, old: int, kind: Array | Record, variation: Variation) -> MemberMemory:
        """Return the new memory for the caller's array or record `old`: shared, or one for each member."""
        self.types[old] = kind
        made = self.memory[old] = MemberMemory(
            self.new(), variation.varying, self.new(WHOLE, wide=True) if variation.shifted else None
        )
        return made

    # --- values and masks

    def differs(self, old: int) -> bool:
        """Return True if the value with the id `old` may differ between members."""
        return old in self.variation.varying

    def value(self, old: int, *, wide: bool) -> int:
        """Return the id of the new value for the value with the id `old`, as a vector if `wide` is true."""
        ref = self.values[old]
        return self.wide(ref) if wide else ref

    def remaining(self, mask: int, statement: form.Statement) -> int:
        """Return the vector `mask` without the members that have returned from the procedure inside a statement."""
        if self.alive is None or not any(leaves(body) for body in form.inner(statement)):
            return mask
        return self.both(mask, self.got(self.alive))

    # --- variables

    def declared(self, value: int) -> MemberVariable:
        """Declare a new variable whose first value has the id `value`, and return it."""
        kind, wide = self.kinds[value], value in self.vectors
        variable = MemberVariable(self.new(kind, wide=wide), kind, self.level)
        self.out.append(form.Declare(variable.ref, of_width(kind, self.lanes if wide else 1), value))
        return variable

    @visits(form.Declare, form.Get, form.Set)
    def variable(self, statement: form.VariableStatement) -> None:
        """Rewrite the declaration, read or assignment of a variable for all members.

        If fewer members are active than at the declaration, an assignment changes only the values of the active
        members.
        """
        match statement:
            case form.Declare(ref=ref, value=value):
                self.variables[ref] = self.declared(self.value(value, wide=self.differs(ref)))
            case form.Get(ref=ref, variable=old):
                self.values[ref] = self.got(self.variables[old])
            case form.Set(variable=old, value=value):
                variable, wide = self.variables[old], self.differs(old)
                new = self.value(value, wide=wide)
                if wide and variable.level != self.level:
                    new = self.put("select", variable.kind, self.mask, new, self.got(variable))
                self.out.append(form.Set(variable.ref, new))

    # --- statements

    def block(self, block: Block) -> None:
        """Add the statements that replace the statements of a block of the original procedure, for all members."""
        for statement in block:
            self.statement(statement)

    def inside(self, block: Block, mask: int) -> Block:
        """Return the statements of an inner block, rewritten for the members in `mask`."""
        outside, self.out, self.mask = self.out, [], mask
        self.block(block)
        made, self.out = tuple(self.out), outside
        return made

    @visits(form.Note)
    def note(self, note: form.Note) -> None:
        """Copy a comment to the new procedure."""
        self.out.append(note)

    @visits(form.Let)
    def let(self, let: form.Let) -> None:
        """Rewrite an operation for all members: as an operation on vectors if its result differs between members."""
        if let.op == form.CONSTANT:
            self.values[let.ref] = self.constant(let.kind, let.data if let.data is not None else 0.0)
            return
        wide, args = self.differs(let.ref), [self.values[arg] for arg in let.args]
        if wide and let.op == "quotient":
            # A member outside the mask may have a divisor of zero, which would stop the process.
            is_zero = self.put("equal", FLAG, args[1], self.constant(WHOLE, 0))
            args[1] = self.put("select", WHOLE, is_zero, self.constant(WHOLE, 1), args[1])
        self.values[let.ref] = self.put(let.op, let.kind, *args, wide=wide)

    @visits(form.SineCosine)
    def angle(self, pair: form.SineCosine) -> None:
        """Rewrite a sine and a cosine of the same angle for all members: of a vector if the angles differ."""
        wide = self.differs(pair.sine)
        angle = self.value(pair.angle, wide=wide)
        sine, cosine = (self.new(REAL, wide=wide) for _ in range(2))
        self.values[pair.sine], self.values[pair.cosine] = sine, cosine
        self.out.append(form.SineCosine(sine, cosine, angle))

    # --- memory

    def index(self, memory: MemberMemory, old_index: int) -> int:
        """Return the id of the index in the new memory for `old_index`, which is the same for all members."""
        if not memory.varying:
            return old_index
        known = self.constants.get(old_index)
        if known is not None:
            return self.constant(WHOLE, int(known) * self.lanes)
        return self.put("mul", WHOLE, old_index, self.constant(WHOLE, self.lanes))

    def indices(self, memory: MemberMemory, old_index: int) -> int:
        """Return the id of a vector of indices in the array of all members: for each member that of `old_index`."""
        index = old_index if memory.starts is None else self.put("add", WHOLE, memory.starts, old_index)
        if not memory.varying:
            return self.wide(index)
        lanes = [self.constant(WHOLE, k) for k in range(self.lanes)]
        numbers = self.new(WHOLE, wide=True)
        self.out.append(form.VectorLet(numbers, self.vector(WHOLE), "permute", tuple(lanes), tuple(range(self.lanes))))
        first = self.put("mul", WHOLE, self.wide(index), self.constant(WHOLE, self.lanes))
        return self.put("add", WHOLE, first, numbers)

    def is_gathered(self, array: int, old_index: int) -> bool:
        """Return True if members may access an array at different indices: the index or the array's start varies."""
        return self.memory[array].starts is not None or self.differs(old_index)

    @visits(form.Load)
    def load(self, load: form.Load) -> None:
        """Rewrite the read of an array element for all members, each of which may read a different element."""
        held, index = self.memory[load.array], self.values[load.place]
        if self.is_gathered(load.array, load.place):
            ref, indices = self.new(load.kind, wide=True), self.indices(held, index)
            self.out.append(form.Gather(ref, self.vector(load.kind), held.ref, indices, self.mask))
        elif held.varying:
            ref = self.loaded(held.ref, self.index(held, index), load.kind)
        else:
            ref = self.new(load.kind)
            self.out.append(form.Load(ref, load.kind, held.ref, index))
        self.values[load.ref] = self.wide(ref) if self.differs(load.ref) else ref

    @visits(form.Store)
    def store(self, store: form.Store) -> None:
        """Rewrite the write of an array element: each member in the mask writes its own element.

        Raises LagrangeError if members would write the same element of a shared array.
        """
        held, index, value = self.memory[store.array], self.values[store.place], self.value(store.value, wide=True)
        if self.is_gathered(store.array, store.place):
            self.out.append(form.Scatter(held.ref, self.indices(held, index), value, self.mask))
            return
        if not held.varying:
            raise LagrangeError(
                f"procedure {self.procedure.name}: all members would write the same element of a shared array: "
                "give each member its own element."
            )
        mask = None if held.level == self.level else self.mask
        self.out.append(form.VectorStore(held.ref, self.index(held, index), value, mask))

    @visits(form.Read, form.Write)
    def field(self, statement: form.Read | form.Write) -> None:
        """Rewrite the read or write of a field of a record, which is a vector if each member has its own record."""
        held, record = self.memory[statement.record], self.types[statement.record]
        assert isinstance(record, Record)
        kind = record.kind(statement.field)
        if isinstance(statement, form.Read):
            ref = self.values[statement.ref] = self.new(kind, wide=held.varying)
            self.out.append(form.Read(ref, kind, held.ref, statement.field))
            return
        value = self.value(statement.value, wide=held.varying)
        if held.varying and held.level != self.level:
            before = self.new(kind, wide=True)
            self.out.append(form.Read(before, kind, held.ref, statement.field))
            value = self.put("select", kind, self.mask, value, before)
        self.out.append(form.Write(held.ref, statement.field, value))

    @visits(form.Reserve, form.ReserveRecord, form.Part)
    def local(self, local: form.Reserve | form.ReserveRecord | form.Part) -> None:
        """Rewrite the allocation of a local array or record, or a part of an array, for all members."""
        ref = self.new()
        new = MemberMemory(ref, varying=True, level=self.level)
        match local:
            case form.Reserve(array=array):
                self.types[local.ref], self.memory[local.ref] = array, new
                room = ((array.size or 0) + (array.room if array.room > 1 else 0)) * self.lanes
                self.out.append(form.Reserve(ref, Array(array.kind, room)))
            case form.ReserveRecord(record=record):
                self.types[local.ref], self.memory[local.ref] = record, new
                self.out.append(form.ReserveRecord(ref, replace(record, lanes=self.lanes)))
            case form.Part(array=array, start=start):
                self.types[local.ref], held, offset = self.types[array], self.memory[array], self.values[start]
                if self.is_gathered(array, start):
                    starts = offset if held.starts is None else self.put("add", WHOLE, held.starts, offset)
                    self.memory[local.ref] = replace(held, starts=self.wide(starts))
                else:
                    self.memory[local.ref] = replace(held, ref=ref)
                    self.out.append(form.Part(ref, held.ref, self.index(held, offset)))

    # --- calls and the return

    @visits(form.Call)
    def call_in_lanes(self, call: form.Call) -> None:
        """Rewrite a call as a call of the rewritten procedure, which runs all members in the mask."""
        callee = call.callee
        assert isinstance(callee, Procedure)
        signature = signature_of(call, self.variation.varying, self.variation.shifted)
        args = [self.mask]
        for parameter, arg in zip(callee.parameters, call.args, strict=True):
            if isinstance(parameter.type, form.Kind):
                args.append(self.values[arg])
                continue
            held = self.memory[arg]
            args += [held.ref] if held.starts is None else [held.ref, held.starts]
        results = self.call(self.program.of(callee, signature), args)
        self.values.update(zip(call.refs, results, strict=True))

    @visits(form.Leave)
    def leave(self, leave: form.Leave) -> None:
        """Rewrite a return for the members in the mask. The procedure returns once all members have returned."""
        pairs = zip(leave.values, self.variation.results, strict=True)
        values = [self.value(ref, wide=differs) for ref, differs in pairs]
        if self.alive is not None:
            values = [
                self.put("select", state.kind, self.mask, value, self.got(state))
                for value, state in zip(values, self.results, strict=True)
            ]
        if self.level == 0:
            self.out.append(form.Leave(tuple(values)))
            self.open = False
            return
        assert self.alive is not None
        for variable, value in zip(self.results, values, strict=True):
            self.out.append(form.Set(variable.ref, value))
        self.out.append(form.Set(self.alive.ref, self.without(self.got(self.alive), self.mask)))
        self.mask = self.wide(self.constant(FLAG, value=False))

    # --- branches

    @visits(form.When, form.Loop, form.Repeat, form.Each)
    def control(self, statement: form.ControlStatement) -> None:
        """Rewrite a branch or a loop. Members that return inside it are removed from the mask."""
        before = self.mask
        match statement:
            case form.When() if not self.differs(statement.condition):
                self.common_branch(statement)
            case form.When() if is_cheap(statement):
                self.chosen_branch(statement)
            case form.When():
                self.masked_branch(statement)
            case form.Loop():
                self.loop(statement)
            case form.Repeat():
                self.repeat(statement)
            case form.Each():
                self.each(statement)
        self.open = self.open or not isinstance(statement, form.When)
        if self.open:
            self.mask = self.remaining(before, statement)

    def common_branch(self, when: form.When) -> None:
        """Rewrite a branch on a condition that is the same for all members."""
        mask = self.mask
        then, goes_on = self.inside(when.then, mask), self.open
        self.open = True
        otherwise = self.inside(when.otherwise, mask)
        self.open = self.open or goes_on
        self.out.append(form.When(self.values[when.condition], then, otherwise, when.likely))

    def chosen_branch(self, when: form.When) -> None:
        """Rewrite a branch by selection: both branches are computed, and each member selects its values."""
        mask, condition = self.mask, self.value(when.condition, wide=True)
        self.level += 1
        for body, side in ((when.then, self.both), (when.otherwise, self.without)):
            if body:
                self.mask = side(mask, condition)
                self.block(body)
        self.level -= 1

    def masked_branch(self, when: form.When) -> None:
        """Rewrite a branch that only some members may take. A branch that no member takes is skipped."""
        mask, condition = self.mask, self.value(when.condition, wide=True)
        sides = [(self.both(mask, condition), when.then, when.likely)]
        if when.otherwise:
            unlikely = None if when.likely is None else not when.likely
            sides.append((self.without(mask, condition), when.otherwise, unlikely))
        self.level += 1
        for taken, body, likely in sides:
            some = self.some(taken)
            self.out.append(form.When(some, self.inside(body, taken), likely=likely))
        self.level -= 1

    # --- loops

    def loop(self, loop: form.Loop) -> None:
        """Rewrite a loop over an index. It runs until it has ended for all members."""
        uneven = self.differs(loop.start) or self.differs(loop.stop)
        before = self.mask
        start, stop = self.value(loop.start, wide=self.differs(loop.place)), self.values[loop.stop]
        if not uneven and self.remaining(before, loop) == before:
            current = self.values[loop.place] = self.new(WHOLE)
            self.out.append(form.Loop(current, start, stop, loop.step, self.inside(loop.body, before)))
            return
        index = self.declared(start)

        def goes_on() -> int:
            return self.put("less", FLAG, self.got(index), stop)

        def body() -> None:
            current = self.values[loop.place] = self.got(index)
            self.block(loop.body)
            if self.open:
                self.out.append(form.Set(index.ref, self.put("add", WHOLE, current, self.constant(WHOLE, loop.step))))

        self.repeated(loop, goes_on, body, uneven=uneven)

    def repeat(self, repeat: form.Repeat) -> None:
        """Rewrite a loop under a condition. It runs until the condition is false for all members."""

        def goes_on() -> int:
            self.block(repeat.test)
            return self.values[repeat.condition]

        self.repeated(repeat, goes_on, lambda: self.block(repeat.body), uneven=self.differs(repeat.condition))

    def repeated(
        self, loop: form.Statement, goes_on: Callable[[], int], body: Callable[[], None], *, uneven: bool
    ) -> None:
        """Add a loop. `goes_on` adds the statements of its condition and returns its id; `body` adds an iteration.

        `uneven` is true if members may end the loop at different iterations.
        """
        before, outside = self.mask, self.out
        inside = self.declared(before) if uneven else None
        self.level += uneven
        self.out = []
        self.mask = self.remaining(before if inside is None else self.got(inside), loop)
        condition = goes_on()
        if inside is not None:
            mask = self.both(self.mask, self.wide(condition))
            self.out.append(form.Set(inside.ref, mask))
            condition = self.some(mask)
        elif self.mask != before:
            condition = self.put("and", FLAG, condition, self.some(self.mask))
        test, self.out = tuple(self.out), []
        self.mask = self.remaining(before, loop) if inside is None else self.got(inside)
        body()
        repeat = form.Repeat(test, condition, tuple(self.out))
        self.level -= uneven
        self.out = outside
        self.out.append(repeat)

    # --- iterations

    def each(self, each: form.Each) -> None:
        """Rewrite an `each` (a loop in any order) as a loop of single iterations: the lanes hold members instead."""
        uneven, iterations = self.differs(each.iterations), self.values[each.iterations]
        known = self.constants.get(iterations)
        sums: list[list[int]] = []
        for fold in each.folds:
            first = self.constant(REAL, fold.first)
            first = self.wide(first) if self.differs(fold.ref) else first
            sums.append([first] * (form.PARTIAL if fold.op in form.SUMS else 1))
        size = len([*form.walk(each.body), *each.folds])
        if known is not None and (each.unrolled or known * size <= UNROLLED):
            for k in range(int(known)):
                self.values[each.place] = self.constant(WHOLE, k)
                self.block(each.body)
                sums = [self.collected(fold, partial) for fold, partial in zip(each.folds, sums, strict=True)]
        else:
            sums = self.looped(each, sums, uneven=uneven)
        for fold, partial in zip(each.folds, sums, strict=True):
            self.values[fold.ref] = self.total(partial, iterations)

    def looped(self, each: form.Each, sums: Sequence[Sequence[int]], *, uneven: bool) -> list[list[int]]:
        """Add a loop for the iterations of an `each`, and return the ids of the partial results of each reduction.

        `sums` has the ids of the initial partial results. `uneven` is true if members may have different numbers of
        iterations.
        """
        partial = [[self.declared(value) for value in initial] for initial in sums]
        start, stop, before = self.constant(WHOLE, 0), self.values[each.iterations], self.mask

        def iteration(current: int) -> None:
            self.values[each.place] = current
            self.block(each.body)
            for fold, variables in zip(each.folds, partial, strict=True):
                old = [self.got(variable) for variable in variables]
                new = self.collected(fold, old)
                if uneven:
                    pairs = zip(new, old, strict=True)
                    new = [self.put("select", REAL, self.mask, value, former) for value, former in pairs]
                for variable, value in zip(variables, new, strict=True):
                    self.out.append(form.Set(variable.ref, value))

        if uneven:
            index = self.declared(start)

            def body() -> None:
                current = self.got(index)
                iteration(current)
                self.out.append(form.Set(index.ref, self.put("add", WHOLE, current, self.constant(WHOLE, 1))))

            self.repeated(each, lambda: self.put("less", FLAG, self.got(index), stop), body, uneven=True)
        else:
            outside, self.out = self.out, []
            current = self.new(WHOLE)
            iteration(current)
            loop = form.Loop(current, start, stop, 1, tuple(self.out))
            self.out = outside
            self.out.append(loop)
        self.mask = before
        return [[self.got(variable) for variable in variables] for variables in partial]

    def collected(self, fold: form.Fold, partial: Sequence[int]) -> list[int]:
        """Return the ids of the partial results of a reduction after one more iteration.

        The value of the iteration is added to the first partial result, which then moves to the end of the list.
        """
        before, value = partial[0], self.values[fold.value]
        if fold.factor is not None:
            new = self.put("fma", REAL, value, self.values[fold.factor], before)
        elif fold.op == "most":
            new = self.put("select", REAL, self.put("less", FLAG, before, value), value, before)
        else:
            new = self.put(fold.op, REAL, before, value)
        return [*partial[1:], new]

    def total(self, partial: Sequence[int], iterations: int) -> int:
        """Return the id of the result of a reduction, from the ids of its partial results.

        `iterations` is the id of the number of iterations. Each iteration has rotated the partial results by one: the
        first became the last.
        """
        if len(partial) == 1:
            return partial[0]
        known = self.constants.get(iterations)
        if known is not None:
            return self.summed(partial, int(known) % 2)
        two = self.constant(WHOLE, 2)
        half = self.put("quotient", WHOLE, iterations, two)
        is_even = self.put("equal", FLAG, self.put("mul", WHOLE, half, two), iterations)
        return self.put("select", REAL, is_even, self.summed(partial, 0), self.summed(partial, 1))

    def summed(self, partial: Sequence[int], odd: int) -> int:
        """Return the id of the sum of four partial sums; `odd` is 1 after an odd number of iterations, else 0."""
        a, b, c, d = (*partial[-odd:], *partial[:-odd]) if odd else partial
        return self.put("add", REAL, self.put("add", REAL, a, b), self.put("add", REAL, c, d))
