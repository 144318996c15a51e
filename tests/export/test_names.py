"""Names that are equal in all the letters that a language distinguishes become different ones."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.export.systems import named


def test_names_that_differ_beyond_63_letters_stay_different(tmp_path: Path) -> None:
    long = "a" * 63
    system = named([long, f"{long}b", f"{'c' * 62}1", f"{'c' * 62}12"], ["x8", "x9", f"{long}d"])
    system.export("c", tmp_path, ["rhs", "energy"])
    text = (tmp_path / "named.c").read_text()
    body = text.partition("int named_rhs(")[2].partition("\n}\n")[0]
    defined = re.findall(r"const double (\w+) =", body)
    assert len({name[:63] for name in defined}) == len(defined) >= 8
    assert max(map(len, defined)) == 63


@pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
def test_constants_of_headers_are_renamed(tmp_path: Path) -> None:
    """Compilers define more than the standard of C asks for unless they are told not to."""
    system = named(["M_PI", "SIZE_MAX"], ["M_E", "SEEK_SET", "RAND_MAX", "INT8_MAX", "MAXFLOAT"])
    system.export("c", tmp_path, ["rhs", "energy"])
    command = ["cc", "-std=gnu99", "-Wall", "-Werror", "-fsyntax-only", "named.c", "named_test.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
