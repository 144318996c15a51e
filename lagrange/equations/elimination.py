"""The order in which the unknowns of a sparse symmetric system are eliminated, so that few zeros fill in.

The unknown with the fewest others beside it goes first (minimum degree). A multiplier has no diagonal entry of its own:
it goes once all coordinates of its constraint are gone, when its pivot is -G M^-1 G^T of these, which no configuration
makes zero unless the constraints are dependent there.
Source: A. George, J. W. H. Liu, The evolution of the minimum degree ordering algorithm, SIAM Review 31, 1989; R. J.
Vanderbei, Symmetric quasidefinite matrices, SIAM J. Optimization 5, 1995.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

Neighbours = Sequence[Collection[int]]
"""For each unknown those that stand in its row of the matrix."""


def elimination_order(block: Sequence[int], neighbours: Neighbours, multipliers: Collection[int]) -> tuple[int, ...]:
    """Return the unknowns of a block in the order of their elimination."""
    held = frozenset(multipliers)
    beside = {i: {j for j in neighbours[i] if j != i} for i in block}
    waits = {i: sum(j not in held for j in beside[i]) if i in held else 0 for i in block}
    left = dict.fromkeys(block)
    order: list[int] = []
    while left:
        chosen = min((i for i in left if not waits[i]), key=lambda i: (len(beside[i]), i))
        del left[chosen]
        order.append(chosen)
        others = beside.pop(chosen)
        for i in others:
            beside[i].discard(chosen)
            beside[i].update(j for j in others if j != i)
            if chosen not in held and i in held and chosen in neighbours[i]:
                waits[i] -= 1
    return tuple(order)
