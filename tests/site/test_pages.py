"""The pages that are made for the documentation site: every public name has a place, every link its target there."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import lagrange as lg

Module = Callable[[str], ModuleType]
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Module:
    """Import one of the site's modules by its name."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    return import_module


def test_every_public_name_has_a_place_in_the_reference(module: Module) -> None:
    api = module("api")
    assert api.unlisted_names() == []
    assert set(api.CLASSES) <= set(api.listed_names())


def test_a_name_without_a_place_is_an_error(module: Module, monkeypatch: pytest.MonkeyPatch) -> None:
    api = module("api")
    monkeypatch.setattr(api, "ERRORS", ())
    with pytest.raises(ValueError, match=r"not listed in docs/site/api.py: LagrangeError, RunError"):
        api.pages()


def test_docstrings_keep_their_marks_and_get_links(module: Module) -> None:
    pytest.importorskip("sphinx")
    marked = module("docstrings").marked
    links = {"System.conserved": "lagrange.System.conserved"}
    assert marked("m*l**2 of as_... is `theta_dot`; see `System.conserved`s.", links) == (
        r"m\*l\*\*2 of as\_... is ``theta_dot``\ ; see "
        r":py:obj:`System.conserved <lagrange.System.conserved>`\ s."
    )
    lines = module("docstrings").lines_of(["One line.", "", "    x = 1", "    y = 2"], {})
    assert lines == ["One line.", "", "::", "", "    x = 1", "    y = 2", ""]


def test_links_are_those_of_the_site(module: Module) -> None:
    stage = module("stage")
    page, text = (
        ROOT / "docs" / "howto" / "teaching.md",
        "[a](../../examples/) [b](../benchmarks/#x) [c](https://a.org/b)",
    )
    assert stage.with_links(page, text) == (
        "[a](../tutorials/index.md) [b](../benchmarks/README.md#x) [c](https://a.org/b)"
    )
    changes = stage.with_links(ROOT / "CHANGELOG.md", "[a](docs/limits.md)\n```\n[b](docs/limits.md)\n```\n")
    assert changes == "[a](limits.md)\n```\n[b](docs/limits.md)\n```\n"
    notebook = stage.with_links(ROOT / "examples" / "01-first-steps.ipynb", "[a](../docs/dev/theory.md) [b](x.ipynb)")
    assert notebook == "[a](../dev/theory.md) [b](x.ipynb)"
    with pytest.raises(ValueError, match=r"pyproject.toml is not on the site"):
        stage.with_links(page, "[a](../../pyproject.toml)")


def test_every_page_of_the_documentation_has_a_place(module: Module) -> None:
    navigation = module("navigation")
    entries = [entry for entries in navigation.SECTIONS.values() for entry in entries]
    named = {re.sub(r".*<(.*)>", r"\1", entry) for entry in entries}
    pages = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    beside = {name for name in pages if name.split("/")[0] in navigation.FOLDERS and not name.endswith("/README")}
    made = {name for name in named if name.endswith(("/index", "commands", "changes"))}
    assert pages - beside - {"index"} == named - made


def test_pictures_that_code_saves_stand_behind_it(module: Module) -> None:
    shown = module("shown")
    page = '```python\nimport lagrange\n```\n```python\na.savefig("b.png"); c.to_png("d.png")\n```\nEnd.\n'
    assert shown.with_pictures("howto/x", page) == page.replace(
        "```\nEnd.", "```\n\n![b](x-b.png)\n\n![d](x-d.png)\nEnd."
    )
    assert [len(blocks) for blocks in shown.groups(page)] == [2]
    for name in module("navigation").PAGES_WITH_PICTURES:
        assert shown.SAVED.search((ROOT / "docs" / f"{name}.md").read_text("utf-8")), name


# --- The check of the built site sees what a page fetches from elsewhere, and links that lead nowhere ---


GOOD = """\
<style>.a { background: url(data:image/png;base64,AA) }</style>
<script src="here.js?v=1"></script><img src="here.js" srcset="here.js"><h2 id="top">Top</h2>
<a href="#top">a</a><a href="sub/">b</a><a href="sub/index.html#in%20side">c</a><a href="https://www.sympy.org/en/">d</a>
"""

BAD = {
    '<script src="https://cdn.example.org/a.js"></script>': "page.html fetches https://cdn.example.org/a.js",
    '<link rel="stylesheet" href="//example.org/a.css">': "page.html fetches //example.org/a.css",
    "<style>@import 'http://example.org/a.css';</style>": "page.html fetches http://example.org/a.css",
    '<p style="background: url(http://example.org/a.png)">': "page.html fetches http://example.org/a.png",
    '<img src="gone.png">': "page.html fetches gone.png, which is not there",
    '<a href="gone.html">a</a>': "page.html links to gone.html: there is no such file",
    '<a href="#gone">a</a>': "page.html links to #gone: there is no such anchor",
    '<a href="sub/index.html#gone">a</a>': "page.html links to sub/index.html#gone: there is no such anchor",
    '<a href="https://nothing">a</a>': "page.html links to https://nothing: this is not an address",
    '<a href="javascript:alert(1)">a</a>': "page.html links to javascript:alert(1): this is not an address",
}


