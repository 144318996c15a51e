"""Calls of all public functions with a hostile text in every argument and container, under an audit hook.

It runs as a program in its own folder and process: some calls write files named by the text, and an audit hook cannot
be removed.
"""

import json
import os
import resource
import sys
from collections import UserString
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Any

import numpy as np
import sympy

import lagrange as lg
from tests.public.surface import arguments, surface
from tests.public.test_wrong_calls import MEMORY, raw

MARK = "canary_of_the_audit"
TEXT = f'__import__("os").system("touch {MARK}")'

STARTS = ("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.startfile")
"""Events that no public call has a reason for."""

heard: list[str] = []


def hook(event: str, given: tuple[Any, ...]) -> None:
    if event in STARTS or (event in ("compile", "exec", "import") and any(map(speaks, given))):
        heard.append(event)


def speaks(thing: Any) -> bool:
    """Return True if source text or a code object contains the hostile text."""
    if isinstance(thing, CodeType):
        return any(map(speaks, (*thing.co_consts, *thing.co_names)))
    if isinstance(thing, bytes):
        return MARK.encode() in thing
    return isinstance(thing, str) and MARK in thing


class Told:
    """An object whose str and repr are code."""

    def __str__(self) -> str:
        return TEXT

    __repr__ = __str__


class Own(str):
    """A subclass of str."""

    __slots__ = ()


x = lg.coordinate("x")

CONTAINERS: dict[str, Callable[[], Any]] = {
    "text": lambda: TEXT,
    "list": lambda: [TEXT],
    "pair": lambda: (0.0, [TEXT]),
    "dict key": lambda: {TEXT: 1.0},
    "dict value": lambda: {x: TEXT},
    "generator": lambda: (text for text in [TEXT]),
    "object array": lambda: np.array([TEXT, TEXT], object),
    "text array": lambda: np.array([TEXT]),
    "bytes": TEXT.encode,
    "subclass": lambda: Own(TEXT),
    "user string": lambda: UserString(TEXT),
    "object": Told,
    "symbol": lambda: sympy.Symbol(TEXT),
    "function": lambda: sympy.Function(TEXT)(lg.t),
    "equation": lambda: sympy.Eq(x, sympy.Symbol(TEXT)),
}


def main(folder: Path, part: int) -> dict[str, Any]:
    """Return the number of calls, and a line for each failure. Every argument gets one of `part` containers."""
    sys.addaudithook(hook)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    calls, wrong, turn = 0, [], 0
    for public in surface():
        for parameter in public.parameters:
            turn += 1
            for container, make in list(CONTAINERS.items())[turn % part :: part]:
                given = arguments(public, folder) | {parameter.name: make()}
                heard.clear()  # what the test itself made is not heard
                positional = [given.pop(p.name) for p in public.parameters if p.kind is p.POSITIONAL_ONLY]
                if parameter.kind is parameter.VAR_POSITIONAL:
                    positional = [given.pop(parameter.name)]
                failure = raw(public, positional, given)
                calls += 1
                if failure or heard:
                    wrong.append(f"{public.name}({parameter.name}={container}): {failure or heard}")
    return {"calls": calls, "wrong": wrong, "canary": [path.name for path in Path.cwd().iterdir() if path.name == MARK]}


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        json.dump(main(Path(folder), int(sys.argv[1])), sys.stdout)
