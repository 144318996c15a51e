"""Files that are no scenes are refused; messages have the file name and, if possible, line and column."""

from __future__ import annotations

import os
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.errors import SceneError
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.scene.toml_document import LARGEST_FILE, Document, inside, kind_of, line_and_column, places
from tests.statement.scenes import toml, write


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


@pytest.mark.few(4)
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
