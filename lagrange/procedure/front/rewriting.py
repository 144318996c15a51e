"""Rewrite a plain function so that it passes each of its steps to a tracer, which builds the procedure.

The tracer is the first argument, `_t`: a `building.Tracer`, which adds statements. Operations of the values themselves
(a + b, a < b, attributes) are unchanged. Control flow, names that branches and loops set, division, elements of arrays
and calls become calls of the tracer. It runs both branches, each in its own block:

    if a > b:                         _b0 = _t.branches(a > b)
        x = 1.0                       x, = _b0.open(("x",), (), x)
                                      for _w1 in _b0:
                                          try:
                                              if _w1:
                                                  x = _t.assign(x, "x", 1.0)
                                          except _t.Ended:
                                              _b0.ended()
                                          x, = _b0.close(x)
                                      x, = _b0.after()
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence

from lagrange.errors import LagrangeError
from lagrange.procedure.front.liveness import carried, mentions, stored

RECEIVER = "_t"
LOAD, STORE = ast.Load(), ast.Store()
LOOPS = (ast.For, ast.While)
DIRECT = (ast.Add, ast.Sub, ast.Mult, ast.BitAnd, ast.BitOr)
"""Binary operators that procedure values define."""

BY_RECEIVER: Mapping[type[ast.operator], str] = {
    ast.Div: "divide",
    ast.FloorDiv: "floor_divide",
    ast.Mod: "remainder",
    ast.Pow: "power",
}
EQUALITIES: Mapping[type[ast.cmpop], str] = {ast.Eq: "equal", ast.NotEq: "differ"}
INSTEAD: Mapping[type[ast.AST], str] = {
    ast.Break: "`break`: put the condition into the `while`",
    ast.Continue: "`continue`: put what follows under the opposite condition",
    ast.While: "`else` after a loop: put what follows under a condition",
    ast.For: "`else` after a loop: put what follows under a condition",
    ast.Try: "`try`: nothing raises; return a status",
    ast.Raise: "`raise`: return a status",
    ast.Assert: "`assert`: return a status",
    ast.Global: "`global`: hand the value on as an argument",
    ast.Nonlocal: "`nonlocal`: return the value",
    ast.Delete: "`del`",
    ast.Match: "`match`: use `if`",
    ast.NamedExpr: "`:=`: assign before the statement",
    ast.Starred: "a starred target: write the names out",
}
"""Constructs that a plain procedure must not contain, each with the construct to use in its place."""


def named(name: str) -> ast.expr:
    """Return the syntax tree of an expression that reads a name."""
    return ast.Name(name, LOAD)


def told(method: str, *args: ast.expr | str | int, of: str = RECEIVER) -> ast.Call:
    """Return the syntax tree of the call `of.method(*args)`; `of` is by default the tracer. Texts become constants."""
    arguments = [arg if isinstance(arg, ast.expr) else ast.Constant(arg) for arg in args]
    return ast.Call(ast.Attribute(named(of), method, LOAD), arguments, [])


def lazily(value: ast.expr) -> ast.expr:
    """Return the syntax tree of a lambda without arguments that computes an expression."""
    return ast.Lambda(_arguments([]), value)


def _arguments(args: list[ast.arg]) -> ast.arguments:
    return ast.arguments(posonlyargs=[], args=args, kwonlyargs=[], kw_defaults=[], defaults=[])


def put(target: str, value: ast.expr) -> ast.stmt:
    """Return the syntax tree of an assignment to a name."""
    return ast.Assign([ast.Name(target, STORE)], value)


class Rewriter:
    """Rewrites the syntax tree of one plain function so that it builds a procedure by calls of a tracer.

    `comments` are the comments of its module, by line. An `inlined` function is rewritten to have a single return.
    For a function inside another one, `outer` are the names in enclosing functions that may be variables.
    """

    def __init__(
        self, tree: ast.FunctionDef, comments: Mapping[int, str], *, inlined: bool, outer: frozenset[str] | None = None
    ) -> None:
        self.tree, self.comments, self.is_inner = tree, comments, outer is not None
        self.body = [delegated(statement) for statement in single_exit(self.tree)] if inlined else self.tree.body
        self.count = 0
        arguments = self.tree.args
        self.parameters = [arg.arg for arg in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        self.carried = carried(self.body)
        """For each branch and loop, the names that it sets and that are read afterwards or in its next iteration."""

        self.own = {name for names in self.carried.values() for name in names.on}
        self.changing = frozenset(self.own) | ((outer or frozenset()) - frozenset(self.parameters))
        """Names that a branch or loop may turn into variables, or leave without a value."""

        self.scoped: list[frozenset[str]] = []
        """Names bound by each comprehension and lambda around the present expression, outermost first."""

    def function(self, free: Sequence[str] = ()) -> ast.FunctionDef:
        """Return the rewritten function. Its parameters are the tracer, those of the plain function, and `free`.

        `free` are the names of variables of enclosing functions. An inner function has no parameter for the tracer.
        """
        names = [*([] if self.is_inner else [RECEIVER]), *self.parameters, *free]
        arguments = _arguments([ast.arg(name) for name in names])
        missing = [put(name, told("missing", name)) for name in sorted(self.own) if name not in self.parameters]
        body = [*missing, *self.block(self.body, self.tree.lineno)]
        return ast.FunctionDef(self.tree.name, arguments, body or [ast.Pass()], [], lineno=self.tree.lineno)

    def fresh(self) -> str:
        """Return a new name that the function does not use."""
        self.count += 1
        return f"_{self.count}"

    def refuse(self, node: ast.AST, construct: str) -> LagrangeError:
        """Return the error for a construct that a plain function must not use; `node` gives the line."""
        line = getattr(node, "lineno", self.tree.lineno)
        return LagrangeError(f"procedure {self.tree.name}, line {line}: a plain procedure cannot have {construct}.")

    # --- statements

    def block(self, body: Sequence[ast.stmt], before: int) -> list[ast.stmt]:
        """Return the rewritten statements of a body, with its comments. `before` is the line before the body."""
        made: list[ast.stmt] = []
        for statement in body:
            said = [self.comments[line] for line in range(before + 1, statement.lineno) if line in self.comments]
            before = statement.end_lineno or statement.lineno
            if said:
                made.append(ast.Expr(told("note", " ".join(said)), lineno=statement.lineno))
            for rewritten in self.statement(statement):
                if "lineno" not in rewritten.__dict__:
                    rewritten.lineno = statement.lineno
                made.append(rewritten)
        return made

    def statement(self, s: ast.stmt) -> list[ast.stmt]:
        """Return the rewritten form of one statement, as a list."""
        match s:
            case FinalReturn(value=value):
                return [ast.Return(self.expression(value) if value is not None else None)]
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                return []
            case ast.Expr(value=ast.Yield(value=value)):
                return [ast.Expr(ast.Yield(self.expression(value) if value is not None else None))]
            case ast.Expr(value=value):
                return [ast.Expr(self.expression(value))]
            case ast.Assign(targets=targets, value=value):
                return self.assignment(targets, value)
            case ast.AnnAssign(target=target, value=value) if value is not None:
                return self.assignment([target], value)
            case ast.AugAssign(target=target, op=op, value=value):
                return self.augmented(target, op, value)
            case ast.Return(value=value):
                return [ast.Expr(told("leave", self.optional(value)))]
            case ast.If():
                return self.branches(s)
            case ast.While(test=test, body=body, orelse=[]):
                head = put(loop := self.fresh(), told("repeat"))
                return [head, *self.loop(loop, told("times", lazily(self.expression(test)), of=loop), None, s, body)]
            case ast.For(iter=iterable, orelse=[]):
                return self.for_loop(s, iterable)
            case ast.FunctionDef():
                return self.local_function(s)
        raise self.refuse(s, INSTEAD.get(type(s), f"`{type(s).__name__.lower()}`"))

    def assignment(self, targets: Sequence[ast.expr], value: ast.expr) -> list[ast.stmt]:
        """Return the rewritten assignment to one or several targets."""
        if isinstance(targets[0], ast.Subscript) and isinstance(targets[0].slice, ast.Slice):
            return [ast.Expr(self.copy(targets[0], targets[0].slice, value))]
        if len(targets) == 1 and isinstance(targets[0], ast.Name):
            return [self.to_name(targets[0].id, self.expression(value))]
        held = self.fresh()
        made = [put(held, self.expression(value))]
        for target in targets:
            made += self.to_target(target, named(held))
        return made

    def to_target(self, target: ast.expr, value: ast.expr) -> list[ast.stmt]:
        """Return the assignment of a rewritten value to a target: a name, element, field or tuple."""
        match target:
            case ast.Name(id=name):
                return [self.to_name(name, value)]
            case ast.Tuple(elts=targets) | ast.List(elts=targets):
                held = self.fresh()
                made = [put(held, told("unpacked", value, len(targets)))]
                for i, entry in enumerate(targets):
                    made += self.to_target(entry, ast.Subscript(named(held), ast.Constant(i), LOAD))
                return made
            case ast.Subscript(value=array, slice=index) if not isinstance(index, ast.Slice):
                return [ast.Expr(told("store", self.expression(array), self.expression(index), value))]
            case ast.Attribute(value=owner, attr=field):
                return [ast.Expr(told("write", self.expression(owner), field, value))]
        raise self.refuse(target, INSTEAD.get(type(target), "this target"))

    def to_name(self, name: str, value: ast.expr) -> ast.stmt:
        """Return the assignment of a rewritten value to a name."""
        if name in self.own:
            return put(name, told("assign", named(name), name, value))
        return put(name, told("named", name, value))

    def copy(self, target: ast.Subscript, span: ast.Slice, value: ast.expr) -> ast.expr:
        """Return the rewritten copy `a[:n] = b[:n]`, or fill `a[:n] = number`. `span` is the target's slice."""
        destination = (self.expression(target.value), self.optional(span.lower), self.optional(span.upper))
        if isinstance(value, ast.Subscript) and isinstance(value.slice, ast.Slice):
            source = (self.expression(value.value), self.optional(value.slice.lower), self.optional(value.slice.upper))
            return told("copy", *destination, *source)
        return told("fill", *destination, self.expression(value))

    def optional(self, x: ast.expr | None) -> ast.expr:
        """Return the rewritten form of an expression, or the constant None if the expression is omitted."""
        return ast.Constant(None) if x is None else self.expression(x)

    def augmented(self, target: ast.expr, op: ast.operator, value: ast.expr) -> list[ast.stmt]:
        """Return the rewritten `target op= value`, which evaluates the index of the target once."""
        match target:
            case ast.Name(id=name):
                return [self.to_name(name, self.binary(op, self.name(name), self.expression(value)))]
            case ast.Subscript(value=array, slice=subscript) if not isinstance(subscript, ast.Slice):
                memory, index = self.fresh(), self.fresh()
                made = self.binary(op, told("item", named(memory), named(index)), self.expression(value))
                return [
                    put(memory, self.expression(array)),
                    put(index, self.expression(subscript)),
                    ast.Expr(told("store", named(memory), named(index), made)),
                ]
            case ast.Attribute(value=owner, attr=field):
                held = self.fresh()
                before = ast.Attribute(named(held), field, LOAD)
                made = self.binary(op, before, self.expression(value))
                return [put(held, self.expression(owner)), ast.Expr(told("write", named(held), field, made))]
        raise self.refuse(target, "this target of an assignment in place")

    # --- control flow

    def branches(self, s: ast.If) -> list[ast.stmt]:
        """Return the rewritten `if` statement with its two branches."""
        ways, branch = self.fresh(), self.fresh()
        chosen = ast.If(
            named(branch),
            self.block(s.body, s.lineno) or [ast.Pass()],
            self.block(s.orelse, s.body[-1].end_lineno or s.lineno),
        )
        made = self.block_run(s, ways, named(ways), branch, self.carried_by(s), [chosen])
        first = put(ways, told("branches", self.expression(s.test)))
        across = sorted(self.carried[s].across)
        if not across:
            return [first, *made]
        # A name that one branch sets is not visible in the other.
        kept, loop = self.fresh(), made[1]
        assert isinstance(loop, ast.For)
        names = ast.Tuple([ast.Name(name, STORE) for name in across], STORE)
        loop.body.append(ast.Assign([names], named(kept)))
        return [first, put(kept, ast.Tuple([named(name) for name in across], LOAD)), *made]

    def for_loop(self, s: ast.For, iterable: ast.expr) -> list[ast.stmt]:
        """Return the rewritten loop over `range`, `each`, or values that are known at build time."""
        loop = self.fresh()
        match iterable:
            case ast.Call(func=ast.Name(id="range"), args=args, keywords=[]):
                head = put(loop, told("loop", *[self.expression(arg) for arg in args]))
            case ast.Call(func=ast.Name(id="each"), args=args, keywords=keywords):
                options = [ast.keyword(keyword.arg, self.expression(keyword.value)) for keyword in keywords]
                call = told("each", *[self.expression(arg) for arg in args])
                call.keywords = options
                return [put(loop, call), *self.iterations(loop, s)]
            case _:
                head = put(loop, told("sequence", self.expression(iterable)))
        return [head, *self.loop(loop, named(loop), s.target, s, s.body)]

    def loop(
        self, loop: str, source: ast.expr, target: ast.expr | None, s: ast.stmt, body: Sequence[ast.stmt]
    ) -> list[ast.stmt]:
        """Return the rewritten loop `s`, which assigns each value of `source` to `target`; `loop` names its block."""
        index = self.fresh()
        first = [] if target is None else self.to_target(target, named(index))
        made = [*first, *self.block(body, s.lineno)] or [ast.Pass()]
        return self.block_run(s, loop, source, index, self.carried_by(s), made)

    def carried_by(self, s: ast.stmt) -> list[str]:
        """Return the names that a branch or loop sets and that are read later, in the order in which it sets them."""
        return [name for name in stored([s]) if name in self.carried[s].on]

    def block_run(
        self, s: ast.stmt, block: str, source: ast.expr, target: str, names: Sequence[str], body: list[ast.stmt]
    ) -> list[ast.stmt]:
        """Return the rewritten branch or loop `s`: statements that open a block, run its body, and close it.

        The block object has the name `block`. It gets the values of `names` before the block and at the end of each
        `body`, and returns their values after the block. `body` is inside a loop over `source` with the variable
        `target`.
        """
        texts = ast.Tuple([ast.Constant(name) for name in names], LOAD)
        values = [named(name) for name in names]
        anew = ast.Tuple([ast.Constant(name) for name in names if name in self.carried[s].anew], LOAD)

        def given(call: ast.expr) -> ast.stmt:
            if not names:
                return ast.Expr(call)
            return ast.Assign([ast.Tuple([ast.Name(name, STORE) for name in names], STORE)], call)

        if mentions(s).returns:
            caught = ast.Attribute(named(RECEIVER), "Ended", LOAD)
            handler = ast.ExceptHandler(caught, None, [ast.Expr(told("ended", of=block))])
            body = [ast.Try(body, [handler], [], [])]
        return [
            given(told("open", texts, anew, *values, of=block)),
            ast.For(ast.Name(target, STORE), source, [*body, given(told("close", *values, of=block))], []),
            given(told("after", of=block)),
        ]

    def iterations(self, loop: str, s: ast.For) -> list[ast.stmt]:
        """Return a rewritten `each`: names to which iterations add are reductions, others are local to an iteration."""
        if not isinstance(s.target, ast.Name):
            raise self.refuse(s, "several indices of an `each`")
        reductions = _reductions(s.body)
        slots = {name: i for i, name in enumerate(reductions)}
        body: list[ast.stmt] = self.to_target(s.target, named(index := self.fresh()))
        before = s.lineno
        for statement in s.body:
            folded = next((name for name, (where, _, _) in reductions.items() if where is statement), None)
            if folded is None:
                body += self.block([statement], before)
            else:
                _, function, args = reductions[folded]
                operation = "add" if function is None else self.expression(function)
                operands = [self.expression(arg) for arg in args]
                body.append(ast.Expr(told("fold", slots[folded], operation, *operands, of=loop)))
            before = statement.end_lineno or statement.lineno
        names = [name for name in self.carried_by(s) if name not in reductions]
        made = self.block_run(s, loop, named(loop), index, names, body)
        for name, slot in slots.items():
            made.append(self.to_name(name, told("folded", slot, self.name(name), of=loop)))
        return made

    def local_function(self, s: ast.FunctionDef) -> list[ast.stmt]:
        """Return the rewritten definition of an inner function, which is inlined into its callers."""
        if s.decorator_list:
            raise self.refuse(s, "a decorated function inside another")
        inner = Rewriter(s, self.comments, inlined=True, outer=self.changing)
        return [inner.function(), put(s.name, told("local", named(s.name)))]

    # --- expressions

    def expression(self, x: ast.expr) -> ast.expr:
        """Return the rewritten form of an expression."""
        made = self._expression(x)
        if "lineno" not in made.__dict__:
            made.lineno = x.lineno
        return made

    def _expression(self, x: ast.expr) -> ast.expr:
        match x:
            case ast.Constant() | ast.JoinedStr():
                return x
            case ast.Name(id=name):
                return self.name(name)
            case ast.Attribute(value=owner, attr=field):
                return ast.Attribute(self.expression(owner), field, LOAD)
            case ast.Subscript(value=array, slice=ast.Slice(lower=lower, upper=upper, step=None)):
                return told("part", self.expression(array), self.optional(lower), self.optional(upper))
            case ast.Subscript(value=array, slice=ast.Slice(lower=lower, upper=upper, step=step)):
                bounds = [self.optional(bound) for bound in (lower, upper, step)]
                return told("item", self.expression(array), ast.Call(named("slice"), bounds, []))
            case ast.Subscript(value=array, slice=index):
                return told("item", self.expression(array), self.expression(index))
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(op, self.expression(left), self.expression(right))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return told("opposite", self.expression(operand))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
                return ast.UnaryOp(op, self.expression(operand))
            case ast.BoolOp(op=op, values=[first, *others]):
                made = self.expression(first)
                for value in others:
                    name = "and" if isinstance(op, ast.And) else "or"
                    made = told("joined", name, made, lazily(self.expression(value)))
                return made
            case ast.Compare():
                return self.comparison(x)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return told(
                    "choose", self.expression(test), lazily(self.expression(body)), lazily(self.expression(orelse))
                )
            case ast.Call(func=function, args=args, keywords=keywords):
                made = told("call", self.expression(function), *[self.argument(arg) for arg in args])
                made.keywords = [ast.keyword(keyword.arg, self.expression(keyword.value)) for keyword in keywords]
                return made
            case ast.Tuple(elts=values):
                return ast.Tuple([self.argument(value) for value in values], LOAD)
            case ast.List(elts=values):
                return ast.List([self.argument(value) for value in values], LOAD)
            case ast.ListComp() | ast.GeneratorExp() | ast.Lambda():
                return self.scope(x)
        raise self.refuse(x, INSTEAD.get(type(x), f"`{ast.unparse(x)}`"))

    def name(self, name: str) -> ast.expr:
        """Return the expression that reads a name. If the name may be a variable, its present value is read."""
        if name in self.changing and not any(name in names for names in self.scoped):
            return told("read", named(name))
        return named(name)

    def argument(self, arg: ast.expr) -> ast.expr:
        """Return the rewritten argument of a call."""
        if isinstance(arg, ast.Starred):
            return ast.Starred(self.expression(arg.value), LOAD)
        return self.expression(arg)

    def binary(self, op: ast.operator, left: ast.expr, right: ast.expr) -> ast.expr:
        """Return the rewritten form of `left op right`."""
        if isinstance(op, DIRECT):
            return ast.BinOp(left, op, right)
        if type(op) not in BY_RECEIVER:
            raise self.refuse(op, f"the operator `{type(op).__name__}`")
        return told(BY_RECEIVER[type(op)], left, right)

    def comparison(self, x: ast.Compare) -> ast.expr:
        """Return a rewritten comparison. A chain `a < b < c` is `a < b and b < c`, where b is a name or a number."""
        made: ast.expr | None = None
        left = x.left
        for op, right in zip(x.ops, x.comparators, strict=True):
            if left is not x.left and not isinstance(left, (ast.Name, ast.Constant)):
                raise self.refuse(x, "a chain of comparisons around a computed value: give it a name first")
            pair = self.expression(left), self.expression(right)
            if type(op) in EQUALITIES:
                test: ast.expr = told(EQUALITIES[type(op)], *pair)
            else:
                test = ast.Compare(pair[0], [op], [pair[1]])
            made = test if made is None else told("joined", "and", made, lazily(test))
            left = right
        assert made is not None
        return made

    def scope(self, x: ast.ListComp | ast.GeneratorExp | ast.Lambda) -> ast.expr:
        """Return a lambda or comprehension with its parts rewritten. A comprehension is evaluated at build time."""
        if isinstance(x, ast.Lambda):
            with_names = frozenset(arg.arg for arg in x.args.args)
            self.scoped.append(with_names)
            made: ast.expr = told("local", ast.Lambda(x.args, self.expression(x.body)))
        else:
            sources = [self.expression(generator.iter) for generator in x.generators[:1]]
            self.scoped.append(frozenset(stored([generator.target for generator in x.generators])))
            sources += [self.expression(generator.iter) for generator in x.generators[1:]]
            generators = [
                ast.comprehension(generator.target, source, [self.expression(test) for test in generator.ifs], 0)
                for generator, source in zip(x.generators, sources, strict=True)
            ]
            made = type(x)(self.expression(x.elt), generators)
        self.scoped.pop()
        return made


