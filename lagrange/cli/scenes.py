"""The command `lagrange scenes`: list the library from its files, without building systems."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from lagrange.cli.arguments import DONE, Answer, add_command, add_json
from lagrange.show.notation.symbols import plain_text
from lagrange.show.terminal import text_table
from lagrange.statement.run_settings import DEFAULT_METHOD, DEFAULT_T_END
from lagrange.statement.scene.toml_document import Document

SCENES = Path(__file__).resolve().parent.parent / "scenes"


def add_scenes(commands: Any) -> None:
    """Add the command to the command line."""
    scenes_ = add_command(commands, "scenes", scenes, "list the library of scenes", takes_scene=False)
    scenes_.add_argument(
        "--long", action="store_true", help="with coordinates, constraints, end, method and source of each"
    )
    add_json(scenes_)


def scenes(request: argparse.Namespace) -> Answer:
    """Return the scenes of the library. Only the files are read, which is fast."""
    found = [_entry(path, long=request.long) for path in sorted(SCENES.glob("*.toml"))]
    if request.long:
        return Answer(DONE, "\n\n".join(map(_paragraph, found)), found)
    table = text_table(("scene", "what it shows"), [(scene["name"], plain_text(scene["about"])) for scene in found])
    return Answer(DONE, table, found)


def _entry(path: Path, *, long: bool) -> dict[str, Any]:
    scene = Document(path).data
    entry = {"name": path.stem, "about": scene.get("about", ""), "source": scene.get("source", "")}
    if not long:
        return entry
    stated = scene.get("constraints", {})
    run = scene.get("run", {})
    return entry | {
        "coordinates": [*scene.get("coordinates", []), *scene.get("rotations", [])],
        "constraints": [f"{name}: {text}" for name, text in stated.items()] if isinstance(stated, dict) else stated,
        "contacts": list(scene.get("contacts", {})),
        "positions": list(scene.get("positions", {})),
        "t_end": run.get("t_end", DEFAULT_T_END),
        "method": run.get("method", DEFAULT_METHOD),
    }


def _paragraph(entry: dict[str, Any]) -> str:
    lines = [
        ("coordinates", ", ".join(entry["coordinates"])),
        ("constraints", "; ".join(map(plain_text, entry["constraints"])) or "none"),
        ("contacts", ", ".join(entry["contacts"]) or "none"),
        ("positions", ", ".join(entry["positions"]) or "none"),
        ("method", f"{entry['method']} to t = {entry['t_end']}"),
        ("source", plain_text(entry["source"])),
    ]
    title = f"{entry['name']}: {plain_text(entry['about'])}"
    return "\n".join([title, *(f"  {name:11}  {text}" for name, text in lines)])
