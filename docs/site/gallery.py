"""The gallery: a page for each scene of the library, with a picture that moves, its equations, and its file."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from moving import svg
from stage import HERE, ROOT, write_changed
from tutorials import STORED

import lagrange as lg
from lagrange.page.player import Animation
from lagrange.statement.scene.library import LibraryScene, library

SCENES = ROOT / "lagrange" / "scenes"
NOTE = 34
"""Pixels in height of a note under a player."""
PLAYER = """\
<div class="player" style="max-width: {width}px">
<iframe style="height: {height}px" src="{name}-player.html" title="{name} in motion"
loading="lazy"></iframe>
</div>"""

TRY = '<p class="try"><a href="{name}-page.html">Change it: sliders for every parameter</a></p>'

INTRODUCTION = """\
# Scenes in motion

The {count} scenes of the library, run and drawn when this page was built. Each has its equations, its file and its
source, and [a page with sliders](../seeing.md) unless it has contacts. `lagrange run NAME` runs it, and
[scenes](../scenes.md) says how a file of your own is written.

"""


GROUPS = ("Free coordinates", "Constraints on coordinates", "Constraints on velocities", "Contacts", "Rotations")


def kind(system: lg.System) -> str:
    """Return the group that a scene is shown in."""
    constraints = system.statement.constraints
    if system.statement.contacts:
        return GROUPS[3]
    if system.statement.rotations:
        return GROUPS[4]
    if not constraints:
        return GROUPS[0]
    if any(constraint.holonomic for constraint in constraints):
        return GROUPS[1]
    return GROUPS[2]


def frame(name: str, animation: Animation) -> str:
    """Return the window in a page in which the player of a scene stands."""
    width, height = animation.frame_size
    return PLAYER.format(name=name, width=width, height=height + NOTE * len(animation.notes))


def page(scene: LibraryScene, system: lg.System, animation: Animation) -> str:
    """Return the page of one scene."""
    stated = system._repr_markdown_().partition("\n\n")[2]
    name = scene.name
    lines = [
        f"# {name}\n\n{scene.about}\n",
        f"```{{raw}} html\n{frame(name, animation)}\n```\n",
        *([] if system.statement.contacts else [f"```{{raw}} html\n{TRY.format(name=name)}\n```\n"]),
        f"Source: {scene.source}.\n",
        "## Run it\n",
        f"```sh\nlagrange run {name} --out out\n```\n",
        f'```python\nimport lagrange as lg\n\nsolution = lg.scene("{name}").run()\nprint(solution)\n```\n',
        "## Statement and equations\n",
        stated,
        f"\nAll steps: `lagrange derive {name}`, or `--format html` for a page.\n",
        "\n## The scene file\n",
        f"```toml\n{(SCENES / f'{name}.toml').read_text('utf-8')}```\n",
    ]
    return "\n".join(lines)


def tile(scene: LibraryScene) -> str:
    """Return the entry of a scene in the gallery."""
    return (
        f"::::{{figure}} {scene.name}.svg\n:target: {scene.name}.html\n:figclass: scene\n:alt: {scene.name}\n\n"
        f"{scene.name}\n::::\n"
    )


def make(scene: LibraryScene, folder: Path, extra: Path) -> str:
    """Write the page of a scene with its pictures, and return its group in the gallery."""
    system = lg.scene(scene.name)
    solution = system.run().require()
    animation = solution.animate(extra / f"{scene.name}-player.html")
    if not system.statement.contacts:
        system.to_page(extra / f"{scene.name}-page.html")
    write_changed(folder / f"{scene.name}.svg", svg(solution))
    write_changed(folder / f"{scene.name}.md", page(scene, system, animation))
    return kind(system)


def scene_groups(folder: Path, extra: Path) -> list[str]:
    """Write the pages of all scenes if the package or these scripts have changed. Return the group of each scene."""
    stamp = extra.parent.parent / "gallery.json"
    digest = STORED["digest"]([*sorted((ROOT / "lagrange").rglob("*.*")), *sorted(HERE.glob("*.py"))])
    if stamp.exists() and (stored := json.loads(stamp.read_text("utf-8")))["digest"] == digest:
        return list(stored["groups"])
    extra.mkdir(parents=True, exist_ok=True)
    scenes = library()
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        groups = list(pool.map(make, scenes, [folder] * len(scenes), [extra] * len(scenes)))
    stamp.write_text(json.dumps({"digest": digest, "groups": groups}), "utf-8")
    return groups


def write(folder: Path, extra: Path) -> None:
    """Write the pages and the pictures of all scenes. Pages with players and sliders go into the folder `extra`."""
    scenes = library()
    groups = scene_groups(folder, extra)
    parts = [INTRODUCTION.format(count=len(scenes))]
    for title in GROUPS:
        tiles = [tile(scene) for scene, group in zip(scenes, groups, strict=True) if group == title]
        parts.append(f"## {title}\n\n:::::{{container}} gallery\n{''.join(tiles)}:::::\n")
    entries = "\n".join(scene.name for scene in scenes)
    parts.append(f"```{{toctree}}\n:hidden:\n\n{entries}\n```\n")
    write_changed(folder / "index.md", "\n".join(parts))
