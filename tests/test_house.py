"""The house rules that a reader would otherwise have to check by eye, each shown to fail on a bad snippet."""

from __future__ import annotations

import ast
import io
import re
import statistics
import tokenize
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in sorted(ROOT.glob("lagrange/**/*.py"))}
TESTS = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in sorted(ROOT.glob("tests/**/*.py"))}
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text("utf-8")
    for pattern in ("*.md", "*.toml", "docs/**/*.md", "docs/**/*.py", "examples/**/*.py", "lagrange/**/*.toml")
    for path in sorted(ROOT.glob(pattern))
}

LONGEST_FILE = 600
LONGEST_FUNCTION = 60
MEDIAN_FUNCTION = 10

Rule = Callable[[str, str], Iterator[str]]
"""(file, source) -> one complaint for each place that breaks the rule."""


@cache
def parsed(source: str) -> ast.Module:
    """Return the tree of a file, which all rules read and none changes."""
    return ast.parse(source)


@cache
def nodes(tree: ast.AST) -> tuple[ast.AST, ...]:
    """Return all nodes of a tree, which most rules go through."""
    return tuple(ast.walk(tree))


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in nodes(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)))


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return (function.end_lineno or function.lineno) - function.lineno + 1


# --- size -----------------------------------------------------------------------------------------------------


def too_long(file: str, source: str) -> Iterator[str]:
    if (lines := source.count("\n")) > LONGEST_FILE:
        yield f"{file}: {lines} lines"
    for function in functions(parsed(source)):
        if length(function) > LONGEST_FUNCTION:
            yield f"{file}:{function.lineno} {function.name}: {length(function)} lines"


# --- text that runs -------------------------------------------------------------------------------------------

RUNS_TEXT = frozenset(("eval", "exec", "sympify", "parse_expr", "lambdify", "S", "__import__"))


RUNS_ITS_OWN = "lagrange/machine/python_source.py"
"""The one file that runs source: what it has printed itself from a checked procedure, names and literals its own."""


def runs_text(file: str, source: str) -> Iterator[str]:
    for node in nodes(parsed(source)):
        match node:
            case ast.Call(func=ast.Name(id="exec")) if file == RUNS_ITS_OWN:
                continue
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in RUNS_TEXT:
                yield f"{file}:{node.lineno} calls {name}"
            case ast.ImportFrom(names=aliases):
                taken = sorted({alias.name for alias in aliases} & (RUNS_TEXT - {"S"}))
                yield from (f"{file}:{node.lineno} imports {name}" for name in taken)


# --- silence --------------------------------------------------------------------------------------------------

SILENCER = re.compile(
    r"#\s*((TODO|FIXME|XXX|HACK)\b|type:\s*ignore|noqa|pragma|(mypy|ruff|pyright):)",
    re.IGNORECASE,
)


def silences(file: str, source: str) -> Iterator[str]:
    # Most texts have nothing that looks like it, and need not be taken apart.
    for token in tokenize.generate_tokens(io.StringIO(source).readline) if SILENCER.search(source) else ():
        if token.type == tokenize.COMMENT and SILENCER.search(token.string):
            yield f"{file}:{token.start[0]} {token.string[:60]}"
    for node in nodes(parsed(source)) if "except" in source or "suppress" in source else ():
        match node:
            case ast.ExceptHandler(type=None):
                yield f"{file}:{node.lineno} catches everything"
            case ast.ExceptHandler(body=[ast.Pass() | ast.Expr(value=ast.Constant())]):
                yield f"{file}:{node.lineno} swallows an exception"
            case ast.Call(func=ast.Name(id="suppress") | ast.Attribute(attr="suppress"), args=caught) if any(
                isinstance(arg, ast.Name) and arg.id in ("Exception", "BaseException") for arg in caught
            ):
                yield f"{file}:{node.lineno} swallows every exception"


# --- words ----------------------------------------------------------------------------------------------------


def undocumented(file: str, source: str) -> Iterator[str]:
    """Public modules, classes and functions without a docstring, or with one that repeats their name."""
    tree = parsed(source)
    if not re.search(r"/_[a-z]", file) and not ast.get_docstring(tree):
        yield f"{file}: the module has no docstring"
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            text = ast.get_docstring(node)
            if any(ast.unparse(one).endswith("overload") for one in node.decorator_list):
                continue
            if not text:
                yield f"{file}:{node.lineno} {node.name} has no docstring"
            elif letters(text) == letters(node.name):
                yield f"{file}:{node.lineno} the docstring of {node.name} repeats its name"


