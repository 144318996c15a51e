"""Outcome of every fault with every registered method.

python docs/benchmarks/faults.py
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor

from measure import FOLDER, Page

import lagrange as lg

sys.path.insert(0, str(FOLDER.parents[1]))

from tests.faults.fault import FAILED, SOUND, Cell, Fault
from tests.faults.matrix import FAULTS, cells

LONGEST = 260
"""Characters of a message that are shown."""


def one(index: int) -> list[Cell]:
    """Return the cells of a fault."""
    return list(cells(lg.methods.names(), [FAULTS[index]]))


def short(message: str) -> str:
    """Return the beginning of a message, as a cell of a table."""
    words = " ".join(message.split()).replace("|", "\\|")
    return words if len(words) <= LONGEST else words[: words.rindex(" ", 0, LONGEST)] + " ..."


def totals(page: Page, found: Sequence[Cell]) -> None:
    """Add the totals, by method."""
    verdicts = (*SOUND, *FAILED)
    count = Counter((cell.method, cell.verdict) for cell in found)
    whole = Counter(cell.verdict for cell in found)
    failures = ", ".join(f"{whole[verdict]} {verdict}" for verdict in FAILED)
    page.text(f"**{len(found)} cells: {failures}.** {', '.join(f'{whole[verdict]} {verdict}' for verdict in SOUND)}.")
    rows = [(f"`{name}`", *(count[name, verdict] or "" for verdict in verdicts)) for name in lg.methods.names()]
    page.table(("method", *verdicts), [*rows, ("all", *(whole[verdict] for verdict in verdicts))])


def section(page: Page, fault: Fault, found: Iterable[Cell]) -> None:
    """Add what came of a fault: for each outcome the methods, and the message of the first."""
    page.text(f"## {fault.name}\n\n{fault.about[0].upper()}{fault.about[1:]}.")
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in found:
        status = cell.status if cell.verdict in ("ended", *FAILED) else ""
        groups.setdefault((cell.verdict, status), []).append(cell)
    page.table(
        ("outcome", "status", "methods", "such as"),
        [
            (
                f"**{verdict}**" if verdict in FAILED else verdict,
                status,
                ", ".join(cell.method for cell in group),
                short(group[0].detail),
            )
            for (verdict, status), group in groups.items()
        ],
    )


def main() -> None:
    """Run, print and write the page."""
    page = Page("Faults", __file__)
    with ProcessPoolExecutor() as pool:
        rows = list(pool.map(one, range(len(FAULTS))))
    totals(page, [cell for row in rows for cell in row])
    for fault, row in zip(FAULTS, rows, strict=True):
        section(page, fault, row)
    page.write()


if __name__ == "__main__":
    main()
