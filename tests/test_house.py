"""Rules of the code base as tests; each rule is shown to fail on a bad example."""

import ast
import io
import re
import runpy
import statistics
import tokenize
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
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
    """Return the syntax tree of a file. Rules must not change it."""
    return ast.parse(source)


@cache
def nodes(tree: ast.AST) -> tuple[ast.AST, ...]:
    """Return all nodes of a syntax tree."""
    return tuple(ast.walk(tree))


@cache
def blocks(tree: ast.AST) -> tuple[list[ast.stmt], ...]:
    """Return the lists of statements of a syntax tree: bodies, and what follows `else` and `finally`."""
    result: list[list[ast.stmt]] = []
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        inside = [block for name in BLOCKS if isinstance(block := getattr(node, name, None), list)]
        result += inside
        waiting += [statement for block in inside for statement in block]
        waiting += [*getattr(node, "handlers", ()), *getattr(node, "cases", ())]
    return tuple(result)


BLOCKS = ("body", "orelse", "finalbody")


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    every = (statement for block in blocks(tree) for statement in block)
    return (statement for statement in every if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)))


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return (function.end_lineno or function.lineno) - function.lineno + 1


# --- size -----------------------------------------------------------------------------------------------------


def too_long(file: str, source: str) -> Iterator[str]:
    if (lines := source.count("\n")) > LONGEST_FILE:
        yield f"{file}: {lines} lines"
    for function in functions(parsed(source)):
        if length(function) > LONGEST_FUNCTION:
            yield f"{file}:{function.lineno} {function.name}: {length(function)} lines"


# --- silence --------------------------------------------------------------------------------------------------

SILENCER = re.compile(r"#\s*(type:\s*ignore|noqa|pragma|(mypy|ruff|pyright):)", re.IGNORECASE)


def silences(file: str, source: str) -> Iterator[str]:
    # Most texts have nothing that looks like it, and need not be taken apart.
    for token in tokenize.generate_tokens(io.StringIO(source).readline) if SILENCER.search(source) else ():
        if token.type == tokenize.COMMENT and SILENCER.search(token.string):
            yield f"{file}:{token.start[0]} {token.string[:60]}"


def never_reached(file: str, source: str) -> Iterator[str]:
    """Yield statements that are never executed, because they follow a return or raise in their block."""
    for block in blocks(parsed(source)):
        for before, statement in pairwise(block):
            if isinstance(before, (ast.Return, ast.Raise, ast.Continue, ast.Break)):
                yield f"{file}:{statement.lineno}"


# --- words ----------------------------------------------------------------------------------------------------


MADE = re.compile(r"\bissue #?\d|\bthis session\b|\.\./shared|/(work|root)/\w|/tmp/(venv|brief)", re.IGNORECASE)


def speaks_of_its_making(file: str, source: str) -> Iterator[str]:
    for number, line in enumerate(source.splitlines() if MADE.search(source) else (), 1):
        if MADE.search(line):
            yield f"{file}:{number} {line.strip()[:70]}"


# --- figures --------------------------------------------------------------------------------------------------

MAKES_FIGURES = "lagrange/show/figures/style.py"
"""The one file that makes Matplotlib's figures: of a class that notebooks show by itself."""


def makes_figures(file: str, source: str) -> Iterator[str]:
    """Yield calls that make figures of Matplotlib's class, which a notebook may show as text."""
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
ORDER_KEPT = frozenset(("list", "tuple", "enumerate", "iter", "map", "filter", "zip", "fromkeys", "join", "next"))
ORDER_LOST = frozenset(("sorted", "set", "frozenset", "any", "all", "len", "min", "max"))


def is_set(node: ast.AST) -> bool:
    """Return True if an expression is clearly a set."""
    match node:
        case ast.Set() | ast.SetComp() | ast.Call(func=ast.Name(id="set" | "frozenset")):
            return True
        case ast.Attribute(attr=name) | ast.Call(func=ast.Attribute(attr=name)):
            return name in SETS_OF_SYMPY
        case ast.BinOp(left=left, right=right):
            return is_set(left) or is_set(right)
    return False


def called(node: ast.AST) -> str:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name
    return ""


def iterates_sets(file: str, source: str) -> Iterator[str]:
    """Yield iterations over a set whose order has an effect, unlike in `sorted` or `any`."""
    calls = [node for node in nodes(parsed(source)) if isinstance(node, ast.Call)]
    forgiven = {id(arg) for call in calls if called(call) in ORDER_LOST for arg in call.args}
    for node in nodes(parsed(source)):
        match node:
            case ast.For(iter=walked) | ast.Starred(value=walked) | ast.Assign(targets=[ast.Tuple()], value=walked):
                walks = [walked]
            case ast.ListComp(generators=parts) | ast.GeneratorExp(generators=parts) | ast.DictComp(generators=parts):
                walks = [part.iter for part in parts]
            case ast.Call(args=args) if called(node) in ORDER_KEPT:
                walks = list(args)
            case _:
                continue
        if id(node) not in forgiven and any(map(is_set, walks)):
            yield f"{file}:{node.lineno} takes a set in its own order"


# --- the tree -------------------------------------------------------------------------------------------------


def complaints(rule: Rule, files: dict[str, str]) -> list[str]:
    assert files
    return sorted({text for file, source in files.items() for text in rule(file, source)})


