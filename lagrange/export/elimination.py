"""Solve symmetric linear systems in exported files: Python functions, and their translation to other languages.

Matrices that are not definite, such as those of systems with constraints, need row exchanges, which depend on the
numbers in the matrix. So these functions have loops; all other functions of a file without integrators have none.
"""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.linear.symmetric import PIVOT, PREFERENCE
from lagrange.procedure.form import FLAG, REAL
from lagrange.procedure.spelling import ATOM, Literals, Operator

ROWS = 3
"""Number of rows below the n rows of a factored matrix: row numbers, scales, and weights in the choice of a pivot."""


def factored(n: int, a: Any) -> bool:
    """Replace the symmetric matrix in `a` (n + 3, n) by its factors L U; return True if it is singular to round-off.

    The first n rows contain the lower triangle of the matrix. The three rows below receive the order of the rows, their
    scales, and their weights in the choice of a pivot. A positive definite matrix is eliminated in its upper triangle,
    which takes half of the time. In any other matrix rows are exchanged. The row of a constraint is preferred to the
    row of an inertia, which may be only a rounding error.
    """
    scaled(n, a)
    definite = True
    singular = False
    nan_or_zero = 0.0
    for i in range(n):
        definite = definite and a[i, i] > 0.0
        for j in range(n):
            nan_or_zero = nan_or_zero + 0.0 * a[i, j]
    positive = definite
    if definite:
        for j in range(n):
            positive = positive and a[j, j] > PIVOT
            pivot = 1.0 / a[j, j]
            for i in range(j + 1, n):
                factor = a[j, i] * pivot
                for k in range(i, n):
                    a[i, k] = a[i, k] - factor * a[j, k]
    if positive:
        for j in range(n):
            scale = 1.0 / a[j, j]
            for i in range(j + 1, n):
                a[i, j] = a[j, i] * scale
    if definite and not positive:
        for i in range(n):
            a[i, i] = 1.0
            for j in range(i):
                a[j, i] = a[i, j]
    if not positive:
        for j in range(n):
            best = j
            for i in range(j + 1, n):
                if abs(a[i, j]) * a[n + 2, i] > abs(a[best, j]) * a[n + 2, best]:
                    best = i
            if abs(a[best, j]) <= PIVOT:
                singular = True
            for k in range(n):
                a[j, k], a[best, k] = a[best, k], a[j, k]
            a[n, j], a[n, best] = a[n, best], a[n, j]
            a[n + 2, j], a[n + 2, best] = a[n + 2, best], a[n + 2, j]
            for i in range(j + 1, n):
                a[i, j] = a[i, j] / a[j, j]
                for k in range(j + 1, n):
                    a[i, k] = a[i, k] - a[i, j] * a[j, k]
    return singular and nan_or_zero == 0.0


def scaled(n: int, a: Any) -> None:
    """Fill the upper triangle of the matrix in `a` (n + 3, n), and scale its rows and columns.

    Scaling makes pivots independent of the user's units. Row n of `a` receives the order of rows, row n + 1 the scales,
    and row n + 2 the weights in the choice of a pivot. The magnitude of diagonal entries becomes one. Rows with a zero
    on the diagonal belong to constraints and to coordinates without inertia; their largest entry becomes one.
    Constraints are the last rows, and are scaled first. The scales are those of `lagrange.algorithm.linear.symmetric`.
    """
    for i in range(n):
        a[n, i] = float(i)
        a[n + 1, i] = 0.0
        a[n + 2, i] = PREFERENCE
        if abs(a[i, i]) > 0.0:
            a[n + 1, i] = 1.0 / math.sqrt(abs(a[i, i]))
            a[n + 2, i] = 1.0
        for j in range(i):
            a[j, i] = a[i, j]
    for i in reversed(range(n)):
        largest = 0.0
        for j in range(n):
            if abs(a[i, j]) * a[n + 1, j] > largest:
                largest = abs(a[i, j]) * a[n + 1, j]
        if a[n + 1, i] == 0.0 and largest > 0.0:
            a[n + 1, i] = 1.0 / largest
    for i in range(n):
        if a[n + 1, i] == 0.0:
            a[n + 1, i] = 1.0
    for i in range(n):
        for j in range(n):
            a[i, j] = a[n + 1, i] * a[i, j] * a[n + 1, j]


