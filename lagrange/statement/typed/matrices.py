r"""Divide typed vector equations into scalar ones: rows of \begin{pmatrix} ... \end{pmatrix}, and lengths |r|.

A vector equation contains columns, and products of matrices with columns. In the equation of a row, the entry of the
row, in brackets, replaces each column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise, takewhile

from lagrange.statement.typed.grammar import TypedFault
from lagrange.statement.typed.names import Names
from lagrange.statement.typed.respelling import CELL, MATRIX, MATRIX_END, ROW
from lagrange.statement.typed.tokens import Token, bracketed, closing

MOST_TOKENS = 4_000  # Largest number of tokens of a product of matrices, which repeats their entries
Matrix = list[list[list[Token]]]  # Rows of entries. Each entry is a list of tokens.
_VECTOR = re.compile(r"([rv])(_?\w{0,8})")  # Matches the name of a position r or a velocity v, and its subscript


def rows_of(equations: Sequence[Sequence[Token]], names: Names) -> list[list[Sequence[Token]]]:
    """Return the rows of each vector equation as scalar equations. An equation without a matrix is its only row.

    Equations are lists of tokens. An equation between a name and a matrix defines the name for the other equations, and
    has no rows. An unknown name after the name of a matrix, as q in M q, is the column of all coordinates. Raises
    TypedFault for matrices that do not fit.
    """
    named: dict[tuple[str, ...], Matrix] = {}
    for tokens in equations:
        if _defines(tokens):
            name = tuple(token.text for token in takewhile(lambda token: not token.is_sign("="), tokens))
            named[name] = _matrix(tokens, len(name) + 1)[0]
    column = [[[Token("word", base, 0, 0)]] for base in names.bases]
    for left, right in (pair for tokens in equations for pair in pairwise(tokens)):
        factor = named.get((left.text,), [])
        unknown = right.kind == "word" and (right.text,) not in named and not names.readings(right.text)
        if factor and unknown and len(factor[0]) == len(column):
            named[(right.text,)] = column
    return [[] if _defines(tokens) else _rows(_with_names(tokens, named)) for tokens in equations]


def _defines(tokens: Sequence[Token]) -> bool:
    """Return True for an equation between a name, such as M or M(q), and one matrix."""
    matrices = [i for i, token in enumerate(tokens) if token.is_sign(MATRIX)]
    if len(matrices) != 1 or not tokens[-1].is_sign(MATRIX_END):
        return False
    name, equality = tokens[: matrices[0] - 1], tokens[matrices[0] - 1]
    if not name or name[0].kind != "word" or not equality.is_sign("="):
        return False
    return len(name) == 1 or (name[1].is_sign("(") and closing(name, 1) == len(name) - 1)


def _matrix(tokens: Sequence[Token], start: int) -> tuple[Matrix, int]:
    """Return the matrix that begins at index `start`, and the index after it. Raises TypedFault for an empty entry."""
    matrix: Matrix = [[[]]]
    for i in range(start + 1, len(tokens)):
        if tokens[i].is_sign(ROW):
            matrix.append([[]])
        elif tokens[i].is_sign(CELL):
            matrix[-1].append([])
        elif not tokens[i].is_sign(MATRIX, MATRIX_END):
            matrix[-1][-1].append(tokens[i])
        elif tokens[i].is_sign(MATRIX_END) and all(entry for row in matrix for entry in row):
            return matrix, i + 1
        else:
            break
    raise TypedFault("a matrix has no end, or an entry that is empty or a matrix", tokens[start].begin)


def _with_names(tokens: Sequence[Token], named: Mapping[tuple[str, ...], Matrix]) -> list[Token]:
    """Return the tokens of an equation with matrices in place of their names.

    `named` has the matrices by name. A name is a tuple of texts of tokens, such as ("M", "(", "q", ")"). A derivative
    of a name applies to each entry of its matrix.
    """
    replaced: list[Token] = []
    after = 0
    for index, token in enumerate(tokens):
        if index < after:
            continue
        texts = tuple(other.text for other in tokens[index:])
        name = max((name for name in named if texts[: len(name)] == name), key=len, default=())
        after = index + len(name)
        if token.kind != "word" or not name:
            replaced.append(token)
            continue
        order = token.order + token.primes
        for i, row in enumerate(named[name]):
            for j, entry in enumerate(row):
                mark = CELL if j else ROW if i else MATRIX
                rate = [Token("rate", str(order), token.begin, token.end)] if order else []
                inside = bracketed(entry) if order else entry
                moved = [replace(part, begin=token.begin, end=token.end) for part in inside]
                replaced += [_sign(mark, token), *rate, *moved]
        replaced.append(_sign(MATRIX_END, token))
    return replaced


def _rows(tokens: Sequence[Token]) -> list[Sequence[Token]]:
    """Return the rows of a vector equation as equations. Raises TypedFault if its columns differ in length."""
    parts: list[Token | list[list[Token]]] = []
    index = size = 0
    while index < len(tokens):
        begin, factors = tokens[index], list[Matrix]()
        while index < len(tokens) and tokens[index].is_sign(MATRIX):
            matrix, index = _matrix(tokens, index)
            factors.append(matrix)
            index += [token.text for token in tokens[index : index + 2]] == ["*", MATRIX]
        if not factors:
            parts.append(begin)
            index += 1
            continue
        column = _column(factors, begin)
        if index < len(tokens) and (tokens[index].is_sign("^") or tokens[index].kind == "power"):
            raise TypedFault("a column has no powers", tokens[index].begin)
        if size not in (0, len(column)):
            raise TypedFault(f"a column has {len(column)} rows, and the column before it {size}", begin.begin)
        size = len(column)
        parts.append(column)
    rows: list[Sequence[Token]] = [
        [token for part in parts for token in ([part] if isinstance(part, Token) else part[k])] for k in range(size)
    ]
    return rows or [tokens]


def _column(factors: Sequence[Matrix], begin: Token) -> list[list[Token]]:
    """Return the entries of a column or of its product with matrices, each entry as a list of tokens.

    `factors` are the matrices, if any, and last the column. Raises TypedFault, located at the token `begin`, if their
    sizes do not fit or the product is too long.
    """
    *others, last = factors
    column, width = [row[0] for row in last], 1
    for matrix in (last, *reversed(others)):
        if any(len(row) != width for row in matrix):
            raise TypedFault("matrices that do not fit: expected is a column, or matrices times a column", begin.begin)
        width = len(matrix)
    for matrix in reversed(others):
        pairs = [zip(row, column, strict=True) for row in matrix]
        column = [_sum([[*bracketed(a), _sign("*", b[0]), *bracketed(b)] for a, b in row]) for row in pairs]
        if sum(map(len, column)) > MOST_TOKENS:
            raise TypedFault("the product of matrices is too long: multiply it out", begin.begin)
    return [bracketed(entry) for entry in column]


def _sum(terms: Sequence[list[Token]]) -> list[Token]:
    """Return the tokens of a sum of terms, without the terms that have a factor 0."""
    ends = [["".join(token.text for token in end) for end in (term[:3], term[-3:])] for term in terms]
    kept = [term for term, factors in zip(terms, ends, strict=True) if "(0)" not in factors] or terms[:1]
    return [token for term in kept for token in (_sign("+", term[0]), *term)]


def without_bars(equations: Sequence[Sequence[Token]], names: Names) -> list[list[Token]]:
    """Return equations with the lengths |r|, |v|, |r1 - r2| of vectors written out in Cartesian coordinates.

    |r| is r if an equation defines r or |r|. Otherwise the coordinates must be x and y, and possibly z, with the
    subscript of r.
    """
    defined = {word for tokens in equations for word in _lone_words(tokens)}
    results = []
    for tokens in equations:
        written: list[Token] = []
        index = 0
        while index < len(tokens):
            end = next((k for k in range(index + 1, len(tokens)) if tokens[k].is_sign("|")), len(tokens))
            length: list[Token] = []
            if tokens[index].is_sign("|") and end < len(tokens):
                inside = list(tokens[index + 1 : end])
                unknown = [token for token in inside if token.kind == "word" and not names.readings(token.text)]
                lone = len(inside) == 1 and inside[0].text in defined
                length = [] if not unknown else inside if lone else _length(inside, names)
            written += length or [tokens[index]]
            index = end + 1 if length else index + 1
        results.append(written)
    return results


def _lone_words(tokens: Sequence[Token]) -> Iterator[str]:
    """Yield the word of each side of an equation that is a single word, such as r or |r|."""
    for equal, side in groupby(tokens, lambda token: token.is_sign("=")):
        words = [token for token in side if not token.is_sign("|")]
        if not equal and len(words) == 1 and words[0].kind == "word" and not (words[0].order or words[0].primes):
            yield words[0].text


def _length(vector: Sequence[Token], names: Names) -> list[Token]:
    """Return the length of a vector, such as r1 - r2, in Cartesian coordinates. Return [] without such coordinates."""
    squares: list[Token] = []
    for axis in "xyz":
        part: list[Token] = []
        for token in vector:
            match = _VECTOR.fullmatch(token.text) if token.kind == "word" else None
            if match is None and not token.is_sign("+", "-"):
                return []
            word = axis + match.group(2) if match else token.text
            if match and not names.readings(word):
                part = []
                break
            order = 1 if match and match.group(1) == "v" else 0
            part.append(replace(token, text=word, primes=token.primes + order))
        if part:
            sign = [_sign("+", part[0])] if squares else []
            squares += [*sign, *bracketed(part), _sign("^", part[0]), replace(_sign("2", part[0]), kind="number")]
        elif axis != "z":
            return []
    return bracketed([_sign("sqrt", vector[0]), *bracketed(squares)])


def _sign(mark: str, token: Token) -> Token:
    """Return the sign `mark` as a token, at the position of `token`."""
    return Token("sign", mark, token.begin, token.end)
