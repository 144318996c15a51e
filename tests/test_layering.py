"""Imports point one way, between stages and between rooms, and every module is reachable."""

import ast
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.test_house import functions, nodes
from tests.test_house import parsed as tree_of

ROOT = Path(__file__).resolve().parent.parent
STAGES = (
    *("errors", "statement", "graph", "equations", "program", "procedure", "algorithm", "machine", "trajectory"),
    *("evidence", "mechanics", "members", "dynamics", "show", "export", "page", "recipes"),
)
TOP = len(STAGES)
"""Where lagrange itself and the modules beside it stand: compiler, system, run, cli and the like."""
TABLES = (
    "lagrange", "lagrange.__main__", "lagrange.cli.program", "lagrange.compiler", "lagrange.statement.display",
    "lagrange.export.target",
)  # fmt: skip
"""Modules that load others by name: public names, command line, machines, pages of results, languages of exports."""
VIEWED = ("lagrange.system", "lagrange.trajectory.solution")
"""Modules of a class whose methods import what shows or analyses it, so that data loads no views of itself.

What they import in methods, or for types alone, is not counted as an arrow.
"""
DRAWERS = re.compile(r"_*(utils?|core|common|helpers?|misc)")

Modules = Mapping[str, ast.Module]


def parsed(root: Path) -> dict[str, ast.Module]:
    """Return the syntax trees of all modules of the package, by dotted name."""
    modules = {}
    for path in sorted((root / "lagrange").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        stub = path.with_suffix(".pyi")
        text = path.read_text(encoding="utf-8") + (stub.read_text(encoding="utf-8") if stub.exists() else "")
        modules[name] = tree_of(text)
    return modules


@cache
def package() -> dict[str, ast.Module]:
    """Return the modules of the package, read once."""
    return parsed(ROOT)


def layer(module: str) -> int:
    stage = module.split(".")[1] if "." in module else ""
    return STAGES.index(stage) if stage in STAGES else TOP


@cache
def statements_of_import(tree: ast.AST) -> tuple[ast.Import | ast.ImportFrom, ...]:
    return tuple(node for node in nodes(tree) if isinstance(node, (ast.Import, ast.ImportFrom)))


def imports_of(tree: ast.AST, modules: Modules) -> Iterator[tuple[str, int]]:
    """Yield the package's modules that a syntax tree imports, with the line."""
    for node in statements_of_import(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module is not None:
            deeper = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in modules else node.module for name in deeper]
        else:
            continue
        yield from ((name, node.lineno) for name in names if name.split(".")[0] == "lagrange")


TYPES_ALONE = {
    "lagrange.procedure.values": "lagrange.procedure.builder",
    "lagrange.machine.llvm.vectors": "lagrange.machine.llvm.procedures",
    "lagrange.show.race": "lagrange.show.race",
    "lagrange.show.figures.ensemble_figure": "lagrange.show.ensemble",
}
"""Arrows back within a stage, each for the name of a type alone. No new ones."""


def arrows(name: str, modules: Modules) -> Iterator[tuple[str, int]]:
    """Yield the imports of a module with their lines. Imports for types count too, except those of a viewed class."""
    tree = modules[name]
    outside = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    for part in outside if name in VIEWED else (tree,):
        yield from imports_of(part, modules)


def flows_back(modules: Modules) -> list[str]:
    """Return imports of a later stage by an earlier one."""
    return [
        f"{name}:{line} imports {target}"
        for name in modules
        for target, line in arrows(name, modules)
        if layer(target) > layer(name)
    ]


def cycle(modules: Modules) -> list[str]:
    """Return modules that import each other in a cycle, also within a stage."""
    # The package's __init__ is a table of names: who takes a name from it does not wait for its modules.
    graph = {
        name: {target for target, _ in arrows(name, modules)} - {name, TYPES_ALONE.get(name)}
        for name in modules
        if name != "lagrange"
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def hidden_imports(modules: Modules) -> list[str]:
    """Return imports of the package inside functions, and imports by name outside two tables."""
    result = []
    for name, tree in modules.items():
        for function in functions(tree) if name not in VIEWED else ():
            result += [f"{name}:{line} imports {what}" for what, line in imports_of(function, modules)]
            inside = statements_of_import(function)
            result += [f"{name}:{function.lineno} imports relatively" for node in inside if relative(node)]
        if name not in TABLES:
            result += [f"{name} imports by name" for node in nodes(tree) if by_name(node)]
    return result


MOST_LOADED = 80
"""Modules that stating a system and showing its derivation may load: 67 today."""


def loaded_by(start: str, modules: Modules) -> set[str]:
    """Return the modules that are loaded when a module is imported."""
    reached: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in reached or name == "lagrange":
            continue
        reached.add(name)
        parts = name.split(".")
        waiting += [".".join(parts[:k]) for k in range(1, len(parts))]
        outside = [node for node in modules[name].body if isinstance(node, (ast.Import, ast.ImportFrom))]
        waiting += [target for node in outside for target, _ in imports_of(node, modules)]
    return reached


def relative(node: ast.AST) -> bool:
    return isinstance(node, ast.ImportFrom) and node.level > 0


def by_name(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Attribute(attr="import_module") | ast.Name(id="import_module" | "__import__")):
            return True
    return False


def unreachable(modules: Modules, entries: set[str]) -> list[str]:
    """Return modules that no public name, entry point or `python -m` reaches."""
    trees = [modules[name] for name in TABLES if name in modules]
    constants = (node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant))
    texts = {value.split(":")[0] for value in constants if isinstance(value, str)}
    lazily = {name for text in texts for name in (text, f"lagrange.{text.lstrip('.')}") if name in modules}
    waiting = sorted({"lagrange", "lagrange.__main__"} | lazily | entries)
    reached: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in reached or name not in modules:
            continue
        reached.add(name)
        parts = name.split(".")
        waiting += [".".join(parts[:k]) for k in range(1, len(parts))]
        waiting += [target for target, _ in imports_of(modules[name], modules)]
    return sorted(set(modules) - reached)


PAGE = "lagrange.compiler"
STAGE_CALLS = {
    "lagrange.equations.regularity": ("allowed_equations",),
    "lagrange.program.catalogue": ("program_of", "lower_nodes"),
    "lagrange.program.taylor": ("series_program",),
    "lagrange.machine.llvm_machine": ("LlvmMachine",),
    "lagrange.machine.numpy_machine": ("NumpyMachine",),
}
"""What takes a statement from stage to stage, by the module that has it: called on the page of the compiler alone."""


def called_elsewhere(modules: Modules) -> list[str]:
    """Return modules other than compiler.py that use functions which make the next stage."""
    return [
        f"{name}:{node.lineno} imports {alias.name}"
        for name, tree in modules.items()
        for node in statements_of_import(tree)
        if name != PAGE and isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.name in STAGE_CALLS.get(node.module or "", ())
    ]


def entry_points() -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = [*project["scripts"].values(), *(t for group in project["entry-points"].values() for t in group.values())]
    return {target.split(":")[0] for target in targets}


def test_imports_flow_one_way() -> None:
    assert not flows_back(package())


def test_every_stage_is_called_on_the_page_of_the_compiler_alone() -> None:
    assert not called_elsewhere(package())
    whole = ast.unparse(package()[PAGE])
    assert all(f"{call}" in whole for calls in STAGE_CALLS.values() for call in calls)


def test_no_cycles() -> None:
    assert not cycle(package())


def test_no_import_of_ourselves_inside_a_function() -> None:
    assert not hidden_imports(package())


def test_every_module_is_reachable() -> None:
    assert not unreachable(package(), entry_points())


def test_stating_a_system_loads_few_modules() -> None:
    loaded = loaded_by("lagrange.system", package())
    assert {"lagrange.system", "lagrange.equations.regularity", "lagrange.show.derivation_page"} <= loaded
    assert len(loaded) <= MOST_LOADED
    assert not {name for name in loaded if layer(name) in map(STAGES.index, ("machine", "trajectory", "mechanics"))}


def test_the_root_has_the_system_and_the_compiler_alone() -> None:
    files = {path.stem for path in (ROOT / "lagrange").glob("*.py")}
    assert files == {"__init__", "__main__", "compiler", "errors", "system"}


def test_entry_points_exist() -> None:
    assert not entry_points() - set(package())


def test_no_drawers() -> None:
    assert not [name for name in package() if any(DRAWERS.fullmatch(part) for part in name.split("."))]


def test_depth_at_most_two_below_the_package() -> None:
    assert not [name for name in package() if name.count(".") > 3]


# The rules themselves, on small trees that break them.

STAGED = {
    "lagrange": ast.parse("NAMES = {'System': 'lagrange.system', 'Status': 'trajectory.status'}"),
    "lagrange.errors": ast.parse("class E(Exception): ..."),
    "lagrange.graph": ast.parse("''"),
    "lagrange.graph.node": ast.parse("from lagrange.errors import E"),
    "lagrange.system": ast.parse("import lagrange.graph.node"),
    "lagrange.trajectory": ast.parse("''"),
    "lagrange.trajectory.status": ast.parse("from lagrange import errors"),
}
RULES = (flows_back, cycle, hidden_imports, lambda modules: unreachable(modules, set()))
BROKEN = [
    (flows_back, "from lagrange.trajectory.status import Status"),
    (flows_back, "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from lagrange.system import System"),
    (flows_back, "def f():\n    import lagrange.system"),
    (hidden_imports, "def f():\n    from lagrange.errors import E"),
    (hidden_imports, "import importlib\nimportlib.import_module('lagrange.errors')"),
    (cycle, "from lagrange.system import System"),
]


def test_a_good_tree_passes() -> None:
    assert [rule(STAGED) for rule in RULES] == [[]] * len(RULES)


@pytest.mark.parametrize(("rule", "source"), BROKEN)
def test_a_rule_sees_a_module_that_breaks_it(rule: Callable[[Modules], list[str]], source: str) -> None:
    assert rule({**STAGED, "lagrange.graph.node": ast.parse(source)})


# The rooms of machine/ and trajectory/: only the imports in a table, and none backwards.

PLAIN: Mapping[str, tuple[str, ...]] = {
    "machine records": ("backend", "parameter_arrays", "python_source", "state"),
    "machine entries": ("drivers", "llvm_machine", "llvm_series", "model", "numpy_machine"),
    "trajectory records": ("dense_output", "integrator", "trajectory"),
    "trajectory runs": ("ending_messages", "endings", "outputs", "plan", "run_loop", "sizes", "slow_runs"),
    "trajectory segments": ("segments",),
    "trajectory entries": ("run", "solution"),
}
"""The modules beside the rooms: what every room reads, what runs a plan, and what is called from outside. The records
stand before all rooms of their stage, the entries behind all."""

ARROWS = """
machine records:
machine/llvm: machine records
machine/kernel: machine records, machine/llvm
machine entries: machine records, machine/llvm, machine/kernel
trajectory/tableaux:
trajectory records: machine records, machine entries, trajectory/tableaux
trajectory/constraints: machine records, machine/kernel, machine entries
trajectory/events: machine records, machine/kernel, machine entries, trajectory/constraints, trajectory records
trajectory runs: machine records, machine/kernel, machine entries, trajectory/constraints, trajectory records, \
trajectory/tableaux, trajectory/events
trajectory/methods: machine records, machine entries, trajectory records, trajectory/tableaux, trajectory/events, \
trajectory runs
trajectory/foreign: machine records, machine entries, trajectory records, trajectory/events, trajectory runs, \
trajectory/methods
trajectory/measures: machine records, machine entries, trajectory/constraints, trajectory records, \
trajectory/tableaux, trajectory runs
trajectory segments: trajectory/constraints, trajectory/measures, trajectory records, trajectory/events, trajectory runs
trajectory/contact: machine records, machine/kernel, machine entries, trajectory records, trajectory runs, \
trajectory segments
trajectory entries: machine records, machine entries, trajectory/constraints, trajectory records, trajectory runs, \
trajectory/methods, trajectory/measures, trajectory segments, trajectory/contact
"""
MAY_IMPORT: Mapping[str, Sequence[str]] = {
    name: [room.strip() for room in rooms.split(",") if room.strip()]
    for name, _, rooms in (line.partition(":") for line in ARROWS.strip().splitlines())
}
"""Each room, in the order in which it is built, and the rooms that it knows. What a trajectory knows of the machine's
inner rooms are the constants that all drivers agree on, and the arithmetic of doubles."""


def room(module: str) -> str | None:
    """Return the room of a module, None outside machine/ and trajectory/."""
    _, *parts = module.split(".")
    if len(parts) < 2 or parts[0] not in ("machine", "trajectory"):
        return None
    stage, name = parts[:2]
    if f"{stage}/{name}" in MAY_IMPORT:
        return f"{stage}/{name}"
    return next(
        (group for group, names in PLAIN.items() if group.split()[0] == stage and name in names), f"{stage}/{name}?"
    )


def arrows_between_rooms(modules: Modules) -> dict[tuple[str, str], str]:
    """Return the imports between rooms, each with one example."""
    result: dict[tuple[str, str], str] = {}
    for name, tree in modules.items():
        for target, line in imports_of(tree, modules):
            here, there = room(name), room(target)
            if here and there and here != there:
                result.setdefault((here, there), f"{name}:{line} imports {target}")
    return result


def strange(modules: Modules) -> list[str]:
    """Return imports between rooms that are not in the table."""
    return [
        text for (here, there), text in arrows_between_rooms(modules).items() if there not in MAY_IMPORT.get(here, ())
    ]


def test_only_the_arrows_of_the_table() -> None:
    assert strange(package()) == []


def test_every_arrow_of_the_table_is_needed() -> None:
    drawn = {(here, there) for here, rooms in MAY_IMPORT.items() for there in rooms}
    assert drawn - set(arrows_between_rooms(package())) == set()


def test_the_table_has_every_room_in_order_and_no_ring() -> None:
    result = {room(name) for name in package()} - {None}
    assert result == set(MAY_IMPORT)
    TopologicalSorter(MAY_IMPORT).prepare()
    rooms = list(MAY_IMPORT)
    assert [rooms.index(there) < k for k, here in enumerate(rooms) for there in MAY_IMPORT[here]].count(False) == 0


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
    assert [name for name in sorted(folders - {"mutants"}) if f"`tests/{name}" not in page] == []
