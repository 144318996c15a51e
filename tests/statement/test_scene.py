"""Scene files: their contents, and all refusals."""

import json
import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import coordinate, t, velocity_of
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.scene import scene_reader as module
from lagrange.statement.scene.library import library, library_path, load
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.scene.toml_document import LARGEST_FILE, Document, inside, kind_of, line_and_column, places
from lagrange.statement.statement import Link
from lagrange.statement.vocabulary.functions import WORDS
from tests.statement.examples import ATTACKS, CANARY, DROP, LEAN, toml, write

theta = coordinate("theta")
m, l, g, c = (sympy.Symbol(name, real=True) for name in "mlgc")


def test_a_scene_becomes_a_statement(tmp_path: Path) -> None:
    result = read_scene(
        write(
            tmp_path,
            about="swings\n to and fro",
            source="a book",
            dissipation="k*theta_dot**2",
            parameters={"m": 1, "l": "1/2", "g": 9.81, "c": "pi/6", "k": 0, "unused": 3},
            initial={"theta": "pi/2", "theta_dot": -1},
            run={"t_end": "2*pi", "method": "dop853", "rtol": 1e-9, "atol": 0, "step": 0.1},
        )
    )
    assert result.names == ("theta",)
    assert result.kinetic == m * l**2 * velocity_of(theta) ** 2 / 2
    assert result.potential == -m * g * l * sympy.cos(theta)
    assert result.lagrangian == result.kinetic - result.potential
    assert result.forces == (-c * velocity_of(theta),)
    assert result.dissipation == sympy.Symbol("k", real=True) * velocity_of(theta) ** 2
    assert {symbol.name: value for symbol, value in result.defaults.items()} == {
        "m": 1.0, "l": 0.5, "g": 9.81, "c": float(sympy.pi / 6), "k": 0.0, "unused": 3.0,
    }  # fmt: skip
    assert result.initial == (float(sympy.pi / 2), -1.0)
    assert dict(result.positions) == {"bob": (l * sympy.sin(theta), -l * sympy.cos(theta))}
    assert result.links == (Link("origin", "bob"),)
    assert (result.name, result.about, result.source) == ("pendulum", "swings to and fro", "a book")
    assert result.run == RunSettings(float(2 * sympy.pi), "dop853", 1e-9, 0.0, 0.1)


def test_most_of_a_scene_may_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "my-scene.toml"
    path.write_text('coordinates = ["x"]\nlagrangian = "x_dot**2/2 - x*t"\nconstraints = []\n', encoding="utf-8")
    result = read_scene(path)
    assert result.name == "my-scene"
    assert result.lagrangian == velocity_of(coordinate("x")) ** 2 / 2 - coordinate("x") * t
    assert result.initial == (0.0, 0.0)
    assert result.run == RunSettings()
    path = path.rename(tmp_path / "-.toml")
    assert read_scene(path).name == "scene"


def test_energies_may_be_numbers(tmp_path: Path) -> None:
    assert read_scene(write(tmp_path, potential=0)).potential == 0
    assert read_scene(write(tmp_path, dissipation=0)).dissipation == 0
    assert read_scene(write(tmp_path, forces={"theta": -3})).forces == (-3,)


def test_names_may_be_greek_letters(tmp_path: Path) -> None:
    energies = {"kinetic": "m*θ_dot**2/2", "potential": "-Ω*cos(2*θ)"}
    result = read_scene(write(tmp_path, energies, coordinates=["θ"], parameters={"m": 1, "Ω": 2}, initial={"θ_dot": 2}))
    assert result.names == ("θ",) and result.initial == (0.0, 2.0)
    assert result.potential == -sympy.Symbol("Ω", real=True) * sympy.cos(2 * coordinate("θ"))


# --- refusals: field, its value, line, column, reason ------------------------------------------------------------

