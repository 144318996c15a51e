"""Cache of procedures that is safe for threads: each procedure is built once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import wraps
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Found = TypeVar("Found")

_BUILDING = threading.RLock()


def shared(build: Callable[Given, Found]) -> Callable[Given, Found]:
    """Return a function that calls `build` once for each set of arguments, and caches the results.

    With `functools.cache` two threads could build two procedures with the same name, and a procedure that calls both
    would be invalid. A single reentrant lock serves all caches, because one build may call another.
    """
    known: dict[Hashable, Found] = {}

    @wraps(build)
    def remembered(*args: Given.args, **kwargs: Given.kwargs) -> Found:
        key = args, tuple(kwargs.items())
        if key not in known:
            with _BUILDING:
                if key not in known:
                    known[key] = build(*args, **kwargs)
        return known[key]

    return remembered