def test_pages_that_need_nothing_from_elsewhere_pass_and_others_are_named(module: Module, tmp_path: Path) -> None:
    links = module("links")
    (tmp_path / "sub").mkdir()
    (tmp_path / "here.js").write_text("")
    (tmp_path / "sub" / "index.html").write_text('<p id="in side">')
    (tmp_path / "page.html").write_text(GOOD)
    assert list(links.faults(tmp_path)) == []
    for text, fault in BAD.items():
        links.parsed.cache_clear()
        (tmp_path / "page.html").write_text(GOOD + text)
        assert list(links.faults(tmp_path)) == [fault]


def test_a_style_sheet_that_fetches_a_font_is_named(module: Module, tmp_path: Path) -> None:
    (tmp_path / "a.css").write_text("@font-face { src: url('https://fonts.example.org/a.woff2') }")
    assert list(module("links").faults(tmp_path)) == ["a.css fetches https://fonts.example.org/a.woff2"]


# --- Formulas of the documentation site become MathML at build time, and one that cannot is an error ---


pytest.importorskip("sphinx")
pytest.importorskip("latex2mathml")


def test_equations_in_lines_are_a_table(module: Module) -> None:
    made = module("mathml").mathml(r"\begin{aligned} a &= b \\ &\quad {} + c \end{aligned}", "block")
    assert made.startswith("<math") and made.count("<mtr>") == 2 and "columnalign" not in made


def test_functions_have_thin_spaces_and_none_before_a_bracket(module: Module) -> None:
    made = module("mathml").mathml(r"l \sin\theta + \cos(\phi) + \tan^2(\phi)", "inline")
    spaces = re.findall(r'rspace="([^"]*)">(\w+)<', made)
    assert spaces == [("0.17em", "sin"), ("0", "cos"), ("0", "tan")]


@pytest.mark.parametrize("latex", [r"a + \unheardof{b}", r"\begin{nonsense} a \end{nonsense}"])
def test_a_formula_with_an_unknown_command_is_refused(module: Module, latex: str) -> None:
    mathml = module("mathml")
    with pytest.raises(mathml.ExtensionError, match="which the converter to MathML does not know"):
        mathml.mathml(latex, "block")


def test_brackets_about_a_line_do_not_stretch_and_those_about_a_fraction_do(module: Module) -> None:
    made = module("mathml").mathml(r"\theta{\left(t \right)} + \left(\frac{a}{b}\right)", "inline")
    assert re.findall(r'stretchy="(\w+)"[^>]*>[()]<', made) == ["false", "false", "true", "true"]


# --- The pictures of the gallery move as the run does, by themselves, and are small ---


SVG = "{http://www.w3.org/2000/svg}"


def places(circle: ET.Element) -> np.ndarray:
    """Return where a disc is at each time, (2, N)."""
    rows = {item.get("attributeName"): item.get("values", "") for item in circle.findall(f"{SVG}animate")}
    return np.array([[float(value) for value in rows[name].split(";")] for name in ("cx", "cy")])


def test_a_rod_keeps_its_length_and_the_bobs_are_where_the_run_has_them(module: Module) -> None:
    moving = module("moving")
    solution = lg.scene("double-pendulum").run(6.0, {"theta1": 2.0, "theta2": 2.5})
    text = moving.svg(solution)
    assert len(text) < 100_000
    root = ET.fromstring(text)
    discs = [circle for circle in root.iter(f"{SVG}circle") if "moving" in circle.get("class", "")]
    upper, lower = map(places, discs)
    rod = np.hypot(*(lower - upper))
    assert np.ptp(rod) < 0.3  # places are rounded to a tenth of a unit
    times = np.linspace(0.0, 6.0, upper.shape[1])
    theta = solution.at(times)
    expected = np.mean(rod) * np.array([np.sin(theta[1]), np.cos(theta[1])])  # the second axis points down
    assert np.abs((lower - upper) - expected).max() < 0.3
    assert [element.tag for element in root.iter() if element.tag.endswith("script")] == []


def test_a_spring_is_stretched_and_a_point_at_rest_does_not_move(module: Module) -> None:
    text = module("moving").svg(lg.scene("chain-of-springs").run())
    assert len(text) < 250_000
    kinds = [item.get("type") for item in ET.fromstring(text).iter(f"{SVG}animateTransform")]
    assert kinds.count("scale") == kinds.count("rotate") == 6
    assert text.count('class="base"') == 2


def test_a_system_without_positions_is_refused(module: Module) -> None:
    x = lg.coordinate("x")
    bare = lg.System(lg.kinetic_energy(1, x), 0, initial={x.dot: 1}, name="bare")
    with pytest.raises(ValueError, match="bare has no positions to draw"):
        module("moving").svg(bare.run(1.0))
