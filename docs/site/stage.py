"""The source of the site: the pages of docs/, with links to files outside docs/ changed to their copies."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from navigation import FOLDERS, added

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DOCS = ROOT / "docs"
LINK = re.compile(r"(\]\()([^)\s#:]+)(#[^)\s]*)?(\))")
OUTSIDE = {"CHANGELOG.md": "changes.md", "README.md": "index.md", "examples": "tutorials/index.md"}
"""Names on the site of pages outside docs/."""
COPIED = ("howto", "dev", *FOLDERS)
MADE = ("commands.md",)


def write_changed(path: Path, text: str) -> None:
    """Write a file if its text has changed, because Sphinx reads newer files again."""
    if not path.exists() or path.read_text("utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")


def place_on_site(path: Path) -> str:
    """Return the path on the site of a file or folder of the tree. Raises ValueError if it is not on the site."""
    inside = path.relative_to(ROOT)
    if inside.as_posix() in OUTSIDE:
        return OUTSIDE[inside.as_posix()]
    if inside.parts[0] == "docs":
        return (inside.relative_to("docs") / ("README.md" if path.is_dir() else "")).as_posix()
    if inside.parts[0] == "examples":
        return f"tutorials/{inside.name if inside.suffix == '.ipynb' else 'scripts.md'}"
    raise ValueError(f"{inside} is not on the site")


def target_on_site(page: Path, target: str) -> str:
    """Return the target on the site of a link in a page."""
    if not target:
        return target
    start = Path(place_on_site(page)).parent
    return Path(os.path.relpath(place_on_site((page.parent / target).resolve()), start)).as_posix()


def with_links(page: Path, text: str) -> str:
    """Return the text of a page with its links changed to those of the site. Code is not changed."""

    def changed(link: re.Match[str]) -> str:
        return f"{link[1]}{target_on_site(page, link[2])}{link[3] or ''}{link[4]}"

    blocks = re.split(r"(^```.*?^```$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(block if k % 2 else LINK.sub(changed, block) for k, block in enumerate(blocks))


def stage(source: Path) -> None:
    """Copy the pages and pictures of docs/ and the list of changes, and remove pages that no longer exist."""
    staged = {source / "changes.md"}
    for path in sorted(DOCS.rglob("*")):
        target = source / path.relative_to(DOCS)
        if path.suffix == ".md":
            name = path.relative_to(DOCS).as_posix()
            write_changed(target, with_links(path, path.read_text("utf-8")) + added(name, path.parent))
        elif path.suffix in (".png", ".svg", ".gif"):
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, target)
        else:
            continue
        staged.add(target)
    changes = ROOT / "CHANGELOG.md"
    write_changed(source / "changes.md", with_links(changes, changes.read_text("utf-8")))
    for old in (*source.glob("*.md"), *(page for folder in COPIED for page in source.glob(f"{folder}/*.md"))):
        if old not in staged and old.name not in MADE:
            old.unlink()