def solved(n: int, a: Any, right: Any, x: Any) -> None:
    """Write the solution of a linear system with the right-hand side `right` (n,) to `x` (n,).

    `a` (n + 3, n) has the factors of the matrix, from `factored`.
    """
    for i in range(n):
        row = int(a[n, i])
        x[i] = a[n + 1, row] * right[row]
    for j in range(n):
        for i in range(j + 1, n):
            x[i] = x[i] - a[i, j] * x[j]
    for j in reversed(range(n)):
        x[j] = x[j] / a[j, j]
        for i in range(j):
            x[i] = x[i] - a[i, j] * x[j]
    for i in range(n):
        x[i] = a[n + 1, i] * x[i]


@dataclass(frozen=True, kw_only=True)
class Statements:
    """Spellings of operations, literals and statements in a language, as templates with fields {0} or {name}.

    - `first` is the index of the first element; if it is 1, a loop includes its end.
    - `store` assigns a value to a variable. `local` is the first assignment to a local variable; {mut} is Rust's mut.
    - `element` and `entry` are an element of a vector and an entry of a matrix.
    - `loop` and `back` begin a loop, forwards and backwards, from an index, its first value and its end.
    - `when` begins a branch with a condition; `end_loop` and `end_when` end a loop and a branch.
    - `to_real` and `to_index` convert an index to a number and a number to an index.
    - `leave` ends the function with its result.
    """

    operations: Mapping[str, Operator]
    literals: Literals
    first: int = 0
    store: str = "{name} = {value}"
    local: str = ""
    element: str = "{0}[{1}]"
    entry: str = ""
    loop: str = ""
    back: str = ""
    when: str = ""
    end_loop: str = ""
    end_when: str = ""
    to_real: str = "{0}"
    to_index: str = "{0}"
    leave: str = ""

    def stored(self, name: str, value: str) -> str:
        """Return an assignment of a value to a name in the language."""
        return self.store.format(name=name, value=value)


def body(function: Callable[..., Any], style: Statements) -> list[str]:
    """Return the body of `factored` or `solved`, translated to the language of `style`, as indented lines."""
    statements = _statements(function)
    names = [
        target.id
        for statement in statements
        for part in ast.walk(statement)
        if isinstance(part, ast.Assign)
        for target in part.targets
        if isinstance(target, ast.Name)
    ]
    changed = {name: names.count(name) > 1 for name in names}
    return [f"    {line}" for line in _Printer(style, changed).block(statements)]


def _statements(function: Callable[..., Any]) -> list[ast.stmt]:
    """Return the syntax trees of a function's statements, without the docstring.

    If the first statement is a call of the function `scaled`, the statements of `scaled` replace it.
    """
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(tree, ast.FunctionDef)
    _, first, *rest = tree.body
    return [*(_statements(scaled) if isinstance(first, ast.Expr) else [first]), *rest]


