"""Imports point one way, between stages and between rooms, and every module is reachable.

The contracts in `pyproject.toml` state the order of the stages and rooms; import-linter checks them.
"""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest
from importlinter.cli import lint_imports

from tests.test_house import PACKAGE, functions, nodes, parsed

ROOT = Path(__file__).resolve().parent.parent
TABLES = (
    "lagrange", "lagrange.__main__", "lagrange.cli.program", "lagrange.compiler", "lagrange.statement.display",
    "lagrange.export.target",
)  # fmt: skip
"""Modules that load others by name: public names, command line, machines, pages of results, languages of exports."""
VIEWED = ("lagrange.system", "lagrange.trajectory.solution")
"""Modules of a class whose methods import what shows or analyses it, so that data loads no views of itself."""
DRAWERS = re.compile(r"_*(utils?|core|common|helpers?|misc)")

Modules = Mapping[str, ast.Module]


def named(files: Mapping[str, str]) -> Modules:
    """Return the syntax trees of the files of a package, by dotted name."""
    parts = {file: Path(file).with_suffix("").parts for file in files}
    return {".".join(part for part in parts[file] if part != "__init__"): parsed(files[file]) for file in files}


@cache
def imports() -> grimp.ImportGraph:
    """Return all imports of the package, also those inside functions and for types."""
    return grimp.build_graph("lagrange")


TYPES_ALONE = {
    "lagrange.procedure.values": "lagrange.procedure.builder",
    "lagrange.machine.llvm.vectors": "lagrange.machine.llvm.procedures",
    "lagrange.show.figures.ensemble_figure": "lagrange.show.ensemble",
}
"""Arrows back within a stage, each for the name of a type alone. No new ones."""


def hidden_imports(modules: Modules) -> list[str]:
    """Return imports of the package inside functions, and imports by name outside two tables."""
    result = []
    for name, tree in modules.items():
        for function in functions(tree) if name not in VIEWED else ():
            result += [f"{name}:{function.lineno} imports {node}" for node in map(ours, nodes(function)) if node]
        if name not in TABLES:
            result += [f"{name} imports by name" for node in nodes(tree) if by_name(node)]
    return result


def ours(node: ast.AST) -> str:
    """Return the name of a module of the package that a statement imports, or an empty text."""
    match node:
        case ast.ImportFrom(module=str(name)) | ast.Import(names=[ast.alias(name=name)]) if name.startswith("lagrange"):
            return name
    return ""


def by_name(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Attribute(attr="import_module") | ast.Name(id="import_module" | "__import__")):
            return True
    return False


