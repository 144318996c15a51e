"""The order in which the unknowns of a sparse symmetric system are eliminated, so that few zeros fill in.

The unknown with the fewest others beside it goes first (minimum degree). A multiplier has no diagonal entry of its own:
it goes once all coordinates of its constraint are gone, when its pivot is -G M^-1 G^T of these, which no configuration
makes zero unless the constraints are dependent there.
Source: A. George, J. W. H. Liu, The evolution of the minimum degree ordering algorithm, SIAM Review 31, 1989; R. J.
Vanderbei, Symmetric quasidefinite matrices, SIAM J. Optimization 5, 1995; E. Cuthill, J. McKee, Reducing the bandwidth
of sparse symmetric matrices, Proc. 24th Nat. Conf. ACM, 1969.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

Neighbours = Sequence[Collection[int]]
"""For each unknown those that stand in its row of the matrix."""


def band_order(neighbours: Neighbours) -> list[int]:
    """Return the unknowns of a system so that neighbours stand close to each other (Cuthill, McKee).

    They are ordered by their distance from an unknown at one end, in whatever order they were stated.
    """
    order: list[int] = []
    left = dict.fromkeys(range(len(neighbours)))

    def degree(i: int) -> int:
        return len(neighbours[i])

    while left:
        end, depth, levels = min(left, key=degree), 0, list[list[int]]()
        while not levels or len(levels) > depth:
            depth, levels = len(levels), _levels(end, neighbours)
            end = min(levels[-1], key=degree)
        for i in (i for level in levels for i in level):
            del left[i]
            order.append(i)
    return order


def _levels(root: int, neighbours: Neighbours) -> list[list[int]]:
    """Return the unknowns by their distance from one, in each level those with few neighbours first."""
    levels, seen = [[root]], {root}
    while True:
        level: list[int] = []
        for i in levels[-1]:
            fresh = sorted((j for j in neighbours[i] if j not in seen), key=lambda j: (len(neighbours[j]), j))
            seen.update(fresh)
            level += fresh
        if not level:
            return levels
        levels.append(level)


def elimination_order(block: Sequence[int], neighbours: Neighbours, multipliers: Collection[int]) -> tuple[int, ...]:
    """Return the unknowns of a block in the order of their elimination; in doubt from one end of the system on."""
    place = {unknown: i for i, unknown in enumerate(block)}
    ends = band_order([[place[j] for j in neighbours[i]] for i in block])
    rank = {block[i]: k for k, i in enumerate(ends)}
    held = frozenset(multipliers)
    beside = {i: {j for j in neighbours[i] if j != i} for i in block}
    waits = {i: sum(j not in held for j in beside[i]) if i in held else 0 for i in block}
    left, depth = dict.fromkeys(block), dict.fromkeys(block, 0)
    order: list[int] = []
    while left:
        chosen = min((i for i in left if not waits[i]), key=lambda i: (len(beside[i]), depth[i], rank[i]))
        del left[chosen]
        order.append(chosen)
        others = beside.pop(chosen)
        for i in others:
            depth[i] = max(depth[i], depth[chosen] + 1)
            beside[i].discard(chosen)
            beside[i].update(j for j in others if j != i)
            if chosen not in held and i in held and chosen in neighbours[i]:
                waits[i] -= 1
    return tuple(order)