def as_module(tree: ast.FunctionDef) -> ast.Module:
    """Return a module that contains only the function, for `compile`."""
    _place(tree, tree.lineno)
    return ast.Module([tree], [])


def _place(node: ast.AST, line: int) -> None:
    """Set the line of each node without one to the line of the enclosing node, or to `line`."""
    fields = node.__dict__
    line = fields.setdefault("lineno", line)
    fields.setdefault("col_offset", 0)
    for value in list(fields.values()):
        if isinstance(value, list):
            for child in value:
                if isinstance(child, ast.AST):
                    _place(child, line)
        elif isinstance(value, ast.AST) and value is not LOAD and value is not STORE:
            _place(value, line)


Reduction = tuple[ast.stmt, ast.expr | None, list[ast.expr]]


def _reductions(body: Sequence[ast.stmt]) -> dict[str, Reduction]:
    """Return the reductions of an `each`: {name: (statement, function or None for a sum, values)}.

    A name is a reduction if its only mention in the body is `x += value`, `x = f(x, value)` or `x = fma(a, b, x)`.
    """
    mentions: dict[str, int] = {}
    for node in (inner for statement in body for inner in ast.walk(statement)):
        if isinstance(node, ast.Name):
            mentions[node.id] = mentions.get(node.id, 0) + 1
    reductions: dict[str, Reduction] = {}
    for statement in body:
        match statement:
            case ast.AugAssign(target=ast.Name(id=name), op=ast.Add(), value=value) if mentions[name] == 1:
                reductions[name] = statement, None, [value]
            case ast.Assign(
                targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name() as function, args=args, keywords=[])
            ) if mentions[name] == 2:
                match args:
                    case [ast.Name(id=same), value] if same == name:
                        reductions[name] = statement, function, [value]
                    case [a, b, ast.Name(id=same)] if same == name:
                        reductions[name] = statement, function, [a, b]
    return reductions


