"""The order of the site: the pages under each heading. Sphinx refuses a page that is not listed."""

from __future__ import annotations

from pathlib import Path

SECTIONS = {
    "Start": ("tour", "tutorials/index", "gallery/index"),
    "How to": (
        "Teaching and homework <howto/teaching>",
        "Pictures, animations, web pages, notebooks <seeing>",
        "Many runs <howto/ensembles>",
        "States of first order <howto/first-order>",
        "Research <howto/research>",
    ),
    "Subjects": (
        "mechanics",
        "dynamics",
        "constraints",
        "contact",
        "rotations",
        "events",
        "choosing-an-integrator",
        "scenes",
        "tutorial-methods",
    ),
    "Hand on": ("other-solvers", "export/README"),
    "Look up": ("reference", "api/index", "commands", "errors", "limits"),
    "Behind it": (
        "dev/theory",
        "dev/extending",
        "dev/procedures",
        "dev/evidence",
        "dev/glossary",
        "benchmarks/README",
        "changes",
    ),
}
"""Pages of the sidebar by heading."""

PAGES_WITH_PICTURES = ("tour", "dynamics", "howto/teaching", "howto/ensembles", "howto/research")
"""Pages whose code saves pictures, which are shown after the code."""

FOLDERS = ("benchmarks", "export")
"""Folders whose README leads to all pages beside it."""


def toctree(entries: tuple[str, ...], caption: str = "") -> str:
    """Return a directive that puts pages into the navigation and shows nothing itself."""
    options = f":caption: {caption}\n" if caption else ""
    return f"\n```{{toctree}}\n:hidden:\n{options}\n" + "\n".join(entries) + "\n```\n"


def added(name: str, source: Path) -> str:
    """Return the navigation directives that are appended to a page of docs/."""
    if name == "index.md":
        return "".join(toctree(entries, caption) for caption, entries in SECTIONS.items())
    for folder in FOLDERS:
        if name == f"{folder}/README.md":
            return toctree(tuple(sorted(path.stem for path in source.glob("*.md") if path.name != "README.md")))
    return ""
