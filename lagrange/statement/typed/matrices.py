r"""Vector equations: each row of \begin{pmatrix} ... \end{pmatrix} becomes a separate equation.

A vector equation contains columns, and products of matrices with columns. In the equation of a row, each of them is
replaced by its entry in this row, in brackets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from lagrange.statement.typed.grammar import TypedFault
from lagrange.statement.typed.latex import CELL, MATRIX, MATRIX_END, ROW
from lagrange.statement.typed.tokens import Token, bracketed

MOST_TOKENS = 4_000  # Most tokens of a product of matrices, which repeats their entries
Matrix = list[list[list[Token]]]  # The tokens of each entry, by rows


def rows_of(equations: Sequence[Sequence[Token]]) -> list[list[Sequence[Token]]]:
    """Return the rows of each vector equation, as scalar equations; one without a matrix is its only row.

    Equations are lists of tokens. An equation between a name and a matrix defines the name for the other equations,
    and has no rows. Raises TypedFault for matrices that do not fit.
    """
    named: dict[str, Matrix] = {}
    for tokens in equations:
        if _defines(tokens):
            named[tokens[0].text] = _matrix(tokens, 2)[0]
    return [[] if _defines(tokens) else _rows(_with_names(tokens, named)) for tokens in equations]


def _defines(tokens: Sequence[Token]) -> bool:
    """Return True for an equation between a name and one matrix."""
    matrices = [i for i, token in enumerate(tokens) if token.is_sign(MATRIX)]
    return matrices == [2] and tokens[0].kind == "word" and tokens[1].is_sign("=") and tokens[-1].is_sign(MATRIX_END)


def _matrix(tokens: Sequence[Token], start: int) -> tuple[Matrix, int]:
    """Return the matrix that begins at index `start`, and the next index. Raises TypedFault for an empty entry."""
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


def _with_names(tokens: Sequence[Token], named: Mapping[str, Matrix]) -> list[Token]:
    """Return the tokens of an equation with matrices in place of the names in `named`.

    A derivative of a name applies to each entry of its matrix.
    """
    replaced: list[Token] = []
    for token in tokens:
        if token.kind != "word" or token.text not in named:
            replaced.append(token)
            continue
        order = token.order + token.primes
        for i, row in enumerate(named[token.text]):
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
            raise TypedFault(f"a column has {len(column)} rows, and one before it {size}", begin.begin)
        size = len(column)
        parts.append(column)
    rows: list[Sequence[Token]] = [
        [token for part in parts for token in ([part] if isinstance(part, Token) else part[k])] for k in range(size)
    ]
    return rows or [tokens]


def _column(factors: Sequence[Matrix], begin: Token) -> list[list[Token]]:
    """Return the entries of `factors`: a column, or a product of matrices with a column. Raises TypedFault otherwise.

    `begin` is the token at which the fault is located.
    """
    *others, last = factors
    column = [[token for entry in row for token in entry] for row in last if len(row) == 1]
    fits = len(column) == len(last)
    for matrix in reversed(others):
        fits = fits and all(len(row) == len(column) for row in matrix)
        column = [
            _sum([[*bracketed(a), _sign("*", b[0]), *bracketed(b)] for a, b in zip(row, column, strict=fits)])
            for row in matrix
        ]
        if sum(map(len, column)) > MOST_TOKENS:
            raise TypedFault("the product of matrices is too long: multiply it out", begin.begin)
    if not fits:
        raise TypedFault("matrices that do not fit: expected is a column, or matrices times a column", begin.begin)
    return [bracketed(entry) for entry in column]


def _sum(terms: Sequence[list[Token]]) -> list[Token]:
    """Return the tokens of a sum of terms, without the terms that have a factor 0."""
    ends = [["".join(token.text for token in end) for end in (term[:3], term[-3:])] for term in terms]
    kept = [term for term, factors in zip(terms, ends, strict=True) if "(0)" not in factors] or terms[:1]
    return [token for term in kept for token in (_sign("+", term[0]), *term)]


def _sign(mark: str, token: Token) -> Token:
    return Token("sign", mark, token.begin, token.end)
