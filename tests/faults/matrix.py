"""All faults, and the results of methods on them."""

from collections.abc import Iterator, Sequence

from tests.faults.fault import Cell, Fault, take
from tests.faults.motions import CONTACTS, MOTIONS, MOVED
from tests.faults.requests import EVENTS, REQUESTS

FAULTS: tuple[Fault, ...] = (*MOTIONS, *EVENTS, *REQUESTS, *MOVED, *CONTACTS)


def cells(methods: Sequence[str], faults: Sequence[Fault] = FAULTS) -> Iterator[Cell]:
    """Yield the result of each method on each fault, fault by fault."""
    for fault in faults:
        for method in methods:
            yield take(fault, method)
