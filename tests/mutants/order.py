"""Selection and order of the tests for a mutant: tests that call its function, nearest and cheapest first."""

from collections.abc import Sequence
from dataclasses import dataclass

from tests.mutants.mutate import Mutant

SHARES = (0.3, 0.35, 0.35)
"""How the time for a mutant is divided among its own test file, its folder and the others; what is left goes on."""


FEW = 10
"""Where fewer tests than this call a function it runs on import, and any test may depend on it."""


@dataclass(frozen=True)
class Reached:
    """A test, its processor seconds, and the functions that it calls, as file:qualified name."""

    test: str
    seconds: float
    functions: frozenset[str]


def calls(mutant: Mutant, test: Reached) -> bool:
    """Return True if a test calls the function of a mutant, or uses its file if the change is at module level."""
    return f"{mutant.file}:{mutant.function}" in test.functions


def distance(mutant: Mutant, test: str) -> int:
    """Return 0 for the test file with the name of the mutant's file, 1 for the same folder, and 2 for others."""
    parts, name = mutant.file.split("/"), test.partition("::")[0]
    if name == f"tests/{parts[1]}/test_{parts[-1].removeprefix('llvm_').removeprefix('interpreted_')}":
        return 0
    return 1 if name.startswith(f"tests/{parts[1]}/") else 2


def chosen(mutant: Mutant, tests: Sequence[Reached], budget: float) -> dict[str, float]:
    """Return the tests for a mutant with their seconds, in order, within a budget of seconds.

    Tests that call its function come first. The other tests of these files follow, since they may use cached results
    of the function. Of a parametrized test the cheapest case comes first, and its other cases after the first cases
    of other tests.
    """
    direct = {test.test for test in tests if calls(mutant, test)}
    if not direct:
        direct = {test.test for test in tests if any(name.startswith(f"{mutant.file}:") for name in test.functions)}
    files = {test.test.partition("::")[0] for test in tests if len(direct) < FEW or test.test in direct}
    order: dict[str, float] = {}
    left = 0.0
    for expected, share in enumerate(SHARES):
        left += share * budget
        examples: dict[str, int] = {}
        ranked = []
        for test in sorted(tests, key=lambda test: test.seconds):
            if test.test.partition("::")[0] in files and distance(mutant, test.test) == expected:
                name = test.test.partition("[")[0]
                examples[name] = examples.get(name, 0) + 1
                ranked.append((test.test not in direct, examples[name], test.seconds, test.test))
        for _, _, seconds, name in sorted(ranked):
            if seconds <= left:
                order[name] = seconds
                left -= seconds
    return order