def unreachable() -> set[str]:
    """Return modules that no public name, entry point or `python -m` reaches."""
    public = nodes(parsed((ROOT / "lagrange" / "__init__.pyi").read_text("utf-8")))
    trees = named({file: source for file, source in PACKAGE.items() if "import_module" in source})
    constants = (node.value for name in TABLES for node in nodes(trees[name]) if isinstance(node, ast.Constant))
    texts = [value.split(":")[0] for value in constants if isinstance(value, str)]
    for node in public:
        if isinstance(node, ast.ImportFrom):
            texts += [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
    names = {"lagrange", *entry_points(), *texts, *(f"lagrange.{text.lstrip('.')}" for text in texts)}
    begun = names & imports().modules
    reached = begun.union(*map(imports().find_upstream_modules, begun))
    packages = {name.rpartition(".")[0] for name in reached}
    return imports().modules - reached - packages


PAGE = "lagrange.compiler"
STAGE_CALLS = {
    "lagrange.equations.regularity": ("allowed_equations",),
    "lagrange.program.catalogue": ("program_of", "lower_nodes"),
    "lagrange.program.taylor": ("series_program",),
    "lagrange.machine.llvm_machine": ("LlvmMachine",),
    "lagrange.machine.numpy_machine": ("NumpyMachine",),
}
"""What takes a statement from stage to stage, by the module that has it: called on the page of the compiler alone."""


def called_elsewhere() -> Iterator[str]:
    """Yield modules other than compiler.py that use functions which make the next stage."""
    for name in named(PACKAGE).keys() - {PAGE}:
        for node in nodes(named(PACKAGE)[name]):
            if isinstance(node, ast.ImportFrom):
                calls = STAGE_CALLS.get(node.module or "", ())
                yield from (f"{name} imports {alias.name}" for alias in node.names if alias.name in calls)


def entry_points() -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = [*project["scripts"].values(), *(t for group in project["entry-points"].values() for t in group.values())]
    return {target.split(":")[0] for target in targets}


def test_imports_flow_one_way() -> None:
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_every_stage_is_called_on_the_page_of_the_compiler_alone() -> None:
    assert list(called_elsewhere()) == []
    whole = ast.unparse(named(PACKAGE)[PAGE])
    assert all(f"{call}" in whole for calls in STAGE_CALLS.values() for call in calls)


def test_no_cycles() -> None:
    # The package's __init__ is a table of names: who takes a name from it does not wait for its modules.
    stages = imports().modules - {"lagrange", *VIEWED}
    arrows = {name: imports().find_modules_directly_imported_by(name) - {TYPES_ALONE.get(name)} for name in stages}
    TopologicalSorter(arrows).prepare()


def test_no_import_of_ourselves_inside_a_function() -> None:
    assert hidden_imports(named(PACKAGE)) == []


@pytest.mark.parametrize(
    "source",
    [
        "from lagrange.errors import E",
        "import lagrange.errors",
        "import_module('lagrange.errors')",
    ],
)
def test_a_hidden_import_is_seen(source: str) -> None:
    assert hidden_imports(named({"lagrange/graph/node.py": f"def f():\n    {source}"}))


def test_every_module_is_reachable() -> None:
    assert unreachable() == set()


MOST_LOADED = 80
"""Modules that stating a system and showing its derivation may load: 67 today."""


def test_stating_a_system_loads_few_modules() -> None:
    loads = "import sys, lagrange.system\nprint(*(name for name in sys.modules if name.startswith('lagrange')))"
    loaded = subprocess.run([sys.executable, "-c", loads], capture_output=True, text=True, check=True).stdout.split()
    assert {"lagrange.system", "lagrange.equations.regularity", "lagrange.show.derivation_page"} <= set(loaded)
    assert len(loaded) <= MOST_LOADED
    assert [name for name in loaded if name.split(".")[1:2] in (["machine"], ["trajectory"], ["mechanics"])] == []


def test_the_root_has_the_system_and_the_compiler_alone() -> None:
    files = {path.stem for path in (ROOT / "lagrange").glob("*.py")}
    assert files == {"__init__", "__main__", "compiler", "errors", "system"}


def test_entry_points_exist() -> None:
    assert entry_points() <= imports().modules


def test_names_and_depth_of_modules() -> None:
    assert [name for name in named(PACKAGE) if any(DRAWERS.fullmatch(part) for part in name.split("."))] == []
    assert [name for name in named(PACKAGE) if name.count(".") > 3] == []


ROW = re.compile(r"\| `(lagrange[\w/]*)` \| [^|]{10,} \| ((?:`tests/[\w/.]+` ?)+)\|")
"""A row of the floor plan: a room, what it does, and its tests."""


def floor_plan() -> dict[str, list[str]]:
    """Return the tests that the page names for each room."""
    page = (ROOT / "docs" / "dev" / "extending.md").read_text("utf-8")
    return {match[1]: re.findall(r"`([^`]+)`", match[2]) for match in ROW.finditer(page)}


def test_the_floor_plan_has_every_folder_and_tests_that_exist() -> None:
    folders = [path for path in ROOT.glob("lagrange/**/") if any(path.glob("*.py")) or any(path.glob("*.toml"))]
    assert set(floor_plan()) == {folder.relative_to(ROOT).as_posix() for folder in folders}
    assert [test for tests in floor_plan().values() for test in tests if not (ROOT / test).exists()] == []


PLACE = re.compile(r"^\| [^|`]+ \| `(lagrange/[\w/]+\.pyi?)` \| `(\w+)` \|$", re.MULTILINE)
"""A row of the table of ordinary changes: a file, and a name that it defines."""


def test_the_places_of_ordinary_changes_exist() -> None:
    page = (ROOT / "docs" / "dev" / "extending.md").read_text("utf-8")
    rows = page.split("## An ordinary change")[1].split("\n## ")[0].count("\n| ") - 2
    places = PLACE.findall(page)
    assert rows == len(places) >= 20
    for file, name in places:
        text = (ROOT / file).read_text("utf-8")
        assert re.search(rf"^( *def |class |from .* as |){name}\b", text, re.MULTILINE), f"{file} has no {name}"


def test_every_folder_of_tests_is_in_the_floor_plan() -> None:
    page = (ROOT / "docs" / "dev" / "extending.md").read_text("utf-8")
    folders = {path.parent.name for path in ROOT.glob("tests/*/test_*.py")}
    assert [name for name in sorted(folders) if f"`tests/{name}" not in page] == []
