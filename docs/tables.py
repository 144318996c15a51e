"""Write what the pages show of the package: the tables of scenes and methods, and the picture in the README.

    python docs/tables.py

A test holds the tables against what is registered.
"""

from __future__ import annotations

import re
from pathlib import Path

import lagrange as lg
from lagrange.statement.scene import LibraryScene, library

DOCS = Path(__file__).resolve().parent


def scene_table() -> str:
    """Return one row per scene of the library."""
    lines = ["| scene | coordinates | what it shows | source |", "|---|---|---|---|", *map(_scene_row, library())]
    return "\n".join(lines)


def _scene_row(scene: LibraryScene) -> str:
    names = ", ".join(f"`{name}`" for name in lg.scene(scene.name).statement.names)
    return f"| `{scene.name}` | {names} | {scene.about} | {scene.source} |"


TABLES = {
    "scenes": ("scenes.md", scene_table),
    "methods": ("choosing-an-integrator.md", lambda: lg.methods.table().to_markdown()),
}
"""Each table by the name in its markers: its page, and what makes it."""


def filled(page: str, marker: str, table: str) -> str:
    """Return the text of a page with a table between its markers."""
    pattern = rf"(<!-- {marker}:begin -->\n).*?(<!-- {marker}:end -->)"
    return re.sub(pattern, lambda match: f"{match[1]}{table}\n{match[2]}", page, flags=re.DOTALL)


def main() -> None:
    """Write the tables and the picture."""
    for marker, (name, make) in TABLES.items():
        path = DOCS / name
        path.write_text(filled(path.read_text("utf-8"), marker, make()), "utf-8")
        print(f"wrote {name}")
    regions = lg.methods.plot_stability("euler", "rk4", "dopri5", "dop853", "radau5", "bdf2")
    regions.savefig(DOCS / "stability.png", dpi=110)
    lg.scene("double-pendulum").run(rtol=1e-12).plot().savefig(DOCS / "double-pendulum.png", dpi=110)
    print("wrote double-pendulum.png")


if __name__ == "__main__":
    main()
