"""Mutants of the package: copies with one changed operator, comparison or number in one source file.

The name of a mutant is a hash of the seed, the file, the function and the change, but not of line numbers. A sample
has the mutants with the smallest names, so that it stays nearly the same when other source lines are edited.
"""

import ast
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FOLDERS = ("machine", "trajectory", "program", "evidence")
"""What is mutated: the folders of the package behind the equations of motion."""

NEAR = 40
"""So many characters are shown on either side of a change in a long expression."""

OPERATORS: dict[type[ast.AST], tuple[str, type[ast.AST]]] = {
    ast.Add: ("sum", ast.Sub),
    ast.Sub: ("sum", ast.Add),
    ast.Mult: ("product", ast.Div),
    ast.Div: ("product", ast.Mult),
    ast.FloorDiv: ("product", ast.Mult),
    ast.Lt: ("comparison", ast.Gt),
    ast.Gt: ("comparison", ast.Lt),
    ast.LtE: ("comparison", ast.GtE),
    ast.GtE: ("comparison", ast.LtE),
    ast.Eq: ("comparison", ast.NotEq),
    ast.NotEq: ("comparison", ast.Eq),
    ast.Is: ("comparison", ast.IsNot),
    ast.IsNot: ("comparison", ast.Is),
    ast.In: ("comparison", ast.NotIn),
    ast.NotIn: ("comparison", ast.In),
    ast.And: ("and/or", ast.Or),
    ast.Or: ("and/or", ast.And),
}
"""An operator of Python, the kind of its change, and what takes its place."""

EMITTED = {
    "sum": (("fadd", "fsub"), ("add nsw", "sub nsw")),
    "product": (("fmul", "fdiv"),),
    "comparison": (
        *((f"{p}cmp {q}{a}", f"{p}cmp {q}{b}") for p, q in ("fo", "fu", "is") for a, b in (("lt", "gt"), ("le", "ge"))),
        ("fcmp oeq", "fcmp one"),
        ("fcmp ueq", "fcmp une"),
        ("icmp eq", "icmp ne"),
    ),
    "and/or": (("and i1", "or i1"),),
}
"""The same changes in the text of machine code that a generator emits; each pair in both directions."""


@dataclass(frozen=True)
class Mutant:
    """One change. `place` is its number among the changes of the file."""

    name: str
    file: str
    line: int
    function: str
    kind: str
    before: str
    after: str
    place: int

    @property
    def folder(self) -> str:
        """The folder of the package that contains the file."""
        return self.file.split("/")[1]

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.function}: `{self.before}` -> `{self.after}`"


@dataclass(frozen=True)
class _Site:
    """A field of a syntax node that may be changed, its new value, and the expression or statement around it."""

    node: ast.AST
    field: str
    value: object
    function: str
    kind: str
    around: ast.AST


def mutants(file: str, source: str, seed: int) -> list[Mutant]:
    """Return every mutant of a file."""
    result: list[Mutant] = []
    times: dict[tuple[str, ...], int] = {}
    for place, site in enumerate(_sites(ast.parse(source))):
        old, before = getattr(site.node, site.field), ast.unparse(site.around)
        setattr(site.node, site.field, site.value)
        after = ast.unparse(site.around)
        setattr(site.node, site.field, old)
        what = (file, site.function, site.kind, before, after)
        times[what] = times.get(what, 0) + 1
        name = hashlib.sha256(repr((seed, *what, times[what])).encode()).hexdigest()[:12]
        line = getattr(site.around, "lineno", 0)
        result.append(Mutant(name, file, line, site.function, site.kind, *_difference(before, after), place))
    return result


def _difference(before: str, after: str) -> tuple[str, str]:
    """Return two texts without most of their common beginning and end."""
    first = _same(before, after)
    last = _same(before[:first:-1], after[:first:-1])
    cut = max(0, first - NEAR) if first > 2 * NEAR else 0
    ends = [len(text) if last <= 2 * NEAR else len(text) - last + NEAR for text in (before, after)]
    before, after = (" ".join(text[cut:end].split()) for text, end in zip((before, after), ends, strict=True))
    return before, after


def _same(one: str, other: str) -> int:
    """Return the length of the common beginning of two texts."""
    return next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def mutated(source: str, mutant: Mutant) -> str:
    """Return the source text with the change."""
    tree = ast.parse(source)
    site = next(site for place, site in enumerate(_sites(tree)) if place == mutant.place)
    setattr(site.node, site.field, site.value)
    return ast.unparse(tree)


def population(root: Path, seed: int) -> list[Mutant]:
    """Return every mutant of the folders that are mutated, in the order of their names."""
    files = [path for folder in FOLDERS for path in sorted((root / "lagrange" / folder).rglob("*.py"))]
    result = [
        mutant for path in files for mutant in mutants(path.relative_to(root).as_posix(), path.read_text("utf-8"), seed)
    ]
    return sorted(result, key=lambda mutant: mutant.name)


def sample(root: Path, seed: int, count: int) -> list[Mutant]:
    """Return the given number of mutants: those with the smallest names."""
    return population(root, seed)[:count]


def _sites(tree: ast.Module) -> Iterator[_Site]:
    left_out = {id(node) for node in _without_effect(tree)}
    yield from _walk(tree, "", tree, left_out)


def _without_effect(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes whose change has no effect: annotations and docstrings."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(returns=ast.expr() as part) | ast.AsyncFunctionDef(returns=ast.expr() as part):
                yield part
            case ast.arg(annotation=ast.expr() as part) | ast.AnnAssign(annotation=part):
                yield part
            case ast.Expr(value=ast.Constant() as part):
                yield part


def _walk(node: ast.AST, function: str, around: ast.AST, left_out: set[int]) -> Iterator[_Site]:
    if id(node) in left_out:
        return
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        function = f"{function}.{node.name}" if function else node.name
    elif isinstance(node, (ast.stmt, ast.BinOp, ast.BoolOp, ast.Compare, ast.UnaryOp, ast.Subscript, ast.Call)):
        around = node
    for kind, field, value in _changes(node):
        yield _Site(node, field, value, function, kind, around)
    for child in ast.iter_child_nodes(node):
        yield from _walk(child, function, around, left_out)


def _changes(node: ast.AST) -> Iterator[tuple[str, str, object]]:
    """Yield the changes of one node: their kind, a field, and its new value."""
    match node:
        case ast.BinOp(left=left, right=right) if _is_text(left) or _is_text(right):
            return
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op) if type(op) in OPERATORS:
            kind, other = OPERATORS[type(op)]
            yield kind, "op", other()
        case ast.Compare(ops=ops):
            for i, compared in enumerate(ops):
                kind, other = OPERATORS[type(compared)]
                yield kind, "ops", [*ops[:i], other(), *ops[i + 1 :]]
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not", "operand", ast.UnaryOp(op=ast.Not(), operand=operand)
        case ast.Constant(value=value) if type(value) is int:
            yield "constant", "value", value + 1
        case ast.Constant(value=str(text)):
            yield from ((kind, "value", changed) for kind, changed in _emitted(text))


def _is_text(node: ast.AST) -> bool:
    """Return True if an operand is a literal text or list, so that + cannot be changed to -."""
    return isinstance(node, (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _emitted(text: str) -> Iterator[tuple[str, str]]:
    """Yield the changes of a text that contains LLVM instructions."""
    for kind, pairs in EMITTED.items():
        for old, new in (either for pair in pairs for either in (pair, pair[::-1])):
            for result in re.finditer(rf"\b{old}\b", text):
                yield kind, text[: result.start()] + new + text[result.end() :]
