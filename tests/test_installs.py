"""Every `pip install` in code and pages installs this package or one of its dependencies."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import lagrange as lg

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[([\w, -]+)\])?")
COMMAND = re.compile(r"\bpip3? install((?:[ \t]+(?:'[^']*'|\"[^\"]*\"|[^\s`'\",:;()&|#]+))*)")
ARGUMENT = re.compile(r"'[^']*'|\"[^\"]*\"|\S+")
OPTIONS = {"-q", "-e"}
ELSEWHERE = "NAME"
"""What stands in the place of a part of an f-string, which is not known before the code runs."""


def named(requirement: str) -> tuple[str, list[str]]:
    """Return the distribution and the extras of a requirement."""
    match = REQUIREMENT.match(requirement)
    assert match, requirement
    return match.group(1), [part.strip() for part in (match.group(2) or "").split(",") if part.strip()]


def known() -> set[str]:
    every = [*PROJECT["dependencies"], *(item for extra in EXTRAS.values() for item in extra)]
    return {named(item)[0] for item in every} - {PROJECT["name"]}


def texts() -> Iterator[tuple[Path, str]]:
    """Yield the texts of pages and settings, and the strings of Python files."""
    folders = ("lagrange", "docs", "examples", "tests", ".ci")
    files = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "pyproject.toml"]
    files += [path for folder in folders for path in sorted((ROOT / folder).rglob("*")) if path.is_file()]
    for path in files:
        if path == Path(__file__).resolve() or path.suffix not in (".md", ".toml", ".py", ".sh", ".c", ""):
            continue
        text = path.read_text("utf-8")
        if "install" not in text:
            continue
        if path.suffix == ".py":
            yield from ((path, item) for item in written(ast.parse(text)))
            yield from ((path, line) for line in re.findall(r"#(.*)", text))
        else:
            yield path, text


def written(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else ELSEWHERE for part in node.values]
            yield "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def advised(text: str) -> Iterator[str]:
    """Yield the requirements of all install commands in a text."""
    for match in COMMAND.finditer(text):
        for argument in ARGUMENT.findall(match.group(1)):
            plain = argument.strip("'\"")
            if plain not in OPTIONS:
                yield plain if plain == "." else plain.rstrip(".")


def wrong(requirement: str) -> str:
    """Return the reason why a requirement is wrong, or an empty text."""
    if requirement.startswith("."):
        extras = re.fullmatch(r"\.(?:\[([\w,-]+)\])?", requirement)
        if extras is None:
            return "no checkout"
        missing = [item for item in (extras.group(1) or "").split(",") if item and item not in EXTRAS]
        return f"no extra {missing}" if missing else ""
    return "" if requirement in known() else "not known to pyproject.toml"


def test_what_is_advised_is_known() -> None:
    result = [(path.relative_to(ROOT).as_posix(), item) for path, text in texts() for item in advised(text)]
    assert [(path, item, wrong(item)) for path, item in result if wrong(item)] == []
    for path in ("README.md", "docs/limits.md", "docs/choosing-an-integrator.md", "lagrange/show/files/run_files.py"):
        assert path in [place for place, _ in result], f"{path} advises nothing: is it still read?"


def test_strangers_are_seen() -> None:
    """A test of the reader of commands, with requirements that it must refuse or accept."""
    for text, bad in {
        "do: pip install 'lagrange[sundials]', or take": ["lagrange[sundials]"],
        "`pip install lagrange`": ["lagrange"],
        "pip install '.[sundial]'": [".[sundial]"],
        f"pip install {ELSEWHERE}, or": [ELSEWHERE],
        "pip install -q pandas heyokaa.": ["heyokaa"],
        ".venv/bin/pip install -q -e '.[test,data]' && x": [],
        "pip install .        # in a checkout": [],
        "pip install scikit-sundae, or take": [],
    }.items():
        assert [item for item in advised(text) if wrong(item)] == bad, text


def test_extras_refer_to_this_distribution_by_its_name() -> None:
    assert PROJECT["name"] == "lagrange-mechanics", "`lagrange` on the package index is another project"
    for extra, requirements in EXTRAS.items():
        for name, extras in map(named, requirements):
            assert name != "lagrange", extra
            assert name != PROJECT["name"] or set(extras) <= set(EXTRAS), (extra, name)


def test_nothing_asks_for_the_version_of_another_project() -> None:
    asked = re.compile(r"(?:metadata\.)?(?:version|distribution|files|requires)\(\s*[\"']lagrange[\"']")
    files = [path for folder in ("lagrange", "docs", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]
    assert [path.name for path in files if asked.search(path.read_text("utf-8"))] == []
    assert PROJECT["version"] == lg.__version__


def test_the_command_and_the_import_keep_their_name() -> None:
    assert PROJECT["scripts"] == {"lagrange": "lagrange.__main__:main"}


def test_readme_and_limits_tell_of_the_other_project() -> None:
    for page in ("README.md", "docs/limits.md"):
        text = " ".join((ROOT / page).read_text("utf-8").split())
        assert "`lagrange-mechanics`" in text and "package index" in text and "another" in text, page
