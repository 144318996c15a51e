"""The imports between the rooms of machine/ and trajectory/: only those in a table, and none backwards."""

from __future__ import annotations

import re
from collections.abc import Mapping
from graphlib import TopologicalSorter

from tests.test_layering import ROOT, Modules, imports_of, package

PLAIN: Mapping[str, tuple[str, ...]] = {
    "machine records": ("backend", "parameters", "python_source", "state"),
    "machine entries": ("drivers", "llvm_machine", "llvm_series", "model", "numpy_machine"),
    "trajectory records": ("integrator", "paths", "trajectory"),
    "trajectory runs": ("ending_messages", "endings", "outputs", "plan", "run_loop", "sizes", "slow_runs"),
    "trajectory segments": ("segments",),
    "trajectory entries": ("run", "solution"),
}
"""The modules beside the rooms: what every room reads, what runs a plan, and what is called from outside. The records
stand before all rooms of their stage, the entries behind all."""

MAY_IMPORT: Mapping[str, tuple[str, ...]] = {
    "machine records": (),
    "machine/llvm": ("machine records",),
    "machine/kernel": ("machine records", "machine/llvm"),
    "machine entries": ("machine records", "machine/llvm", "machine/kernel"),
    "trajectory/tableaux": (),
    "trajectory records": ("machine records", "machine entries", "trajectory/tableaux"),
    "trajectory/constraints": ("machine records", "machine/kernel", "machine entries"),
    "trajectory/events": (
        *("machine records", "machine/kernel", "machine entries", "trajectory/constraints"),
        "trajectory records",
    ),
    "trajectory runs": (
        *("machine records", "machine/kernel", "machine entries", "trajectory/constraints"),
        *("trajectory records", "trajectory/tableaux", "trajectory/events"),
    ),
    "trajectory/methods": (
        *("machine records", "machine entries"),
        *("trajectory records", "trajectory/tableaux", "trajectory/events", "trajectory runs"),
    ),
    "trajectory/foreign": (
        *("machine records", "machine entries"),
        *("trajectory records", "trajectory/events", "trajectory runs", "trajectory/methods"),
    ),
    "trajectory/measures": (
        *("machine records", "machine entries", "trajectory/constraints"),
        *("trajectory records", "trajectory/tableaux", "trajectory runs"),
    ),
    "trajectory segments": (
        *("trajectory/constraints", "trajectory/measures"),
        *("trajectory records", "trajectory/events", "trajectory runs"),
    ),
    "trajectory/contact": (
        *("machine records", "machine/kernel", "machine entries"),
        *("trajectory records", "trajectory runs", "trajectory segments"),
    ),
    "trajectory entries": (
        *("machine records", "machine entries", "trajectory/constraints"),
        *("trajectory records", "trajectory runs"),
        *("trajectory/methods", "trajectory/measures", "trajectory segments", "trajectory/contact"),
    ),
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


def arrows(modules: Modules) -> dict[tuple[str, str], str]:
    """Return the imports between rooms, each with one example."""
    result: dict[tuple[str, str], str] = {}
    for name, tree in modules.items():
        for target, line in imports_of(tree, modules):
            here, there = room(name), room(target)
            if here and there and here != there:
                result.setdefault((here, there), f"{name}:{line} imports {target}")
    return result


def strange(modules: Modules) -> list[str]:
    """Return imports that are not in the table."""
    return [text for (here, there), text in arrows(modules).items() if there not in MAY_IMPORT.get(here, ())]


def test_only_the_arrows_of_the_table() -> None:
    assert strange(package()) == []


def test_every_arrow_of_the_table_is_needed() -> None:
    drawn = {(here, there) for here, rooms in MAY_IMPORT.items() for there in rooms}
    assert drawn - set(arrows(package())) == set()


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