def letters(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


MADE = re.compile(r"\bissue #?\d|\bthis session\b|\.\./shared|/(work|root)/\w|/tmp/(venv|brief)", re.IGNORECASE)


def speaks_of_its_making(file: str, source: str) -> Iterator[str]:
    for number, line in enumerate(source.splitlines(), 1):
        if MADE.search(line):
            yield f"{file}:{number} {line.strip()[:70]}"


# --- formulas -------------------------------------------------------------------------------------------------


def simplifies(file: str, source: str) -> Iterator[str]:
    """Calls of SymPy's `simplify`, whose time has no bound, also inside methods of matrices."""
    for node in nodes(parsed(source)) if "simplify" in source else ():
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="sympy"), attr="simplify")):
                yield f"{file}:{node.lineno} calls simplify: call simplest() of lagrange/mechanics/plain_form.py"
            case ast.keyword(arg="simplify", value=ast.Constant(value=True)):
                yield f"{file}:{node.value.lineno} lets SymPy simplify: give simplify=simplest"


# --- figures --------------------------------------------------------------------------------------------------

MAKES_FIGURES = "lagrange/show/figures/new_figure.py"
"""The one file that makes Matplotlib's figures: of a class that notebooks show by itself."""


def makes_figures(file: str, source: str) -> Iterator[str]:
    """Figures of Matplotlib's own class, which a notebook shows as a text unless a backend is set."""
    for function in functions(parsed(source)) if file != MAKES_FIGURES and "matplotlib" in source else ():
        for node in nodes(function):
            match node:
                case ast.ImportFrom(module="matplotlib.figure" | "matplotlib.pyplot" as module):
                    yield f"{file}:{node.lineno} imports {module}: call new_figure() of {MAKES_FIGURES}"
                case ast.Import(names=[ast.alias(name="matplotlib.figure" | "matplotlib.pyplot" as module)]):
                    yield f"{file}:{node.lineno} imports {module}: call new_figure() of {MAKES_FIGURES}"


# --- determinism ----------------------------------------------------------------------------------------------

GENERATORS = ("lagrange/graph/", "lagrange/equations/", "lagrange/program/", "lagrange/machine/")
"""Where the order of a loop becomes the order of code: the same statement must give the same bytes everywhere."""
SETS_OF_SYMPY = frozenset(("atoms", "free_symbols", "find"))
SET_METHODS = frozenset(("union", "intersection", "difference", "symmetric_difference", "copy"))
ORDER_KEPT = frozenset(
    ("list", "tuple", "enumerate", "iter", "map", "filter", "zip", "fromkeys", "join", "next", "extend", "sum")
)
ORDER_LOST = frozenset(("sorted", "set", "frozenset", "any", "all", "len", "min", "max"))


def is_set(node: ast.AST | None, names: frozenset[str]) -> bool:
    """Whether the expression is a set, as far as its form and the local names tell."""
    match node:
        case ast.Set() | ast.SetComp():
            return True
        case ast.Name(id=name):
            return name in names
        case ast.Attribute(attr=name):
            return name in SETS_OF_SYMPY
        case ast.Call(func=ast.Name(id="set" | "frozenset")):
            return True
        case ast.Call(func=ast.Attribute(attr=name, value=owner)):
            return name in SETS_OF_SYMPY or (name in SET_METHODS and is_set(owner, names))
        case ast.BinOp(op=ast.BitOr() | ast.BitAnd() | ast.Sub() | ast.BitXor(), left=left, right=right):
            return is_set(left, names) or is_set(right, names)
        case ast.IfExp(body=body, orelse=other):
            return is_set(body, names) or is_set(other, names)
    return False


def set_names(scope: ast.AST) -> frozenset[str]:
    """Names that the scope binds to a set, or annotates as one."""
    found: frozenset[str] = frozenset()
    for node in nodes(scope):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if is_set(value, found):
                found |= {name}
            case ast.NamedExpr(target=ast.Name(id=name), value=value) if is_set(value, found):
                found |= {name}
            case ast.AnnAssign(target=ast.Name(id=name), annotation=kind) if annotates_set(kind):
                found |= {name}
            case ast.arg(arg=name, annotation=kind) if annotates_set(kind):
                found |= {name}
    return found


