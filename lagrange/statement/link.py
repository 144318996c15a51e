"""What is drawn between two named points."""

from __future__ import annotations

from typing import NamedTuple

ROD, SPRING = "rod", "spring"
KINDS = (ROD, SPRING)


class Link(NamedTuple):
    """A line from one named point to another, drawn as a rod or as a spring. It exerts no force."""

    start: str
    end: str
    kind: str = ROD
