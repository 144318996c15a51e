"""Files with which shells complete the command line: run by the shells themselves."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.cli import main

CASES = [
    (("an",), {"animate"}),
    (("run", "double"), {"double-pendulum"}),
    (("run", "mi"), {"mine.toml"}),
    (("derive", "pendulum", "--for"), {"--format"}),
    (("run", "x", "--method", "dop"), {"dop853", "dopri5"}),
    (("derive", "x", "--format", "la"), {"latex"}),
    (("export", "x", "--target", "ca"), {"casadi"}),
    (("run", "x", "--out", "ou"), {"out"}),
    (("run", "x", "--rtol", "1"), set()),
    (("completion", "z"), {"zsh"}),
]


def file_for(shell: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Write the file of a shell into a folder that has a scene and a folder to be completed."""
    if not shutil.which(shell):
        pytest.skip(f"{shell} is not installed")
    assert main(["completion", shell]) == 0
    path = folder / f"complete.{shell}"
    path.write_text(capsys.readouterr().out)
    (folder / "mine.toml").write_text("")
    (folder / "out").mkdir()
    return path


def answers(command: list[str], folder: Path) -> list[set[str]]:
    """Return the words that a program of a shell printed for each case, one block of lines each."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=600)
    assert done.stderr == ""
    return [set(block.split()) for block in done.stdout.split("=\n")[:-1]]


def test_bash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = file_for("bash", tmp_path, capsys)
    lines = [f"source {path}", "compopt() { :; }"]
    for words, _ in CASES:
        lines += [f"COMP_WORDS=(lagrange {' '.join(words)}); COMP_CWORD={len(words)}; _lagrange"]
        lines += [r'printf "%s\n" "${COMPREPLY[@]}"; echo =']
    assert answers(["bash", "--norc", "-c", "\n".join(lines)], tmp_path) == [expected for _, expected in CASES]


def test_fish(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = file_for("fish", tmp_path, capsys)
    lines = [f"source {path}"]
    for words, _ in CASES:
        lines += [f"complete -C 'lagrange {' '.join(words)}' | string replace -r '\\t.*' ''; echo ="]
    found = answers(["fish", "-N", "-c", "\n".join(lines)], tmp_path)
    assert [{word.rstrip("/") for word in words} for words in found] == [expected for _, expected in CASES]


def test_zsh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = file_for("zsh", tmp_path, capsys)
    lines = ["compdef() { :; }; _files() { :; }; _describe() { :; }"]
    lines += ["compadd() { [[ $1 == -a ]] && print -l -- ${(P)2} || print -l -- ${@:2}; }", f"source {path}"]
    for words, _ in CASES:
        lines += [
            f"words=(lagrange {' '.join(words)}); CURRENT={len(words) + 1}; PREFIX={words[-1]}; _lagrange; echo ="
        ]
    found = answers(["zsh", "-f", "-c", "\n".join(lines)], tmp_path)
    for (words, expected), offered in zip(CASES, found, strict=True):
        own = {word for word in expected if not word.startswith(("-", "mine", "out", "animate"))}
        assert own == offered & expected, words


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_command_option_scene_method_and_target_is_there(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    words = set(text.replace("'", " ").replace("(", " ").replace(")", " ").replace(":", " ").replace(";", " ").split())
    assert {*lg.scenes(), *lg.methods.names(), *dict(lg.targets())} <= words
    dashes = "" if shell == "fish" else "--"
    long = [f"{dashes}{option}" for option in ("tolerances", "t-end", "no-check")]
    assert {"run", "plot", "animate", "scenes", "completion", *long} <= words


def test_another_shell_is_refused_with_those_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "fisch"]) == 2
    assert capsys.readouterr().err.endswith("choose from 'bash', 'zsh', 'fish'). Did you mean 'fish'?\n")