def annotates_set(kind: ast.AST | None) -> bool:
    head = kind.value if isinstance(kind, ast.Subscript) else kind
    return isinstance(head, ast.Name) and head.id in ("set", "frozenset", "Set", "AbstractSet", "MutableSet")


def sorts_by_address(node: ast.AST) -> bool:
    match node:
        case ast.keyword(arg="key", value=ast.Name(id="id" | "hash")):
            return True
    return False


def iterates_sets(file: str, source: str) -> Iterator[str]:
    tree = parsed(source)
    forgiven = {id(arg) for call in nodes(tree) if called(call) in ORDER_LOST for arg in getattr(call, "args", ())}
    forgiven |= {id(node) for node in nodes(tree) if isinstance(node, ast.SetComp)}
    for scope in (tree, *functions(tree)):
        names = set_names(scope)
        for node in nodes(scope):
            if any(is_set(walked, names) for walked in ordered_walks(node, forgiven)):
                yield f"{file}:{getattr(node, 'lineno', 0)} takes a set in its own order"
            if sorts_by_address(node):
                yield f"{file} sorts by address"


def called(node: ast.AST) -> str:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name
    return ""


def ordered_walks(node: ast.AST, forgiven: set[int]) -> list[ast.AST]:
    """What the node goes through in an order that its result shows."""
    match node:
        case ast.For(iter=walked) | ast.Starred(value=walked):
            return [walked]
        case ast.Assign(targets=[ast.Tuple() | ast.List()], value=walked):
            return [walked]
        case ast.ListComp(generators=parts) | ast.GeneratorExp(generators=parts) | ast.DictComp(generators=parts):
            return [] if id(node) in forgiven else [part.iter for part in parts]
        case ast.Call(args=args) if called(node) in ORDER_KEPT and id(node) not in forgiven:
            return list(args)
        case ast.Call(func=ast.Attribute(attr="pop", value=owner), args=[]):
            return [owner]
    return []


# --- the tree -------------------------------------------------------------------------------------------------


def complaints(rule: Rule, files: dict[str, str]) -> list[str]:
    return sorted({text for file, source in files.items() for text in rule(file, source)})


def test_there_is_something_to_look_at() -> None:
    assert "lagrange/errors.py" in PACKAGE
    assert "tests/test_house.py" in TESTS
    assert "README.md" in PAGES


@pytest.mark.parametrize(
    "rule", [too_long, runs_text, silences, undocumented, makes_figures, simplifies], ids=lambda rule: rule.__name__
)
def test_the_package_keeps(rule: Rule) -> None:
    assert complaints(rule, PACKAGE) == []


@pytest.mark.parametrize("rule", [too_long, silences], ids=lambda rule: rule.__name__)
def test_the_tests_keep(rule: Rule) -> None:
    assert complaints(rule, TESTS) == []


def test_nothing_speaks_of_its_making() -> None:
    assert complaints(speaks_of_its_making, {**PACKAGE, **TESTS, **PAGES}) == []


def test_no_set_decides_an_order() -> None:
    stages = {file: source for file, source in PACKAGE.items() if file.startswith(GENERATORS)}
    assert stages
    assert complaints(iterates_sets, stages) == []


def test_every_file_has_a_plain_name() -> None:
    # A test that is run by hand in the checkout may leave a file there that is named by what it was given.
    there = [
        *ROOT.glob("*"),
        *(path for folder in ("lagrange", "tests", "docs", "examples") for path in ROOT.glob(f"{folder}/**/*")),
    ]
    assert [path.name for path in there if not re.fullmatch(r"[A-Za-z0-9_.-]+", path.name)] == []


def test_the_median_function_is_short() -> None:
    lengths = [length(function) for source in PACKAGE.values() for function in functions(parsed(source))]
    assert statistics.median(lengths) < MEDIAN_FUNCTION


# --- the rules, on snippets that break them and on their neighbours that do not -------------------------------