Bad = tuple[dict[str, Any], int, int, str]
FIELDS: list[Bad] = [
    # the scene (one field per line: name, coordinates, kinetic, potential, forces, parameters, initial, ...)
    ({"kinetc": "x"}, 11, 1, "'kinetc' is not a key of a scene; there are name, about, source, coordinates, kinetic,"),
    ({"name": 3}, 1, 8, "name is an integer: give a text in quotation marks."),
    ({"name": "../etc"}, 1, 8, "a scene's name must have 1 to 64 printable characters"),
    ({"about": "\x1b[2J"}, 11, 9, "about contains a control character: write plain text."),
    ({"constraints": "theta"}, 11, 15, "constraints is a text: write a table [constraints] of names and values."),
    ({"constraints": ["theta >= 1"]}, 11, 16, "constraints[0] is an inequality. Constraints are equations"),
    ({"constraints": ["theta = 1"]}, 11, 23, "for an equation or a comparison write =="),
    # coordinates
    ({"coordinates": DROP}, 1, 1, 'there are no coordinates: write coordinates = ["theta"].'),
    ({"coordinates": []}, 2, 15, "there are no coordinates"),
    ({"coordinates": ["theta", "theta"]}, 2, 25, "'theta' cannot name a coordinate, because it is a coordinate"),
    ({"coordinates": ["x", "x_dot"]}, 2, 21, "'x_dot' cannot name a coordinate, because it is taken: x_dot"),
    # energies
    ({"kinetic": "m*l**2*thta_dot**2/2"}, 3, 19, "kinetic: 'thta_dot' is not declared: add it to [parameters] or"),
    ({"kinetic": ["m"]}, 3, 11, 'kinetic is a list: give an expression as a text, such as "2*x".'),
    ({"kinetic": "m*l**2"}, 3, 11, "the kinetic energy does not contain theta_dot, so theta has no inertia"),
    ({"dissipation": "m"}, 11, 15, "the dissipation is m, without a velocity"),
    ({"constraints": ["m - 1"]}, 11, 15, "constraint 'constraint_1' contains no coordinate and no velocity (m - 1"),
    ({"constraints": {"rod": "m - 1"}}, 11, 24, "constraint 'rod' contains no coordinate and no velocity"),
    ({"redundant": "drop"}, 11, 13, "redundant is 'drop': give one of refuse and allow."),
    ({"simultaneous": "both"}, 11, 16, "simultaneous is 'both': give one of"),
    ({"dimensions": {"m": "kgg"}}, 11, 14, "the dimension of m is 'kgg', which is neither a dimension nor a unit."),
    ({"lagrangian": "m", "kinetic": DROP, "potential": DROP}, 9, 14, "the Lagrangian does not contain theta_dot"),
    ({"potential": "-m*g*l*cos(phi)"}, 4, 25, "potential: 'phi' is not declared"),
    ({"potential": True}, 4, 13, "potential is true or false: give an expression as a text"),
    ({"dissipation": "theta_dot^2"}, 11, 25, "dissipation: '^' is not allowed in an expression: write ** for a power."),
    # forces
    ({"forces": {"phi": "1"}}, 5, 11, "'phi' is not a coordinate of this scene; there are theta."),
    # parameters
    ({"parameters": {"m": True}}, 6, 21, 'parameters.m is true or false: give a number, or a constant'),
    ({"parameters": {"theta": 1}}, 6, 15, "'theta' cannot name a parameter, because it is a coordinate already"),
    # initial state
    ({"initial": {"phi": 1}}, 7, 12, "'phi' is not a coordinate or velocity of this scene; there are theta and"),
    # positions and links
    ({"positions": {"bob": ["0", "l*sin(phi)"]}}, 8, 35, "positions.bob[1]: 'phi' is not declared"),
    ({"links": [["origin", "bobb"]]}, 9, 21, "links names 'bobb', which is not a position; they are origin and bob."),
    # run
    ({"run": {"t_end": 0}}, 10, 18, "t_end is 0: give the time at which the run ends, other than the start."),
    ({"run": {"method": "rm -rf /"}}, 10, 19, "method is not a name of a method: write one such as 'dop853'."),
]  # fmt: skip