@pytest.mark.parametrize("rule", [too_long, silences, never_reached, makes_figures], ids=lambda rule: rule.__name__)
def test_the_package_keeps(rule: Rule) -> None:
    assert complaints(rule, PACKAGE) == []


@pytest.mark.parametrize("rule", [too_long, silences, never_reached], ids=lambda rule: rule.__name__)
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
    (silences, "x = f()  # type: ignore[misc]\n"),
    (never_reached, "def f():\n    return 'begin '\n    'end'"),
    (makes_figures, "def f():\n    import matplotlib.pyplot as plt"),
    (speaks_of_its_making, "see issue " + "#12"),
    (iterates_sets, "[f(x) for x in set(y)]"),
    (iterates_sets, "for x in expression.free_symbols: f(x)"),
    (iterates_sets, "', '.join({'a', 'b'})"),
]

SOUND: list[tuple[Rule, str]] = [
    (too_long, "x = 1\n" * LONGEST_FILE),
    (silences, "x = 'type: ignore'  # why it is so\n"),
    (never_reached, "def f():\n    if x:\n        return 1\n    return 2"),
    (makes_figures, "if TYPE_CHECKING:\n    from matplotlib.figure import Figure"),
    (speaks_of_its_making, "the tissue of a session"),
    (iterates_sets, "for x in sorted({2, 1}): f(x)"),
    (iterates_sets, "any(f(x) for x in {1, 2})"),
]


@pytest.mark.parametrize(("rule", "snippet"), [*BROKEN, *SOUND])
def test_a_rule_tells_broken_from_sound(rule: Rule, snippet: str) -> None:
    assert bool(list(rule("snippet.py", snippet))) == ((rule, snippet) in BROKEN)


# --- tables ---------------------------------------------------------------------------------------------------
# The tables on the pages equal those made from the registries.


DOCS = ROOT / "docs"
SCRIPT = runpy.run_path(str(DOCS / "tables.py"))


@pytest.mark.parametrize("marker", ["scenes", "methods"])
def test_the_page_has_the_table_of_now(marker: str) -> None:
    name, make = SCRIPT["TABLES"][marker]
    page = (DOCS / name).read_text("utf-8")
    assert SCRIPT["filled"](page, marker, make()) == page, f"run docs/tables.py: {name} is out of date"


# --- messages -------------------------------------------------------------------------------------------------
# Each message quoted on the page of errors occurs in the source.


ANY = "\0"
"""Stands in a text of the source for a value that is formatted into it, and in a quotation for "..."."""

ROW = re.compile(r"^\| ([^|]+) \|", re.MULTILINE)
HEADER = "the message contains"
OF_NUMPY = "loop of ufunc"
"""A message that NumPy raises for a function of an expression."""


def quotations() -> list[str]:
    """Return the quotations of two words or more in the first column of the tables of messages."""
    page = (DOCS / "errors.md").read_text("utf-8")
    tables = [part for part in page.split("\n\n") if part.startswith(f"| {HEADER}")]
    cells = [cell for table in tables for cell in ROW.findall(table)[2:]]
    return [
        quoted for cell in cells for quoted in re.findall(r"`([^`]+)`", cell) if " " in quoted and quoted != OF_NUMPY
    ]


@cache
def texts() -> dict[tuple[str, ...], frozenset[str]]:
    """Return the words of each text with a space in the source, in order and as a set; a formatted value is `ANY`."""
    result: list[tuple[str, ...]] = []
    for source in PACKAGE.values():
        result += [words(text) for text in strings(parsed(source)) if " " in text]
    return {text: frozenset(text) for text in result}


def strings(tree: ast.AST) -> Iterator[str]:
    """Yield the texts in a syntax tree; a value that is formatted into one is `ANY`."""
    for node in nodes(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
        elif isinstance(node, ast.JoinedStr):
            yield "".join(str(x.value) if isinstance(x, ast.Constant) else ANY for x in node.values)


def words(text: str) -> tuple[str, ...]:
    return tuple(ANY if ANY in word or word == "..." else word.strip(".,:;'()") for word in text.split())


def common(quoted: tuple[str, ...], text: tuple[str, ...]) -> int:
    """Return the number of words of `quoted` that occur literally and in succession in a text; -1 for no match.

    `ANY` in the text stands for any number of words.
    """
    reached = dict.fromkeys(range(len(text) + 1), 0)
    for word in quoted:
        after: dict[int, int] = {}
        for place, count in reached.items():
            if place < len(text) and (text[place] == word or ANY in (text[place], word)):
                after[place + 1] = max(after.get(place + 1, -1), count + (text[place] == word))
            if place and text[place - 1] == ANY:
                after[place] = max(after.get(place, -1), count)
        reached = after
    return max(reached.values(), default=-1)


def is_message(quoted: str) -> bool:
    """Return True if a text of the source matches a quotation, and has at least a third of its words literally."""
    parts = words(quoted)
    stated = sum(word != ANY for word in parts)
    literal = {*parts} - {ANY}
    near = [text for text, known in texts().items() if len(literal & known) * 3 >= len(literal)]
    return any(3 * common(parts, text) >= stated for text in near)


@pytest.mark.parametrize("quoted", quotations())
def test_a_quotation_is_a_message(quoted: str) -> None:
    assert is_message(quoted), f"no message contains {quoted!r}"


def test_other_words_are_no_message() -> None:
    assert not is_message("leaves accelerations closed there")
    assert not is_message("is a given function of space that lacks all numbers")
