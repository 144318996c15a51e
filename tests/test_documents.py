"""The documentation works: its Python runs, its links are valid, and the files that it names exist."""

import ast
import re
import runpy
import shlex
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.cli import program as cli
from lagrange.trajectory.methods import registry
from tests.test_house import ANY, strings

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
ADDRESS = re.compile(r"https?://[a-z0-9.-]+\.[a-z]{2,}(/\S*)?")
NAMED = re.compile(r"`((?:lagrange|tests|examples|docs)/[\w./-]+)`")


RECIPES = ("casadi", "cffi", "jax", "numba")
OPTIONAL = (*RECIPES, "fmpy")
"""Packages that a page may import and that need not be installed; each of the first has a block of its own."""


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of a page in a language."""
    return [body for kind, body in FENCE.findall(page.read_text("utf-8")) if kind == language]


def snippets() -> list[tuple[str, str]]:
    """Return the Python of all pages: each block that imports the package, with the blocks that continue it."""
    result: list[tuple[str, str]] = []
    for page in PAGES:
        name = page.relative_to(ROOT).as_posix()
        for body in blocks(page, "python"):
            if re.search(r"^(import|from) lagrange", body, re.MULTILINE) or not result or result[-1][0] != name:
                result.append((name, body))
            else:
                result[-1] = name, f"{result[-1][1]}\n{body}"
    return result


def anchors(page: Path) -> list[str]:
    """Return the anchors of a page's headings, on the site and on a code host."""
    titles = HEADING.findall(re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL))
    return [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]


def nowhere(page: Path, text: str) -> list[str]:
    """Return the broken links of a page. Web addresses are only checked for their form."""
    wrong = []
    for target in LINK.findall(CODE.sub("", text)):
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        if "://" in target:
            good = bool(ADDRESS.fullmatch(target))
        else:
            good = there.exists() and (not anchor or (there.suffix == ".md" and anchor in anchors(there)))
        wrong += [] if good else [target]
    return wrong


def missing(body: str) -> list[str]:
    """Return the packages of extras that a block imports and that are not installed."""
    taken = [name for node in ast.walk(ast.parse(body)) if isinstance(node, ast.Import) for name in node.names]
    return [name.name for name in taken if name.name in OPTIONAL and find_spec(name.name) is None]


def test_a_block_whose_package_is_missing_is_skipped_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.find_spec", lambda name: None)
    assert missing("import jax\nimport numpy as np\nimport lagrange as lg\n") == ["jax"]


def test_every_recipe_has_a_block_that_runs() -> None:
    bodies = [body for page, body in snippets() if page == "docs/other-solvers.md"]
    imports = "".join(bodies)
    assert [
        name for name in (*RECIPES, "ctypes", "scipy", "sympy") if not re.search(rf"(import|from) {name}\b", imports)
    ] == []
    assert len(bodies) == 9  # NumPy with SciPy, inputs, control, Numba, JAX, CasADi, SymPy, ctypes, cffi


def test_the_reference_has_the_public_names_and_no_others() -> None:
    page = (ROOT / "docs" / "reference.md").read_text("utf-8")
    assert set(lg.__all__) - set(re.findall(r"`(?:lg\.)?(\w+)", page)) == {"__version__"}
    tables, solutions = page.split("## Solutions")
    named = [name for row in re.findall(r"^\| (`.*?) \|", tables, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)]
    assert [name for name in named if not (hasattr(lg, name) or hasattr(lg.System, name))] == []
    rows = re.findall(r"^\| (`\..*?) \|", solutions, re.MULTILINE)
    assert [name for row in rows for name in re.findall(r"`\.(\w+)", row) if not hasattr(lg.Solution, name)] == []


def test_the_readme_has_a_first_result_in_six_lines() -> None:
    first = next(body for page, body in snippets() if page == "README.md")
    assert len([line for line in first.splitlines() if line.strip()]) <= 6


PROGRAMS = [
    pytest.param(body, id=page, marks=[pytest.mark.slow] * (k > 0)) for k, (page, body) in enumerate(snippets())
]
"""The Python of all pages, of which a default run takes the readme's first."""


@pytest.mark.parametrize("body", PROGRAMS)
def test_the_python_on_the_page_runs(body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if lacking := missing(body):
        pytest.skip(f"not installed: {', '.join(lacking)}")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model").mkdir()  # where pages export to; a path without a folder stays cached as missing
    monkeypatch.syspath_prepend(tmp_path / "model")
    monkeypatch.setattr(registry, "_registered", {})  # what a page registers is not there for the next
    script = tmp_path / "snippet.py"
    script.write_text(body, encoding="utf-8")
    runpy.run_path(str(script))


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page: Path) -> None:
    assert nowhere(page, page.read_text("utf-8")) == []