def delegated(statement: ast.stmt) -> ast.stmt:
    """Return a loop that yields each value, for `yield from values`; return another statement unchanged."""
    match statement:
        case ast.Expr(value=ast.YieldFrom(value=values)):
            body = ast.Expr(ast.Yield(ast.Name("yielded_", LOAD)))
            loop = ast.For(ast.Name("yielded_", STORE), values, [body], [])
            return ast.fix_missing_locations(ast.copy_location(loop, statement))
    return statement


RESULT = "result_"


def single_exit(tree: ast.FunctionDef) -> list[ast.stmt]:
    """Return the body of a function rewritten to have a single return, at its end, as inlining requires.

    Code after a return in a branch moves to the other branch. Raises LagrangeError for a return in a loop.
    """
    returns = [node for node in _walk(tree.body) if isinstance(node, ast.Return)]
    last = tree.body[-1]
    if not returns or returns == [last]:
        return [*tree.body[:-1], _native(last)] if returns else tree.body
    for node in _walk(tree.body):
        if isinstance(node, LOOPS) and any(isinstance(inner, ast.Return) for inner in _walk(node.body)):
            raise LagrangeError(
                f"procedure {tree.name}, line {node.lineno}: a function that is written into its callers cannot return "
                "from inside a loop: keep the result in a variable, and return it after the loop."
            )
    counts = {len(node.value.elts) if isinstance(node.value, ast.Tuple) else 1 for node in returns if node.value}
    count = counts.pop() if counts else 0
    if counts:
        raise LagrangeError(f"procedure {tree.name}: all its return statements must have the same number of values.")
    names = [f"{RESULT}{i}" for i in range(count)]
    body = _nested(tree.body, names)
    if not names:
        return body
    values = [ast.copy_location(ast.Name(name, LOAD), last) for name in names]
    value = values[0] if len(values) == 1 else ast.Tuple(list(values), LOAD)
    end = ast.copy_location(_native(ast.Return(value)), last)
    return [*body, ast.fix_missing_locations(end)]


