"""Parser of a typed formula: tokens become the strict notation of scene files, with products and brackets written out.

Some texts have several readings: `g/2l`, `sin a b`, `sin x^2`, and a word that is a product in two ways. At each such
place the parser takes an option from `Choices`. Another pass with other options gives another reading. `faults_of`
finds unknown words, impossible derivatives and unmatched brackets before the parser runs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice, product, zip_longest

from lagrange.statement.typed.conditions import Condition, compared, cover
from lagrange.statement.typed.names import Names, Piece
from lagrange.statement.typed.remarks import WORD, kind_of
from lagrange.statement.typed.respelling import ROW
from lagrange.statement.typed.tokens import OPENING, ORDERS, Token

DEEPEST = 40  # Largest number of levels of brackets, functions, fractions and exponents; the parser is recursive
MOST_COMPARISONS = 8  # Largest number of comparisons of a condition
MOST_READINGS = 12  # Largest number of readings of one text that are tried

SUM, PRODUCT, POWER, ATOM = range(4)

# Matches the name of a constant angle, such as alpha or theta_0, at the end of the argument of a function
_ANGLE = re.compile(r"\b(?:alpha|beta|gamma|delta|theta|phi|psi|chi)_?[0-9]*$")

_DIFFERENTIAL = re.compile(r"d[A-Z]\w*")  # Matches the differential of a function, such as dV in dV/dx


class TypedFault(Exception):
    """Fault in a typed text: its `reason`, a sentence without the final period, and its `offset` in the text.

    `read` is the part of the equation before the fault, in the notation of scene files, or "". `others` are further
    faults.
    """

    def __init__(self, reason: str, offset: int) -> None:
        super().__init__(reason)
        self.reason, self.offset, self.read = reason, offset, ""
        self.others = list[TypedFault]()


class UnknownWord(TypedFault):
    """Fault: a word is neither a symbol of the system nor a product of symbols."""


def faults_of(tokens: Sequence[Token], names: Names) -> list[TypedFault]:
    """Return the faults of a formula that are found before parsing, sorted by their offsets.

    Such faults are unreadable characters, unknown words, impossible derivatives and unmatched brackets.
    """
    faults, opened = list[TypedFault](), list[Token]()
    for token, following in zip_longest(tokens, tokens[1:]):
        name = repr(token.text[:60])
        if token.is_sign(*OPENING):
            opened.append(token)
        elif token.is_sign(*OPENING.values()):
            if not opened or OPENING[opened.pop().text] != token.text:
                faults.append(TypedFault(f"{token.text!r} closes nothing", token.begin))
        elif token.kind == "fault":
            faults.append(TypedFault(token.text, token.begin))
        elif token.kind == "index":
            faults.append(TypedFault("a subscript follows no symbol", token.begin))
        elif token.kind == "word":
            powered = following is not None and (following.is_sign("^") or following.kind == "power")
            readings = [r for r in names.readings(token.text) if powered or all(piece.kind != "e" for piece in r)]
            if not readings:
                hint = names.hint(token.text)
                if not hint and kind_of(token.text) == WORD:  # a word of a sentence, not a Greek letter
                    hint = " Write a remark after '#'."
                elif not hint and _DIFFERENTIAL.fullmatch(token.text):
                    hint = " Write the derivative out."
                faults.append(UnknownWord(f"{name} is not a symbol of this system.{hint}", token.begin))
            elif not differentiated(readings, token, names):
                faults.append(TypedFault(f"{name} has no derivative of this order here", token.begin))
    faults += [TypedFault(f"{token.text!r} is never closed", token.begin) for token in opened]
    return sorted(faults, key=lambda fault: fault.offset)


def differentiated(readings: list[list[Piece]], token: Token, names: Names) -> list[list[Piece]]:
    """Return the readings of a word with its dots applied to the first factor and its primes to the last one.

    `token` is the word with its dots and primes. Each reading is a list of factors. A reading is left out if one of its
    symbols has no such derivative.
    """
    results = []
    for pieces in readings:
        changed: list[Piece | None] = [*pieces]
        for index, order in ((0, token.order), (-1, token.primes)):
            piece = changed[index]
            changed[index] = names.derivative(piece, order) if piece and order else piece
        if None not in changed:
            results.append([piece for piece in changed if piece])
    return results


@dataclass(frozen=True)
class Part:
    """Part of a formula in the strict notation of scene files.

    `level` is its outermost operation: SUM, PRODUCT, POWER or ATOM. `number` is true for constants. `moves` is true if
    the part contains a coordinate, a velocity or t.
    """

    text: str
    level: int = ATOM
    number: bool = False
    moves: bool = False

    def at(self, level: int) -> str:
        """Return the text of the part, in brackets if its outermost operation binds weaker than `level`."""
        return self.text if self.level >= level else f"({self.text})"


@dataclass
class Choices:
    """Decisions between the possible readings of an ambiguous text, such as g/2l, which is g/(2l) or (g/2)l.

    Each kind of ambiguity has a name, such as "division joined". `chosen` maps such names to the index of the reading
    that the parser takes: 0, the likeliest one, if a name is missing. `asked` maps the name of each ambiguity that the
    parser met to its number of readings.
    """

    chosen: dict[str, int] = field(default_factory=dict)
    asked: dict[str, int] = field(default_factory=dict)

    def take(self, choice: str, count: int) -> int:
        """Return the index of the option taken in a choice. Record `count`, the number of options of this choice."""
        self.asked[choice] = max(count, self.asked.get(choice, 0))
        return min(self.chosen.get(choice, 0), count - 1)

    def others(self) -> list[dict[str, int]]:
        """Return sets of options that give other readings, sorted by the number of options that are not the default.

        Each set is a value for `chosen`: {choice: index of an option}.
        """
        open_choices = {choice: count for choice, count in self.asked.items() if count > 1}
        every = product(*(range(count) for count in open_choices.values()))
        listed = [dict(zip(open_choices, options, strict=True)) for options in islice(every, 1, 256)]
        return sorted(listed, key=lambda chosen: sum(map(bool, chosen.values())))[: MOST_READINGS - 1]


@dataclass
class Formula:
    """One reading of a formula in the strict notation of scene files, in which a new name replaces each d/dt(...).

    `rates` maps each new name to (text of the differentiated expression, order of the derivative).
    """

    text: str
    rates: dict[str, tuple[str, int]]

    @property
    def shown(self) -> str:
        """Text of the formula for people, with d/dt(...) in place of each name in `rates`."""
        text = self.text
        for name, (operand, order) in reversed(self.rates.items()):
            sign = "d/dt" if order == 1 else f"d^{order}/dt^{order}"
            text = text.replace(name, f"{sign}({operand})")
        return text

    @property
    def terms(self) -> list[str]:
        """Terms of the outermost sum, texts in the strict notation. Terms with d/dt of an expression are left out."""
        terms, depth = [""], 0
        for piece in re.split(r"( [+-] |[()])", self.text):
            depth += (piece == "(") - (piece == ")")
            if depth == 0 and piece in (" + ", " - "):
                terms.append(piece.strip(" +"))
            else:
                terms[-1] += piece
        return [term for term in terms if not any(name in term for name in self.rates)]


@dataclass(frozen=True)
class _Symbol(Token):
    """Token of a symbol or function of the system. Its meaning is `piece`."""

    piece: Piece = field(default_factory=lambda: Piece(""))


def parsed(tokens: Sequence[Token], names: Names, choices: Choices, taken: int = 0) -> Formula:
    """Return one reading of a formula, with the options in `choices`.

    Raises TypedFault for tokens that are not a formula. `taken` is the number of new names for time derivatives on the
    other sides of the equation.
    """
    expanded: list[Token] = []  # In it, the factors of a product replace the word
    for token in tokens:
        if token.kind != "word":
            expanded.append(token)
            continue
        readings = differentiated(names.readings(token.text), token, names)
        pieces = readings[choices.take(f"word {token.text}", len(readings))]
        for k, piece in enumerate(pieces):
            spaced = token.spaced and k == 0
            expanded.append(_Symbol(piece.kind, piece.name, token.begin, token.end, spaced=spaced, piece=piece))
    parser = _Parser(expanded, choices, names, taken)
    part = parser.sum()
    if parser.index < len(parser.tokens):
        token = parser.tokens[parser.index]
        raise TypedFault(f"{token.text[:40]!r} cannot stand here", token.begin)
    return Formula(part.text, parser.rates)


class _Parser:
    """Recursive-descent parser of one side of an equation. Each method reads one part, and moves `index` after it."""

    def __init__(self, tokens: list[Token], choices: Choices, names: Names, taken: int) -> None:
        self.tokens, self.choices, self.names, self.taken = tokens, choices, names, taken
        self.index = self.depth = self.bars = 0
        self.rates: dict[str, tuple[str, int]] = {}

    def peek(self, ahead: int = 0) -> Token | None:
        """Return the token `ahead` places after the current one, or None beyond the end."""
        index = self.index + ahead
        return self.tokens[index] if index < len(self.tokens) else None

    def next_is(self, *signs: str) -> bool:
        """Return True if the current token is one of these signs."""
        token = self.peek()
        return token is not None and token.is_sign(*signs)

    def fault(self, reason: str) -> TypedFault:
        """Return a fault with this reason, located at the current token."""
        token = self.peek()
        return TypedFault(reason, token.begin if token else self.tokens[-1].end if self.tokens else 0)

    def sum(self) -> Part:
        """Read a sum: terms with + and - between them."""
        text, moves = "", False
        while True:
            sign = "-" if self.negative() else "+"
            part = self.product()
            more = self.next_is("+", "-")
            if not (text or more or sign == "-"):
                return part
            moves |= part.moves
            text += (f" {sign} " if text else "-" * (sign == "-")) + part.at(PRODUCT)
            if not more:
                return Part(text, SUM, moves=moves)

    def negative(self) -> bool:
        """Read the signs + and - before a value, and return True if their product is negative."""
        negative = False
        while self.next_is("+", "-"):
            negative ^= self.tokens[self.index].text == "-"
            self.index += 1
        return negative

    def product(self) -> Part:
        """Read a product: factors with *, / or nothing between them."""
        left = self.factor()
        while True:
            if self.next_is("*"):
                self.index += 1
                left = _times(left, self.signed())
            elif self.next_is("/"):
                self.index += 1
                left = self.divided(left)
            elif self.starts_value():
                left = _times(left, self.factor())
            else:
                return left

    def signed(self) -> Part:
        """Read a factor that may have signs before it."""
        negative, part = self.negative(), self.factor()
        return Part(f"-{part.at(POWER)}", SUM, part.number, part.moves) if negative else part

    def divided(self, above: Part) -> Part:
        """Read a denominator, and return the quotient of `above` by it.

        `choices` decides if factors that follow belong to the denominator, such as l in g/2l.
        """
        below = self.signed()
        closed = self.tokens[self.index - 1].is_sign(*OPENING.values())
        following = self.peek()
        if following is not None and self.starts_value():
            # In g/2l, l belongs to the denominator. In k/(m l^2)(x - y) and 1/2 m, the following factor does not.
            joined = not following.spaced and not (above.number and below.number) and not closed
            if self.decides(f"division {'joined' if joined else 'apart'}", usual=joined):
                while self.starts_value() and not (joined and self.tokens[self.index].spaced):
                    below = _times(below, self.factor())
        return _times(above, below, "/")

    def decides(self, question: str, *, usual: bool) -> bool:
        """Return `usual` if `choices` has option 0 for the ambiguity named `question`, else the opposite."""
        return usual != bool(self.choices.take(question, 2))

    def starts_value(self) -> bool:
        """Return True if the current token begins a factor."""
        token = self.peek()
        if token is None:
            return False
        if token.kind == "sign":
            return token.text in (*OPENING, "sqrt", "\\frac") or (token.text == "|" and not self.bars)
        return token.kind in ("number", "rate", "operator", "symbol", "function", "e", "pi")

    def factor(self) -> Part:
        """Read a value and its exponent."""
        return self.raised(self.value())

    def raised(self, base: Part) -> Part:
        """Read the exponents and primes after `base`, and return the power or the derivative of `base`."""
        while (token := self.peek()) is not None:
            if token.kind == "prime":
                self.index += 1
                base = self.rate(base, int(token.text), token.begin)
            elif exponent := self.exponent():
                base = Part(f"{base.at(ATOM)}**{exponent.at(ATOM)}", POWER, base.number, base.moves)
            else:
                break
        return base

    def exponent(self) -> Part | None:
        """Read the exponent at the current token, and return it. Return None if there is none."""
        token = self.peek()
        if token is None or not (token.is_sign("^") or token.kind == "power"):
            return None
        self.index += 1
        if token.kind == "power":
            return Part(token.text, SUM if token.text.startswith("-") else ATOM, number=True)
        negative = self.next_is("-")
        self.index += negative
        part = self.value()
        return Part(f"-{part.at(POWER)}", SUM, part.number) if negative else part

    def value(self) -> Part:
        """Read a number, a symbol, a call or a bracketed expression. Raises TypedFault if nested too deeply."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.fault(
                f"more than {DEEPEST} brackets, functions or exponents are nested: write it with fewer levels"
            )
        part = self.opened()
        self.depth -= 1
        return part

    def opened(self) -> Part:
        """Read a number, a symbol, a call, a derivative or an expression in brackets, without the check of nesting."""
        token = self.peek()
        if token is None:
            raise self.fault("a value is missing at the end")
        self.index += 1
        if token.kind == "number":
            if (follower := self.peek()) is not None and follower.kind == "number" and "/" not in follower.text:
                raise self.fault(f"the number {follower.text[:20]} follows a number without a sign")
            return Part(token.text, PRODUCT if "/" in token.text else ATOM, number=True)
        if isinstance(token, _Symbol):
            return self.symbol(token)
        if token.is_sign("\\frac"):
            return _times(self.value(), self.value(), "/")
        if token.kind == "rate":
            return self.rate(self.value(), int(token.text), token.begin)
        if token.kind == "operator":
            return self.rate(self.operand(), int(token.text), token.begin)
        if token.is_sign("sqrt"):
            return self.called("sqrt", [self.value()])
        if token.is_sign(*OPENING):
            return self.inside(token)[0]
        if token.is_sign("|"):
            self.bars += 1
            inside = self.sum()
            self.bars -= 1
            if not self.next_is("|"):
                raise TypedFault("'|' is never closed", token.begin)
            self.index += 1
            return self.called("abs", [inside])
        missing = f"a value is missing before {token.text[:20]!r}"
        raise TypedFault(
            missing if token.kind in ("sign", "number") else "a prime, a dot or an exponent has no symbol", token.begin
        )

    def operand(self) -> Part:
        """Read the operand of d/dt: by default a b in d/dt a b, but a in d/dt (a) b. `choices` may decide otherwise."""
        begin = self.index
        bracket = self.next_is("(", "[", "\\frac")
        part = self.value() if bracket else self.factor()
        more = self.starts_value() or self.next_is("*", "/")
        if more and self.decides("operand", usual=not bracket):
            self.index = begin
            return self.product()
        return part

    def inside(self, opened: Token, *, several: bool = False) -> list[Part]:
        """Read the expression in a bracket and the closing bracket.

        If `several` is true, read expressions between commas. `opened` is the opening bracket, which was read before.
        """
        bars, self.bars = self.bars, 0
        parts = [self.sum()]
        while several and self.next_is(","):
            self.index += 1
            parts.append(self.sum())
        self.bars = bars
        self.expect(OPENING[opened.text])
        return parts

    def expect(self, *signs: str) -> str:
        """Read one of these signs and return it. Raises TypedFault if the current token is another one."""
        if not self.next_is(*signs):
            raise self.fault(f"{' or '.join(map(repr, signs))} is expected")
        self.index += 1
        return self.tokens[self.index - 1].text

    def symbol(self, token: _Symbol) -> Part:
        """Read the rest of a symbol or function call, whose first token was read as `token`."""
        piece = token.piece
        if piece.kind == "function":
            return self.function(piece.name, token)
        if piece.kind == "e":
            exponent = self.exponent()
            return Part("exp(1)") if exponent is None else self.called("exp", [exponent])
        texts = [following.text for following in self.tokens[self.index : self.index + 3]]
        if piece.base and texts in (["(", "t", ")"], ["[", "t", "]"]):
            self.index += 3
        return Part(piece.name, number=piece.kind == "pi", moves=piece.moves)

    def function(self, name: str, token: Token) -> Part:
        """Read the argument of a function, with or without brackets. An exponent may precede it, as in sin^2 x."""
        if name == "Piecewise":
            return self.cases()
        exponent = self.exponent()
        if exponent is not None and exponent.text == "-1" and name in ("sin", "cos", "tan", "sinh", "cosh", "tanh"):
            name, exponent = f"a{name}", None
        if (opened := self.peek()) is not None and opened.is_sign(*OPENING):
            self.index += 1
            value = self.called(name, self.inside(opened, several=True))
        else:
            value = self.called(name, [self.value() if self.next_is("\\frac") else self.bare_argument(token)])
        return value if exponent is None else Part(f"{value.text}**{exponent.at(ATOM)}", POWER, moves=value.moves)

    def cases(self) -> Part:
        """Read the rest of Piecewise((value, condition), ..., (value, True)).

        The mark ROW may stand between two pairs in place of their brackets. The last pair may have a condition, too, if
        the conditions together hold everywhere.
        """
        values, conditions, moves, closed = list[str](), list[Condition](), False, True
        self.expect("(")
        while len(values) == len(conditions) and (not values or self.next_is(",", ROW)):
            if values:
                closed = self.expect(",", ROW) == ","
            if closed:
                self.expect("(")
            value = self.sum()
            values.append(value.text)
            moves |= value.moves
            self.expect(",")
            if (token := self.peek()) is not None and token.text == "True":
                self.index += 1
            else:
                condition, changes = self.condition()
                conditions.append(condition)
                moves |= changes
            if not self.next_is(ROW):
                self.expect(")")
        if len(values) == len(conditions) and not cover(conditions):
            raise self.fault("the cases do not say what holds elsewhere: end with (value, True), or with 'otherwise'")
        self.expect(")")
        text = values[-1]
        for earlier, condition in zip(values[-2::-1], conditions[len(values) - 2 :: -1], strict=True):
            text = f"{earlier} if {condition.text} else {text}"
        return Part(f"({text})", moves=moves)

    def condition(self, *, weak: bool = True) -> tuple[Condition, bool]:
        """Read comparisons with "and" and, if `weak` is true, "or" between them. Return if they change in time, too."""
        condition, moves = self.condition(weak=False) if weak else self.comparison()
        while self.next_is("or" if weak else "and"):
            self.index += 1
            other, changes = self.condition(weak=False) if weak else self.comparison()
            condition = self.bounded(condition.either(other) if weak else condition.both(other))
            moves |= changes
        return condition, moves

    def bounded(self, condition: Condition) -> Condition:
        """Return a condition. Raises TypedFault if it has too many comparisons."""
        if len(condition) > MOST_COMPARISONS:
            raise self.fault(f"a condition has more than {MOST_COMPARISONS} comparisons")
        return condition

    def comparison(self) -> tuple[Condition, bool]:
        """Read a < b, a condition after "not", And(...) or Or(...). Return it, and True if it changes in time."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.fault(f"more than {DEEPEST} brackets stand inside each other")
        if self.next_is("not"):
            self.index += 1
            condition, moves = self.comparison()
            condition = self.bounded(condition.opposite())
        elif self.next_is("and", "or"):
            condition, moves = self.joined()
        else:
            condition, moves = self.compared()
        self.depth -= 1
        return condition, moves

    def joined(self) -> tuple[Condition, bool]:
        """Read the rest of And(condition, ...) or Or(condition, ...)."""
        join = Condition.both if self.expect("and", "or") == "and" else Condition.either
        self.expect("(")
        condition, moves = self.condition()
        while self.next_is(","):
            self.index += 1
            other, changes = self.condition()
            condition, moves = self.bounded(join(condition, other)), moves or changes
        self.expect(")")
        return condition, moves

    def compared(self) -> tuple[Condition, bool]:
        """Read a < b or a < b < c, or else a condition in brackets. Return it, and True if it changes in time."""
        begin = self.index, self.depth, self.bars, dict(self.rates)
        try:
            parts, signs = [self.sum()], [self.expect(*ORDERS)]
            parts.append(self.sum())
        except TypedFault:
            self.index, self.depth, self.bars, self.rates = begin
            if not self.next_is("("):
                raise
            self.index += 1
            condition = self.condition()
            self.expect(")")
            return condition
        while self.next_is(*ORDERS):
            signs.append(self.expect(*ORDERS))
            parts.append(self.sum())
        return compared([part.text for part in parts], signs), any(part.moves for part in parts)

    def bare_argument(self, function: Token) -> Part:
        """Read an argument without brackets: factors up to the first that changes in time, as `2 omega t` or `k x`."""
        negative = self.next_is("-")
        self.index += negative
        if not self.starts_value():
            raise TypedFault(f"the argument of {function.text} is missing", function.begin)
        part = self.bare_factor()
        while self.goes_on(part):
            sign = self.tokens[self.index].text if self.next_is("*", "/") else ""
            self.index += len(sign)
            part = _times(part, self.bare_factor(), sign or "*")
        return Part(f"-{part.at(PRODUCT)}", SUM, moves=part.moves) if negative else part

    def goes_on(self, part: Part) -> bool:
        """Return True if the argument of a function without brackets continues after `part`, as in sin 2 t after 2."""
        token, after = self.peek(), self.peek(1)
        if token is None or token.kind == "function":
            return False
        if part.moves:
            if self.next_is("/") and after is not None and after.kind == "number":
                return self.decides("divided argument", usual=False)
            return self.starts_value() and self.decides("argument", usual=False)
        operator = self.next_is("*", "/") and after is not None and after.kind != "function"
        if part.number or not (operator or self.starts_value()):
            return operator or self.starts_value()
        # The argument of sin omega t has two factors. The arguments of sin alpha x and of cos a/(m + M) have one.
        over_bracket = self.next_is("/") and after is not None and after.is_sign(*OPENING)
        return self.decides("argument of constants", usual=not (_ANGLE.search(part.text) or over_bracket))

    def bare_factor(self) -> Part:
        """Read a factor of a function's argument without brackets, such as x in sin x^2.

        If the factor changes in time, `choices` decides if the exponent belongs to it: sin(x^2) or (sin x)^2.
        """
        part = self.value()
        powered = (token := self.peek()) is not None and (token.is_sign("^") or token.kind == "power")
        if part.moves and powered and not self.decides("power of an argument", usual=True):
            return part
        return self.raised(part)

    def called(self, name: str, arguments: list[Part]) -> Part:
        """Return the call of the function `name` with `arguments`, as a part."""
        moves = any(part.moves for part in arguments)
        return Part(f"{name}({', '.join(part.text for part in arguments)})", moves=moves)

    def rate(self, operand: Part, order: int, offset: int) -> Part:
        """Return the time derivative of `operand`, of order `order`, as a part of the formula.

        The derivative of a symbol is a symbol of the system, such as x_dot. For any other operand it is a new name,
        and `rates` maps the name to (text of the operand, order). `offset` is the place of the derivative in the text.
        Raises TypedFault, located there, for an order above 2.
        """
        if order > 2:
            raise TypedFault("an equation of motion has no third derivative", offset)
        piece = self.names.exact.get(operand.text)
        if piece is not None and (rate := self.names.derivative(piece, order)):
            return Part(rate.name, moves=True)
        name = f"rate_{len(self.rates) + self.taken + 1}_of"
        self.rates[name] = (operand.text, order)
        return Part(name, moves=True)


def _times(left: Part, right: Part, sign: str = "*") -> Part:
    """Return the product of two parts, or their quotient if `sign` is "/"."""
    text = f"{left.at(PRODUCT)}{sign}{right.at(PRODUCT if sign == '*' else POWER)}"
    return Part(text, PRODUCT, left.number and right.number, left.moves or right.moves)
