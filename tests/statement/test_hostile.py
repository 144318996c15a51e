"""Hostile expressions in every field of a scene: refused, and nothing runs."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lagrange.errors import SceneError
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.vocabulary.functions import WORDS
from tests.statement.attacks import ATTACKS, CANARY
from tests.statement.scenes import DROP, LEAN, write

ROOT = Path(__file__).resolve().parents[2]

FIELDS: dict[str, Callable[[str], dict[str, Any]]] = {
    "kinetic": lambda text: {"kinetic": text},
    "potential": lambda text: {"potential": text},
    "lagrangian": lambda text: {"lagrangian": text, "kinetic": DROP},
    "forces": lambda text: {"forces": {"theta": text}},
    "dissipation": lambda text: {"dissipation": text},
    "constraints": lambda text: {"constraints": [text]},
    "positions": lambda text: {"positions": {"bob": ["0", text]}},
    "parameters": lambda text: {"parameters": {"m": text}},
    "initial": lambda text: {"initial": {"theta": text}},
    "run": lambda text: {"run": {"t_end": text}},
}


@pytest.mark.few(5)
@pytest.mark.parametrize("field", FIELDS)
def test_every_attack_is_refused_in_every_field(field: str, tmp_path: Path, everything: bool) -> None:
    # One attack in six meets each field, and each attack a field at least, unless all are asked for.
    first, every = (0, 1) if everything else (list(FIELDS).index(field) % 6, 6)
    for attack in ATTACKS[first::every]:
        path = write(tmp_path, LEAN, **FIELDS[field](attack))
        with pytest.raises(SceneError) as refusal:
            read_scene(path)
        assert refusal.value.line and refusal.value.column and refusal.value.file == str(path), attack
        assert len(str(refusal.value)) < len(str(path)) + 500 and str(refusal.value).isprintable(), attack
    assert list(tmp_path.iterdir()) == [path]


READER = """
import json, sys
import sympy
from pathlib import Path
from lagrange.errors import SceneError
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.scene.expressions import read_expression, read_number

request = json.load(sys.stdin)
events = []
watching = False
def watch(event, arguments):
    if watching:
        events.append((event, str(arguments[0])[:80] if arguments else ""))
sys.addaudithook(watch)
paths = [Path(path) for path in request["scenes"]]
refused = 0
watching = True
for path in paths:
    try:
        read_scene(path)
    except SceneError:
        refused += 1
x, y = sympy.symbols("x y", real=True)
for text in request["harmless"]:
    read_expression(text, {"x": x, "y": y})
for text in request["attacks"]:
    for read in (read_number, lambda text: read_expression(text, {})):
        try:
            read(text)
        except SceneError:
            refused += 1
watching = False
json.dump({"events": events, "refused": refused}, sys.stdout)
"""


HARMLESS = [
    *(f"{name}(x/2)" for name, word in WORDS.items() if word.fewest == 1),
    "atan2(y, x)",
    "max(x, y, 1) - min(x, 2*y)",
    "x if x < y else y if 0 < x <= 1 else 0",
    "abs(x**3*y) + abs(x - y) + sign(x*y)",
    "(x + y)**0.3*2**x/sqrt(x**2 + y**2)",
    "sinh(log(x)) + exp(2*log(y)) + asin(1/2) + sin(pi/12)",
]


def test_reading_runs_imports_opens_and_spawns_nothing(tmp_path: Path, everything: bool) -> None:
    canary, part = tmp_path / "canary", 1 if everything else 5
    attacks = [attack.replace(CANARY, str(canary)) for attack in ATTACKS[::part]]
    scenes = [str(path) for path in sorted(ROOT.glob("lagrange/scenes/*.toml"))[::part]]
    hostile = tmp_path / "hostile.toml"
    hostile.write_text(f"kinetic = '''{attacks[0]}'''\ncoordinates = ['x']\n", encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-c", READER],
        input=json.dumps({"scenes": [*scenes, str(hostile)], "attacks": attacks, "harmless": HARMLESS}),
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
        timeout=300,
    )
    answer = json.loads(result.stdout)
    assert answer["refused"] == 1 + 2 * len(attacks)
    opened = [argument for event, argument in answer["events"] if event == "open"]
    assert opened == [path[:80] for path in [*scenes, str(hostile)]]
    others = {event for event, _ in answer["events"]} - {"open"}
    # SymPy looks at the identity of objects, and at its own methods
    assert others <= {"builtins.id", "object.__getattr__"}
    assert not canary.exists()