class _Printer:
    """Prints syntax trees of Python in another language; loop indices count from that language's first index.

    `changed` has a flag for each local variable by name: True if the variable is assigned more than once.
    """

    def __init__(self, statements: Statements, changed: Mapping[str, bool]) -> None:
        self.statements, self.changed = statements, changed
        self.indices: dict[str, None] = {}
        self.defined: dict[str, None] = {}

    def block(self, body: Sequence[ast.stmt]) -> Iterator[str]:
        """Yield the lines of a block of Python statements in the other language."""
        style = self.statements
        for statement in body:
            match statement:
                case ast.For(target=ast.Name(id=index), iter=ast.Call(func=ast.Name(id=kind), args=args)):
                    self.indices[index] = None
                    inner = args[0].args if kind == "reversed" and isinstance(args[0], ast.Call) else args
                    start, stop = self.text(inner[0]) if len(inner) > 1 else str(style.first), self.text(inner[-1])
                    stop = f"{stop} - 1" if style.first and stop != "n" else stop
                    yield (style.back if kind == "reversed" else style.loop).format(index, start, stop)
                    yield from (f"    {line}" for line in self.block(statement.body))
                    yield style.end_loop
                case ast.If():
                    yield style.when.format(self.text(statement.test))
                    yield from (f"    {line}" for line in self.block(statement.body))
                    yield style.end_when
                case ast.Assign(targets=[ast.Name(id=name)]):
                    yield self._assigned(name, statement.value)
                case ast.Assign(targets=[ast.Tuple(elts=[first, second])]):
                    yield (style.local or style.store).format(name="kept", value=self.text(first), mut="")
                    yield style.stored(self.text(first), self.text(second))
                    yield style.stored(self.text(second), "kept")
                case ast.Assign(targets=[target]):
                    yield style.stored(self.text(target), self.text(statement.value))
                case ast.Return(value=ast.expr() as value):
                    yield style.leave.format(self.text(value))

    def _assigned(self, name: str, value: ast.expr) -> str:
        if isinstance(value, ast.Name) and value.id in self.indices:
            self.indices[name] = None
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "int":
            self.indices[name] = None
        template = self.statements.store if name in self.defined else self.statements.local or self.statements.store
        self.defined[name] = None
        return template.format(name=name, value=self.text(value), mut="mut " * self.changed[name])

    def index(self, node: ast.expr) -> str:
        """Return the text of an index: a variable as it is, a number shifted by the language's first index."""
        added, base = self.statements.first, node
        if isinstance(node, ast.BinOp) and isinstance(node.right, ast.Constant) and isinstance(node.right.value, int):
            added, base = added + node.right.value, node.left
        assert isinstance(base, ast.Name)
        added -= self.statements.first * (base.id in self.indices)
        return f"{base.id} + {added}" if added else base.id

    def text(self, node: ast.expr, least: int = 0) -> str:
        """Return the text of an expression, in parentheses if it binds less tightly than `least`."""
        binds, text = self._spelled(node)
        return text if binds >= least else f"({text})"

    def _spelled(self, node: ast.expr) -> tuple[int, str]:
        style = self.statements
        match node:
            case ast.Name(id="PIVOT" | "PREFERENCE" as name):
                return ATOM, self.statements.literals.real(PIVOT if name == "PIVOT" else PREFERENCE)
            case ast.Name(id=name):
                return ATOM, name
            case ast.Constant(value=bool() as value):
                return self.statements.literals.spelled(FLAG, value)
            case ast.Constant(value=float() as value):
                return self.statements.literals.spelled(REAL, value)
            case ast.Constant(value=value):
                return ATOM, str(value)
            case ast.Subscript(value=ast.Name(id=array), slice=ast.Tuple(elts=[row, column])):
                return ATOM, style.entry.format(array, self.index(row), self.index(column))
            case ast.Subscript(value=ast.Name(id=array), slice=index):
                return ATOM, style.element.format(array, self.index(index))
            case ast.BinOp(left=a, op=op, right=b):
                return self._operation(
                    {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div"}[type(op)], a, b
                )
            case ast.UnaryOp(op=ast.Not(), operand=value):
                return self._operation("not", value)
            case ast.BoolOp(values=[a, b]):
                return self._operation("and", a, b)
            case ast.Compare(left=a, ops=[ast.Gt()], comparators=[b]):
                return self._operation("less", b, a)
            case ast.Compare(left=a, ops=[op], comparators=[b]):
                return self._operation({ast.LtE: "less_equal", ast.Eq: "equal"}[type(op)], a, b)
            case ast.Call(func=ast.Name(id="float" | "int" as kind), args=[value]):
                return ATOM, (style.to_real if kind == "float" else style.to_index).format(self.text(value))
            case ast.Call(func=ast.Name(id="abs"), args=[value]):
                return self._operation("abs", value)
            case ast.Call(args=[value]):
                return self._operation("sqrt", value)
        raise NotImplementedError(ast.dump(node))

    def _operation(self, op: str, *args: ast.expr) -> tuple[int, str]:
        operator = self.statements.operations[op]
        texts = [self.text(arg, need) for arg, need in zip(args, operator.operands or (0,) * len(args), strict=True)]
        return operator.binds, operator.text.format(*texts)