@pytest.mark.parametrize("bad", FIELDS, ids=lambda bad: f"{next(iter(bad[0]))}-{bad[3][:24]}")
def test_a_refusal_says_where_and_why(bad: Bad, tmp_path: Path) -> None:
    fields, line, column, reason = bad
    path = write(tmp_path, **fields)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert reason in caught.value.reason
    assert (caught.value.line, caught.value.column) == (line, column)
    assert str(caught.value).startswith(f"{path}:{line}:{column}: ")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_numbers_are_finite(value: str, tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text("utf-8").replace("9.81", value), encoding="utf-8")
    with pytest.raises(SceneError, match=r"parameters.g is -?(nan|inf): give a finite number") as caught:
        read_scene(path)
    assert caught.value.line == 6


def test_what_only_the_statement_can_see_is_refused_with_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_: Any) -> None:
        raise StatementError("no.")

    monkeypatch.setattr(module, "declare", refuse)
    path = write(tmp_path)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert str(caught.value) == f"{path}:1:1: no."


def test_a_misspelt_scene_of_the_library() -> None:
    with pytest.raises(StatementError, match=r"no scene 'pendulm'; it has .* Did you mean 'pendulum'\?"):
        load("pendulm")


@pytest.mark.parametrize("name", ["../scenes/pendulum", "/etc/passwd", "", "pendulum.toml", "\x00"])
def test_the_library_holds_names_and_not_paths(name: str) -> None:
    with pytest.raises(StatementError, match="the library has no scene"):
        library_path(name)