BROKEN: list[tuple[Rule, str]] = [
    (too_long, "x = 1\n" * (LONGEST_FILE + 1)),
    (too_long, "def f():\n" + "    x = 1\n" * LONGEST_FUNCTION),
    (runs_text, "eval('1')"),
    (runs_text, "sympy.sympify('1')"),
    (runs_text, "sympy.S('1')"),
    (runs_text, "from sympy import lambdify as f"),
    (runs_text, "builtins.exec(x)"),
    (silences, "x = f()  # type: ignore[misc]\n"),
    (silences, "import os  # noqa: F401\n"),
    (silences, "# TODO later\n"),
    (silences, "# mypy: ignore-errors\n"),
    (silences, "try:\n    f()\nexcept ValueError:\n    pass\n"),
    (silences, "try:\n    f()\nexcept ValueError:\n    ...\n"),
    (silences, "try:\n    f()\nexcept:\n    raise\n"),
    (silences, "with contextlib.suppress(Exception):\n    f()\n"),
    (undocumented, "x = 1"),
    (undocumented, '"""Text."""\ndef f(): return 1'),
    (undocumented, '"""Text."""\nclass Node: pass'),
    (undocumented, '"""Text."""\nclass ButcherTableau:\n    """Butcher tableau."""'),
    (makes_figures, "def f():\n    from matplotlib.figure import Figure"),
    (makes_figures, "def f():\n    import matplotlib.pyplot as plt"),
    (simplifies, "sympy.simplify(x)"),
    (simplifies, "m.rank(simplify=True)"),
    (speaks_of_its_making, "see issue " + "#12"),
    (speaks_of_its_making, "in .." + "/shared/design.md"),
    (iterates_sets, "for x in {1, 2}: f(x)"),
    (iterates_sets, "[f(x) for x in set(y)]"),
    (iterates_sets, "s = set()\ns.add(1)\nfor x in s: f(x)"),
    (iterates_sets, "def g(s: set[int]):\n    return list(s)"),
    (iterates_sets, "for x in expression.free_symbols: f(x)"),
    (iterates_sets, "for x in expression.atoms(Symbol): f(x)"),
    (iterates_sets, "tuple(a | {1})"),
    (iterates_sets, "{x: 1 for x in frozenset(y)}"),
    (iterates_sets, "f(*{1, 2})"),
    (iterates_sets, "', '.join({'a', 'b'})"),
    (iterates_sets, "(x,) = {1}"),
    (iterates_sets, "{1, 2}.pop()"),
    (iterates_sets, "for i, x in enumerate({1, 2}): f(x)"),
    (iterates_sets, "sorted(nodes, key=id)"),
]

SOUND: list[tuple[Rule, str]] = [
    (too_long, "x = 1\n" * LONGEST_FILE),
    (runs_text, "evaluate('1'); S.Zero; x.evalf()"),
    (silences, "x = 'type: ignore'  # why it is so\n"),
    (silences, "try:\n    f()\nexcept ValueError as error:\n    g(error)\n"),
    (undocumented, '"""Text."""\ndef _f(): return 1'),
    (makes_figures, "if TYPE_CHECKING:\n    from matplotlib.figure import Figure"),
    (makes_figures, "def f():\n    from matplotlib.ticker import Formatter"),
    (simplifies, "m.rank(simplify=simplest)"),
    (speaks_of_its_making, "the tissue of a session"),
    (iterates_sets, "for x in sorted({2, 1}): f(x)"),
    (iterates_sets, "s = {1}\nif x in s: f(x)"),
    (iterates_sets, "sorted(f(x) for x in {1, 2})"),
    (iterates_sets, "any(f(x) for x in {1, 2})"),
    (iterates_sets, "{f(x) for x in {1, 2}}"),
    (iterates_sets, "for x in dict.fromkeys(y): f(x)"),
    (iterates_sets, "for x in y - z: f(x)"),
]


@pytest.mark.parametrize(("rule", "snippet"), BROKEN)
def test_a_broken_rule_is_seen(rule: Rule, snippet: str) -> None:
    assert list(rule("snippet.py", snippet))


@pytest.mark.parametrize(("rule", "snippet"), SOUND)
def test_a_kept_rule_is_not(rule: Rule, snippet: str) -> None:
    assert list(rule("snippet.py", snippet)) == []
