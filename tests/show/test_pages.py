"""Whole derivation pages: stored ones, and the structure of the LaTeX and HTML of all scenes."""

from __future__ import annotations

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from matplotlib.mathtext import MathTextParser

from lagrange.show.notation.text import GREEK
from tests.models import SCENE_NAMES, shared_scene

PAGES = Path(__file__).parent / "pages"
GOLDEN = {
    "double-pendulum.tex": ("double-pendulum", "latex"),
    "spherical-pendulum.txt": ("spherical-pendulum", "unicode"),
    "cartesian-pendulum.md": ("cartesian-pendulum", "markdown"),
    "ladder.txt": ("ladder", "text"),
}
COMMANDS = GREEK | frozenset(
    [
        *("pi", "dot", "ddot", "frac", "sqrt", "left", "right", "bigl", "bigr", "quad", "qquad", "times", "sin"),
        *("cos", "ln", "partial", "begin", "end", "section", "mathrm", "mathcal", "text"),
    ]
)
"""Commands that LaTeX and its package amsmath have; the preamble aside, a page has no other."""
QUICK = ("bead-on-hoop", "double-pendulum", "kepler", "ladder", "thrown-ball")
SCENES = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in SCENE_NAMES]


@pytest.mark.parametrize("file", GOLDEN)
def test_golden_pages(file: str) -> None:
    name, style = GOLDEN[file]
    assert getattr(shared_scene(name).derivation(), style)() == (PAGES / file).read_text("utf-8")


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SCENES)
def test_latex_is_well_formed(name: str) -> None:
    page = shared_scene(name).derivation().latex()
    body = page[page.index("\\maketitle\n") + 10 : page.index("\\end{document}")]
    plain = re.sub(r"\\[{}$&#_%\\]", "", body)
    for begin, end in (("{", "}"), (r"\left", r"\right"), (r"\[", r"\]"), (r"\begin", r"\end"), (r"\bigl", r"\bigr")):
        assert plain.count(begin) == plain.count(end), begin
    assert set(re.findall(r"\\([A-Za-z]+)", plain)) - {"par"} <= COMMANDS
    script = r"(?:\{(?:[^{}]|\{[^{}]*\})*\}|\\[A-Za-z]+|\w)"
    assert not re.search(rf"\^{script}\s*\^|_{script}\s*_", body), "a double index or exponent"
    parser = MathTextParser("path")
    for formula in re.findall(r"\\\[ (.*) \\\]", body):
        if "begin{" not in formula:
            parser.parse("$" + re.sub(r"\\big[lr]", "", formula) + "$")


@pytest.mark.few(1)
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
@pytest.mark.parametrize("name", ["double-pendulum", "cartesian-pendulum", "bead-on-wire", "slider-crank"])
def test_pdflatex_sets_the_page(name: str, tmp_path: Path) -> None:
    (tmp_path / "page.tex").write_text(shared_scene(name).derivation().latex(), "utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Overfull" not in done.stdout


@pytest.mark.few
@pytest.mark.parametrize("name", SCENES)
def test_html_is_well_formed(name: str) -> None:
    page = shared_scene(name).derivation().html()
    ElementTree.fromstring(
        page.removeprefix("<!doctype html>\n").replace('<meta charset="utf-8">', "").replace(" open>", ">")
    )
    assert not re.search(r"<script|href=|src=", page)


def test_names_of_functions_have_thin_spaces_in_mathml() -> None:
    page = shared_scene("spherical-pendulum").derivation().html()
    space, theta = '<mspace width="0.17em"/>', "<mi>θ</mi>"
    assert f"<mi>l</mi>{space}<mrow><mi>sin</mi><mo>\N{FUNCTION APPLICATION}</mo>{space}{theta}</mrow>" in page
    assert f"{space}<mrow><msup><mi>sin</mi><mn>2</mn></msup>" in page
    assert f"(</mo>{space}" not in page
