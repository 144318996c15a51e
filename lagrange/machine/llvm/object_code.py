"""Cache of object code, with the IR text as key: a text is compiled once in a process."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable

CACHE_BYTES = 32_000_000
"""Largest size of the cache in bytes. The least recently used code is dropped first. A right-hand side takes some 5 kB,
a loop over steps of an implicit method 50 kB.
"""


class ObjectCode:
    """Cache of object code. A system that is stated again, or changed and changed back, is not compiled again."""

    def __init__(self, room: int = CACHE_BYTES) -> None:
        self._room, self._taken = room, 0
        self._codes: OrderedDict[bytes, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Empty the cache, for measurements of compile times."""
        with self._lock:
            self._codes.clear()
            self._taken = 0

    def of(self, text: str, how: str, compiled: Callable[[], bytes]) -> bytes:
        """Return the object code of an IR text from the cache, or from `compiled()`.

        `how` names the compile options.
        """
        key = hashlib.sha256(f"{how}\n{text}".encode()).digest()
        with self._lock:
            if key in self._codes:
                self._codes.move_to_end(key)
                return self._codes[key]
        code = compiled()  # No lock is held here: two threads that compile the same text get the same code.
        with self._lock:
            if key not in self._codes:
                self._codes[key] = code
                self._taken += len(code)
            while self._taken > self._room:
                _, oldest = self._codes.popitem(last=False)
                self._taken -= len(oldest)
        return code