@pytest.mark.parametrize("path", ["my.toml", "scenes/mine", Path("my.toml"), "pendulum.toml", "a scene"])
def test_a_file_is_not_a_scene_of_the_library(path: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a scene").touch()
    with pytest.raises(StatementError, match=re.escape(f"lg.System.from_scene('{path}')")):
        library_path(path)


def test_the_library_lists_what_it_loads() -> None:
    entries = library()
    for entry in entries:
        assert library_path(entry.name) == entry.path
    for entry in entries[::12]:  # every scene is loaded by tests of its own
        assert load(entry.name).about == entry.about


def test_constraints_are_expressions_or_equations_with_two_sides(tmp_path: Path) -> None:
    """A condition inside an expression is not an equation."""
    forms = ["theta**2 - 1", "theta**2 == 1", "theta**2 - (1 if theta == theta else 2)"]
    held = [read_scene(write(tmp_path, constraints=[form])).constraints[0].expression for form in forms]
    assert held[0] == held[1] and held[2].has(held[0].args[0])


# --- files that are no scenes are refused; messages have the file name and, if possible, line and column -------


def refusal(path: Path | str) -> SceneError:
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert caught.value.file == str(path)
    said = str(caught.value)
    assert said.isprintable() and len(said) <= 400
    assert said.startswith(f"{path}:") or not str(path).isprintable() or len(str(path)) > 200
    return caught.value


def written(folder: Path, data: bytes) -> Path:
    path = folder / "scene.toml"
    path.write_bytes(data)
    return path


def test_what_is_no_file_to_read_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    device = "this is a device or pipe: give the path of a scene file."
    for path, reason in (
        (tmp_path / "no.toml", "there is no such file: check the path."),
        (tmp_path, "this is a folder: give the path of a scene file."),
        (tmp_path / "pipe.toml", device),
        ("/dev/zero", device),
        ("a\x00b.toml", "the file cannot be read ("),
        ("a" * 5000, "the file cannot be read ("),
    ):
        assert refusal(path).reason.startswith(reason)


def test_a_file_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = write(tmp_path)
    monkeypatch.setattr(Path, "open", refuse)
    result = refusal(path).reason
    assert result == "the file cannot be read (Permission denied): check the path and its permissions."


def test_a_long_file(tmp_path: Path) -> None:
    full = written(tmp_path, b"#" * LARGEST_FILE)
    assert "there are no coordinates" in refusal(full).reason
    assert refusal(written(tmp_path, b"#" * (LARGEST_FILE + 1))).reason == (
        "the file has more than 1048576 bytes, the most that a scene may have."
    )


def test_bytes_that_are_not_utf8(tmp_path: Path) -> None:
    error = refusal(written(tmp_path, b'name = "ok"\nabout = "caf\xe9"\n'))
    assert (error.line, error.column) == (2, 13)
    assert error.reason == "byte 0xe9 is not UTF-8: save the file as UTF-8."


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    data = write(tmp_path).read_bytes().replace(b"\n", b"\r\n")
    assert read_scene(written(tmp_path, b"\xef\xbb\xbf" + data)).names == ("theta",)
    error = refusal(written(tmp_path, data.replace(b"m*l", b"m*q")))
    assert (error.line, error.column) == (3, 14)


@pytest.mark.parametrize(
    ("text", "line", "column", "reason"),
    [
        ("name = \n", 1, 8, "this is not TOML: Invalid value."),
        ('a = 1\nb = "x\n', 2, 7, "this is not TOML: Illegal character '\\n'."),
        ("a = 1\na = 2\n", 2, 6, "this is not TOML: Cannot overwrite a value."),
        ('a = """x', 1, None, "this is not TOML: Unterminated string."),
        ("a = 1\x00\n", 1, 6, "this is not TOML: "),
    ],
)
def test_what_is_not_toml(text: str, line: int, column: int | None, reason: str, tmp_path: Path) -> None:
    error = refusal(written(tmp_path, text.encode()))
    assert (error.line, error.column) == (line, column)
    assert reason in error.reason


def test_an_integer_with_too_many_digits_is_refused(tmp_path: Path) -> None:
    error = refusal(written(tmp_path, b"a = 1\nk = " + b"9" * 5000))
    assert error.reason == "an integer has thousands of digits: write a decimal, such as 1.5e100."


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "text",
    [
        *("".join(f"1e999{i}=1\n" for i in range(60_000)) + "x=1e999", "x=" + "[" * 500_000, "x=" + "{a=" * 300_000),
        *("x=" + "[" * 400 + "]" * 400, "x=" + "9" * 1_000_000, "x=0x" + "f" * 1_000_000, "x=1." + "0" * 900_000),
        *("x=1e" + "9" * 900_000, ".".join(["a"] * 500_000) + "=1", "[" + ".".join(["a"] * 500_000) + "]"),
        *((".".join(["a"] * 1000) + "=1\n") * 500, "".join(f"[a{i}.b.c.d]\n" for i in range(60_000))),
        *("[[a]]\n" * 150_000, 'x="' + "a" * 1_000_000, "x=[" + "{}," * 100_000 + "]", "=" * 1_000_000),
        *("\n" * 1_000_000, '"' * 1_000_000),
    ],
    ids=lambda text: text[:12].strip(),
)
def test_bombs_are_refused_in_little_time_and_memory(text: str, tmp_path: Path) -> None:
    path = written(tmp_path, text.encode())
    start = time.process_time()
    error = refusal(path)
    assert time.process_time() - start < 20  # a hang guard: unbounded, the dotted keys take all memory
    assert len(error.reason) <= 400


def test_values_are_named_in_words(tmp_path: Path) -> None:
    text = "a = true\nb = 1\nc = 1.5\nd = 'x'\ne = [1]\nf = {x = 1}\ng = 1979-05-27\nh = 07:32:00\n"
    data = Document(written(tmp_path, text.encode())).data
    assert [kind_of(value) for value in data.values()] == [
        "true or false", "an integer", "a number", "a text", "a list", "a table", "a date or time", "a date or time",
    ]  # fmt: skip


# --- Where the keys and values of a TOML text stand ---


TEXT = (
    """\
# a scene
name = "a = [b] # c"   # "comment" with 'quotes' = and [brackets]
"quoted key" = 'it"""
    + """\
'
site."google.com".x = 1.5
coordinates = [
    "theta",  # the first, "really"
    'phi',
]
kinetic = \"\"\"
    m*x +
    n*y\"\"\"
tricky = \"\"\"with "quotes" inside\"\"\"\"\"
literal = '''
  one "two" '''
forces = { theta = "-c", phi = { deep = [1, 2] } }
links = [["a", "b"], ["c", "d"]]
date = 1979-05-27 07:32:00

[parameters]
m = 1.0
g = 9.81

[run.more]
t_end = 1
[[list]]
x = 1
"""
)

