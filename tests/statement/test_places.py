"""Where the keys and values of a TOML text stand."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.statement.scene.toml_document import inside, line_and_column, places
from tests.statement.scenes import toml

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
    ("coordinates", 1): "'phi'",
    ("kinetic",): '"""\n    m*x',
    ("tricky",): '"""with',
    ("literal",): "'''\n  one",
    ("forces",): "{ theta",
    ("forces", "theta"): '"-c"',
    ("forces", "phi", "deep", 1): "2]",
    ("links", 1, 0): '"c"',
    ("links", 1, 1): '"d"',
    ("date",): "1979-05-27",
    ("parameters", "g"): "9",
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
    ("text", "column", "found"),
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
def test_a_column_inside_a_string_is_found(text: str, column: int, found: str) -> None:
    assert text.startswith(found, inside(text, 0, column))


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
