"""The site runs the code of pages that save pictures, and shows each picture after its code.

A page is run again only if it or the package has changed.
"""

from __future__ import annotations

import io
import os
import re
import shutil
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from navigation import PAGES_WITH_PICTURES
from stage import DOCS, ROOT, write_changed
from tutorials import STORED

BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SAVED = re.compile(r"\b(?:savefig|to_png)\(\"([\w-]+\.png)\"")
KEPT = ROOT / "build" / "site" / "shown"
DOTS = 160
"""Dots per inch of the pictures: about two for each pixel of the page."""


def groups(text: str) -> list[list[str]]:
    """Return the Python blocks of a page: each block that imports the package, with the blocks that continue it."""
    result: list[list[str]] = []
    for body in BLOCK.findall(text):
        if re.search(r"^(import|from) lagrange", body, re.MULTILINE) or not result:
            result.append([body])
        else:
            result[-1].append(body)
    return result


def run(name: str, folder: Path) -> None:
    """Run the code of a page that draws, and move the pictures that it saves into a folder."""
    import matplotlib

    matplotlib.rcParams["savefig.dpi"] = DOTS
    text = (DOCS / f"{name}.md").read_text("utf-8")
    with TemporaryDirectory() as scratch:
        os.chdir(scratch)
        for blocks in groups(text):
            if SAVED.search("".join(blocks)):
                script = Path("page.py")
                script.write_text("\n".join(blocks), "utf-8")
                with redirect_stdout(io.StringIO()):
                    run_path(script)
        folder.mkdir(parents=True, exist_ok=True)
        for picture in sorted(Path().glob("*.png")):
            shutil.move(picture, folder / picture.name)
        os.chdir(DOCS)


def run_path(script: Path) -> None:
    """Run a script in a new namespace."""
    import runpy

    runpy.run_path(str(script))


def with_pictures(name: str, text: str) -> str:
    """Return the text of a page with each picture after the code that saves it."""

    def with_its_pictures(block: re.Match[str]) -> str:
        pictures = [f"![{Path(file).stem}]({stem}-{file})" for file in SAVED.findall(block[1])]
        return "\n\n".join([block[0], *pictures])

    stem = Path(name).name
    return BLOCK.sub(with_its_pictures, text)


def write(source: Path) -> None:
    """Run the pages that save pictures, and add these to the staged pages."""
    package = sorted((ROOT / "lagrange").rglob("*.*"))
    folders = {name: KEPT / STORED["digest"]([DOCS / f"{name}.md", *package])[:16] for name in PAGES_WITH_PICTURES}
    missing = [(name, folder) for name, folder in folders.items() if not folder.exists()]
    with ProcessPoolExecutor(mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        for future in [pool.submit(run, *task) for task in missing]:
            future.result()
    for name, folder in folders.items():
        page = source / f"{name}.md"
        write_changed(page, with_pictures(name, page.read_text("utf-8")))
        for picture in folder.glob("*.png"):
            shutil.copy2(picture, page.parent / f"{page.stem}-{picture.name}")