def test_a_link_that_leads_nowhere_is_seen() -> None:
    page = ROOT / "docs" / "tour.md"
    good = "[a](dev/theory.md) [b](dev/theory.md#2-the-laws) [c](#read) [d](https://www.sympy.org/en/)"
    bad = ["no.md", "dev/theory.md#no", "#no", "https://nothing", "http:/www.sympy.org"]
    assert nowhere(page, good + "`[e](no.md)`") == []
    assert nowhere(page, good + " ".join(f"[x]({target})" for target in bad)) == bad


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_files_and_commands_on_the_page_are_read(page: Path, tmp_path: Path) -> None:
    for body in blocks(page, "toml"):
        if "kinetic" in tomllib.loads(body):
            scene = tmp_path / "scene.toml"
            scene.write_text(body, encoding="utf-8")
            assert lg.System.from_scene(scene).coordinates
    lines = [line.strip() for body in blocks(page, "sh") for line in body.splitlines()]
    for line in lines:
        if line.startswith("lagrange ") and "$" not in line:
            words = shlex.split(line.partition(" > ")[0].partition(" && ")[0], comments=True)
            assert callable(cli.parser().parse_args(words[1:]).command)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_file_that_is_named_exists(page: Path) -> None:
    assert [name for name in NAMED.findall(page.read_text("utf-8")) if not (ROOT / name).exists()] == []


def test_the_numbers_in_the_readme_are_those_of_the_benchmarks() -> None:
    rows = [line for line in (ROOT / "README.md").read_text("utf-8").splitlines() if "](docs/benchmarks/" in line[:200]]
    compared = [row.split("|")[2:4] for row in rows if row.startswith("| ")]
    assert len(compared) >= 6
    for ours, others in compared:
        (page,) = LINK.findall(others)
        measured = set(re.findall(r"[\d.]+(?:e-\d+)?", (ROOT / page).read_text("utf-8")))
        said = re.findall(
            r"\d[\d.]*(?:e-\d+)?(?= |,|$)", f"{ours.strip()} {others.partition('; [')[0]}".replace(":", "")
        )
        assert set(said) - measured == set(), page


@pytest.mark.parametrize("words", ["-m pytest", "lagrange run"])
def test_the_readme_has_each_command_once(words: str) -> None:
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len([line for line in lines if line.startswith("python3 -m venv ") and words in line]) == 1


def test_the_readme_names_all_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    offered = re.findall(r"^    ([a-z]+)  ", capsys.readouterr().out, re.MULTILINE)
    sentence = next(part for part in (ROOT / "README.md").read_text("utf-8").split("\n\n") if "other commands" in part)
    assert sorted(offered) == sorted(["run", *re.findall(r"`(?:lagrange )?([a-z]+)`", sentence)])


# --- installation ---------------------------------------------------------------------------------------------
# Every `pip install` in code and pages installs this package or one of its dependencies.


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[([\w, -]+)\])?")
COMMAND = re.compile(r"\bpip3? install((?:[ \t]+(?:'[^']*'|\"[^\"]*\"|[^\s`'\",:;()&|#]+))*)")
ARGUMENT = re.compile(r"'[^']*'|\"[^\"]*\"|\S+")
OPTIONS = {"-q", "-e"}


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
            yield from ((path, item) for item in strings(ast.parse(text)))
            yield from ((path, line) for line in re.findall(r"#(.*)", text))
        else:
            yield path, text


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
        f"pip install {ANY}, or": [ANY],
        "pip install -q pandas heyokaa.": ["heyokaa"],
        ".venv/bin/pip install -q -e '.[test,data]' && x": [],
        "pip install .        # in a checkout": [],
        "pip install scikit-sundae, or take": [],
    }.items():
        assert [item for item in advised(text) if wrong(item)] == bad, text


def test_extras_refer_to_this_distribution_by_its_name() -> None:
    assert PROJECT["name"] == "lagrange-mechanics", "`lagrange` on the package index is another project"
    assert PROJECT["scripts"] == {"lagrange": "lagrange.__main__:main"}
    for extra, requirements in EXTRAS.items():
        for name, extras in map(named, requirements):
            assert name != "lagrange", extra
            assert name != PROJECT["name"] or set(extras) <= set(EXTRAS), (extra, name)


def test_nothing_asks_for_the_version_of_another_project() -> None:
    asked = re.compile(r"(?:metadata\.)?(?:version|distribution|files|requires)\(\s*[\"']lagrange[\"']")
    files = [path for folder in ("lagrange", "docs", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]
    assert [path.name for path in files if asked.search(path.read_text("utf-8"))] == []
    assert PROJECT["version"] == lg.__version__


def test_readme_and_limits_tell_of_the_other_project() -> None:
    for page in ("README.md", "docs/limits.md"):
        text = " ".join((ROOT / page).read_text("utf-8").split())
        assert "`lagrange-mechanics`" in text and "package index" in text and "another" in text, page
