"""The check of the built site sees what a page fetches from elsewhere, and links that lead nowhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

Module = Callable[[str], ModuleType]

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
