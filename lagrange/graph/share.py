"""Rewriting of long sums in terms of the shorter sums that they contain.

In a chain of links, the position of link k is stated as a sum of k terms. SymPy flattens each of these sums, so they
overlap without sharing a node, and every derivative repeats their terms. Here S = a + b + c + d becomes P + d where
P = a + b + c is a separate sum: cost falls from quadratic to linear in the length of the chain, in every derivative as
well.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from lagrange.graph.node import Exact, Graph, Kind, Node, exact, reachable, rebuild


@dataclass(frozen=True)
class _Split:
    """A sum that contains another one: `ratio` times the sum `part`, plus the terms of `rest`."""

    ratio: Exact
    part: Node
    rest: tuple[tuple[Exact, Node], ...]


def share_sums(graph: Graph, outputs: Sequence[Node]) -> list[Node]:
    """Return the outputs rebuilt so that a sum refers to the longest other sum whose terms it contains."""
    order = reachable(outputs)
    splits = _splits([node for node in order if node.kind is Kind.SUM and len(node.args) > 1])
    if not splits:
        return list(outputs)
    built: dict[Node, Node] = {}
    for node in order:
        for part in _unbuilt_parts(node, splits, built):
            if part in splits:
                split = splits[part]
                rest = [(c, built[term]) for c, term in split.rest]
                built[part] = graph.sum([(split.ratio, built[split.part]), *rest], part.data[0])
            else:
                built[part] = rebuild(part, [built[arg] for arg in part.args])
    return [built[node] for node in outputs]


def _unbuilt_parts(node: Node, splits: dict[Node, _Split], built: dict[Node, Node]) -> list[Node]:
    """Return a sum, the sum that it contains, the sum that this one contains, and so on, shortest first.

    `splits` has the contained sum of each sum that has one. The chain ends before a sum that is already in `built`.
    """
    chain: list[Node] = []
    while node not in built:
        chain.append(node)
        if node not in splits:
            break
        node = splits[node].part
    return chain[::-1]


def _splits(sums: list[Node]) -> dict[Node, _Split]:
    """Return {sum: its split into a multiple of the longest other sum that it contains, and the other terms}.

    The contained sum has no constant. A sum that contains no other one is left out.
    """
    spread = Counter(term for node in sums for term in node.args)
    # Each sum is looked up by its rarest term: a term of every sum would pair all with all.
    by_rarest: dict[Node, list[Node]] = {}
    splits: dict[Node, _Split] = {}
    for node in sorted(sums, key=lambda s: (len(s.args), s.id)):
        terms = dict(zip(node.args, node.data[1], strict=True))
        parts = [part for term in terms for part in by_rarest.get(term, ())]
        for part in sorted(parts, key=lambda p: (-len(p.args), p.id)):
            split = _split(terms, part)
            if split is not None:
                splits[node] = split
                break
        if node.data[0] == 0:
            by_rarest.setdefault(min(node.args, key=spread.__getitem__), []).append(node)
    return splits


def _split(terms: dict[Node, Exact], part: Node) -> _Split | None:
    """Write a sum {node: coefficient} as a multiple of the sum `part`, plus a rest; None if that is not possible."""
    if any(term not in terms for term in part.args):
        return None
    coefficients = dict(zip(part.args, part.data[1], strict=True))
    ratio = Fraction(terms[part.args[0]]) / coefficients[part.args[0]]
    if any(terms[term] != ratio * c for term, c in coefficients.items()):
        return None
    rest = tuple((c, term) for term, c in terms.items() if term not in coefficients)
    return _Split(exact(ratio), part, rest)
