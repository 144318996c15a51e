"""Build the documentation site.

    pip install -e '.[docs-site]'
    python docs/site/build.py [FOLDER]

The folder, out/site unless given, has the pages; build/site keeps what the next build need not make again. Warnings are
errors, and the pages are checked: they fetch nothing from elsewhere, and every link and anchor in them leads somewhere.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import api
import commands
import gallery
import shown
import tutorials
from links import faults
from stage import HERE, ROOT, stage


def main(folder: Path) -> int:
    """Build the site and check it; return the exit status."""
    from sphinx.cmd.build import main as sphinx_build

    work = ROOT / "build" / "site"
    source = work / "source"
    began = time.perf_counter()
    stage(source)
    api.write(source / "api")
    commands.write(source / "commands.md")
    gallery.write(source / "gallery", work / "extra" / "gallery")
    tutorials.write(source / "tutorials")
    shown.write(source)
    print(f"sources: {time.perf_counter() - began:.0f} s", flush=True)
    # All pages are written: Sphinx would not rewrite a page of which only the entry in the navigation has changed.
    options = ["-b", "html", "-W", "--keep-going", "-n", "-q", "-a", "-j", "auto", "-c", str(HERE)]
    status = int(sphinx_build([*options, "-d", str(work / "doctrees"), str(source), str(folder)]))
    sentences = list(faults(folder))
    print("\n".join([*sentences, f"built and checked: {time.perf_counter() - began:.0f} s"]), flush=True)
    return status or bool(sentences)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "out" / "site"))
