"""The cache of object code gives the code of each text, and has a bounded size."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

from tests.kept_code import KeptCode, shrink


def test_a_text_is_compiled_once_and_again_where_its_file_is_damaged(tmp_path: Path) -> None:
    compiled: list[tuple[str, int]] = []

    def compile_text(text: str, effort: int, passes: object) -> bytes:
        compiled.append((text, effort))
        return f"{text} {effort}".encode()

    ways = [("a", 0), ("a", 2), ("b", 2)]
    for _ in range(2):
        kept = KeptCode(tmp_path / "code", compile_text)
        assert [kept(*way, None) for way in ways] == [b"a 0", b"a 2", b"b 2"]
    assert compiled == ways
    for file in kept.folder.glob("*"):
        file.write_bytes(file.read_bytes()[:-1] + b"9")
    assert kept("a", 0, None) == b"a 0" and compiled == [*ways, ("a", 0)]


def test_threads_that_compile_one_text_at_once_all_keep_it(tmp_path: Path) -> None:
    together = Barrier(8)

    def compile_text(text: str, effort: int, passes: object) -> bytes:
        together.wait(timeout=60)
        return text.encode()

    kept = KeptCode(tmp_path / "code", compile_text)
    with ThreadPoolExecutor(8) as threads:
        codes = list(threads.map(lambda _: kept("a" * 100_000, 2, None), range(8)))
    assert codes == [b"a" * 100_000] * 8 and len(list(kept.folder.glob("*"))) == 1


def test_files_that_were_read_longest_ago_are_removed(tmp_path: Path) -> None:
    for age, name in enumerate("dcba"):
        (tmp_path / name).write_bytes(bytes(10))
        os.utime(tmp_path / name, (100 - age, 100 - age))
    shrink(tmp_path, 25)
    assert sorted(file.name for file in tmp_path.glob("*")) == ["c", "d"]
