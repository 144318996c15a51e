"""Lines of source text that are short enough."""

from __future__ import annotations


def continued(line: str, room: int, mark: str) -> list[str]:
    """Return a statement on lines of so many characters; those that go on end with a mark."""
    indent, lines = " " * (len(line) - len(line.lstrip()) + 4), []
    while len(line) > room:
        cut = line.rfind(" ", len(indent), room - len(mark))
        if cut < 0:
            break
        lines.append(f"{line[:cut]} {mark}")
        line = indent + line[cut + 1 :]
    return [*lines, line]