FOUND = {
    ("name",): '"a = [b] # c"',
    ("quoted key",): "'it'",
    ("site", "google.com", "x"): "1",
    ("coordinates", 0): '"theta"',
    ("kinetic",): '"""\n    m*x',
    ("tricky",): '"""with',
    ("literal",): "'''\n  one",
    ("forces",): "{ theta",
    ("forces", "phi", "deep", 1): "2]",
    ("links", 1, 1): '"d"',
    ("date",): "1979-05-27",
    ("run", "more", "t_end"): "1\n[[",
    ("list", 0, "x"): "1\n",
}


@pytest.mark.parametrize("path", FOUND, ids=str)
def test_values_are_found(path: tuple[str | int, ...]) -> None:
    _, values = places(TEXT)
    assert TEXT.startswith(FOUND[path], values[path])


@pytest.mark.parametrize(
    ("path", "line"), [(("name",), 2), (("forces", "theta"), 15), (("parameters",), 19), (("parameters", "g"), 21)]
)
def test_keys_are_found(path: tuple[str, ...], line: int) -> None:
    keys, _ = places(TEXT)
    assert line_and_column(TEXT, keys[path])[0] == line
    assert TEXT.startswith(path[-1], keys[path])


@pytest.mark.parametrize(
    ("text", "column", "result"),
    [
        ('"abc"', 1, "abc"),
        ('"abc"', 3, 'c"'),
        ("'a\\nc'", 3, "nc'"),
        ('"a\\nbc"', 3, 'bc"'),
        ('"\\u03b8x"', 2, 'x"'),
        ('"\\U000003b8x"', 2, 'x"'),
        ('"""\nabc"""', 1, "abc"),
        ('"""abc"""', 2, "bc"),
        ('"""\na\n b"""', 4, 'b"""'),
        ('"""a\\\n   b"""', 2, 'b"""'),
        ('"""\\\n   b"""', 1, 'b"""'),
        ("'''\na\\\nb'''", 4, "b'''"),
    ],
)
def test_a_column_inside_a_string_is_found(text: str, column: int, result: str) -> None:
    assert text.startswith(result, inside(text, 0, column))


KEYS = st.text("abz", min_size=1, max_size=4)
VALUES = st.recursive(
    st.one_of(st.integers(-9, 9), st.booleans(), st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KEYS, inner, max_size=3)),
    max_leaves=12,
)


@given(st.dictionaries(KEYS, VALUES, max_size=4))
@pytest.mark.slow
def test_every_value_of_a_random_file_is_found(data: dict[str, Any]) -> None:
    text = "".join(f"{key} = {toml(value)}\n" for key, value in data.items())
    assert tomllib.loads(text) == data
    _, values = places(text)

    def check(path: tuple[str | int, ...], value: Any) -> None:
        assert text.startswith(toml(value), values[path])
        children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, child in children:
            check((*path, key), child)

    for key, value in data.items():
        check((key,), value)


# --- hostile expressions in every field of a scene: refused, and nothing runs ----------------------------------


ROOT = Path(__file__).resolve().parents[2]

HOSTILE_FIELDS: dict[str, Callable[[str], dict[str, Any]]] = {
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
@pytest.mark.parametrize("field", HOSTILE_FIELDS)
def test_every_attack_is_refused_in_every_field(field: str, tmp_path: Path, everything: bool) -> None:
    # One attack in six meets each field, and each attack a field at least, unless all are asked for.
    first, every = (0, 1) if everything else (list(HOSTILE_FIELDS).index(field) % 6, 6)
    for attack in ATTACKS[first::every]:
        path = write(tmp_path, LEAN, **HOSTILE_FIELDS[field](attack))
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
    canary, part = tmp_path / "canary", 1 if everything else 20
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