class FinalReturn(ast.Return):
    """Final return of an inlined function. It remains a `return` in the rewritten function."""


def _native(statement: ast.stmt) -> ast.stmt:
    assert isinstance(statement, ast.Return)
    return ast.copy_location(FinalReturn(statement.value), statement)


def _nested(body: Sequence[ast.stmt], names: Sequence[str]) -> list[ast.stmt]:
    """Return `body` with each `return` replaced by an assignment of its results to `names`.

    The statements after a branch that returns move into the other branch, so that they run only without the return.
    """
    made: list[ast.stmt] = []
    for i, statement in enumerate(body):
        rest = body[i + 1 :]
        if isinstance(statement, ast.Return):
            if names and statement.value is not None:
                targets = [ast.Name(name, STORE) for name in names]
                target = targets[0] if len(targets) == 1 else ast.Tuple(list(targets), STORE)
                result = ast.copy_location(ast.Assign([target], statement.value), statement)
                made.append(ast.fix_missing_locations(result))
            return made
        if isinstance(statement, ast.If) and any(isinstance(node, ast.Return) for node in _walk([statement])):
            ways = statement.body, statement.orelse
            then, otherwise = (_nested(way if _ends(way) else [*way, *rest], names) for way in ways)
            made.append(ast.copy_location(ast.If(statement.test, then or [ast.Pass()], otherwise), statement))
            return made
        made.append(statement)
    return made


def _ends(body: Sequence[ast.stmt]) -> bool:
    """Return True if every path through the statements ends with a return."""
    last = body[-1] if body else None
    return isinstance(last, ast.Return) or (isinstance(last, ast.If) and _ends(last.body) and _ends(last.orelse))


def _walk(body: Iterable[ast.stmt]) -> list[ast.stmt]:
    """Return statements and all statements inside them, except those of inner functions."""
    statements: list[ast.stmt] = []
    for statement in body:
        statements.append(statement)
        if isinstance(statement, ast.If):
            statements += _walk([*statement.body, *statement.orelse])
        elif isinstance(statement, LOOPS):
            statements += _walk(statement.body)
    return statements
