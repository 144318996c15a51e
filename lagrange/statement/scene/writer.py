"""Write a Statement as the text of a scene file, which reads back as the same statement, symbol for symbol."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

import sympy
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And, BooleanAtom, Not, Or

from lagrange.errors import StatementError, formula
from lagrange.statement.contact import Contact, along, impact_speed
from lagrange.statement.coordinate import constraint_of, name_of, t
from lagrange.statement.declare import ENERGIES
from lagrange.statement.event import Event
from lagrange.statement.expression import parts_first
from lagrange.statement.given.motion import TabulatedFunction, motion_of, table_of
from lagrange.statement.parameters import label_of, rate_name
from lagrange.statement.rotation import rotation_of
from lagrange.statement.scene.expressions import MULTIPLIER
from lagrange.statement.scene.guard import LONGEST_EVALUATED, RefusalError
from lagrange.statement.scene.scene_reader import MOST_RATES, NO_SIGN, OPEN
from lagrange.statement.scene.unevaluated import FLOAT, PRODUCT, SUM
from lagrange.statement.statement import REFUSE, ROD, Statement
from lagrange.statement.units.dimension import named
from lagrange.statement.vocabulary.functions import NAME_OF_CLASS
from lagrange.statement.vocabulary.letters import NAME

SHARED = 40  # Least number of characters of a part that gets a definition because it occurs twice
LONG_PART = 400  # Largest number of characters of a part inside another one. A longer part gets a definition.

DEEP = 12
"""Largest number of nested levels of an expression's text. A part with more levels is written as a definition. The
reader allows `expressions.DEEPEST_NESTING` levels, and counts up to four of them for each level of this count."""

IF, TERM, FACTOR, BASE, ATOM = range(5)
"""Binding strengths of the outermost operation of a text, the weakest first."""

_LOGIC = {And: " and ", Or: " or "}


class Text(NamedTuple):
    """Text of an expression, binding strength of its outermost operation, and number of its nested levels."""

    text: str
    strength: int = ATOM
    depth: int = 0

    def at(self, least: int) -> str:
        """Return the text, in parentheses if its outermost operation binds weaker than `least`."""
        return self.text if self.strength >= least else f"({self.text})"


class SharedText:
    """Writer of expressions as texts, in which names replace parts that are repeated or nested deeply.

    `definitions` maps each such name to its text, in order of use. `leaves` maps symbols and functions of time to their
    texts. `roots` are all expressions to be written, and `taken` the names that definitions must not have. Raises
    RefusalError for a part that cannot be written.
    """

    def __init__(self, roots: Iterable[Any], leaves: Mapping[Any, str], taken: Iterable[str]) -> None:
        self.definitions: dict[str, str] = {}
        self._known = {leaf: Text(text) for leaf, text in leaves.items()}
        self._leaves = frozenset(leaves)
        self._uses = self._counted(roots)
        self._prefix, names = "part_", tuple(taken)
        while any(name.startswith(self._prefix) for name in names):
            self._prefix += "_"
        self._kinds: tuple[tuple[Any, Callable[[Any], Text]], ...] = (
            (sympy.Number, _number),
            (sympy.Add, self._sum),
            (sympy.Mul, self._product),
            (sympy.Pow, self._power),
            (tuple(NAME_OF_CLASS), self._call),
            (Relational, self._relation),
            (sympy.core.numbers.Pi, lambda _: Text("pi")),
            (sympy.core.numbers.Exp1, lambda _: Text("exp(1)")),
            (sympy.Piecewise, self._branches),
            ((And, Or), self._logic),
            (Not, lambda node: Text(f"not {self._part(node.args[0]).at(ATOM)}", IF)),
            (BooleanAtom, lambda node: Text(str(bool(node)))),
            (ITE, self._choice),
            (AppliedUndef, self._function),
        )

    def text(self, expression: Any) -> str:
        """Return the text of an expression. Definitions that it uses are added to `definitions`."""
        leaves = (sympy.Derivative, sympy.Subs)
        for node in parts_first(expression, self._known, lambda node: () if isinstance(node, leaves) else node.args):
            self._known[node] = self._entry(node, root=node is expression)
        return self._known[expression].text

    def _counted(self, roots: Iterable[Any]) -> dict[Any, int]:
        """Return {subexpression: occurrences} in `roots`. Parts of a repeated subexpression are counted once."""
        uses: dict[Any, int] = {}
        todo = list(roots)
        while todo:
            node = todo.pop()
            uses[node] = uses.get(node, 0) + 1
            if uses[node] == 1 and node not in self._leaves:
                todo.extend(node.args)
        return uses

    def _entry(self, node: Any, *, root: bool) -> Text:
        """Return the text of an expression for use in others: written out, or the name of its definition.

        If `root` is true, the expression is one of those to be written, and gets no definition if it occurs only once.
        """
        if isinstance(node, ExprCondPair):
            return Text("")
        write = next((write for kind, write in self._kinds if isinstance(node, kind)), None)
        if write is None:
            raise RefusalError(f"{formula(node, 60)}, which has no name in a scene")
        entry = write(node)
        shared = self._uses.get(node, 0) > 1 and len(entry.text) >= SHARED
        alone = root and self._uses.get(node, 0) == 1
        return self._defined(entry) if not alone and (shared or entry.depth > DEEP) else entry

    def _defined(self, entry: Text) -> Text:
        name = f"{self._prefix}{len(self.definitions) + 1}"
        self.definitions[name] = entry.text
        return Text(name)

    def _part(self, node: Any) -> Text:
        """Return the text of a subexpression for use in another one. A long text gets a name, which is returned."""
        entry = self._known[node]
        if len(entry.text) > LONG_PART:
            entry = self._known[node] = self._defined(entry)
        return entry

    def _joined(self, parts: list[Text], text: str, strength: int) -> Text:
        return Text(text, strength, 1 + max((part.depth for part in parts), default=0))

    def _sum(self, node: Any) -> Text:
        parts = [self._part(term) for term in node.args]
        if isinstance(node.args[0], sympy.Add) and parts[0].strength < ATOM:
            return self._listed(SUM, parts)
        text = parts[0].at(TERM)
        for term, part in zip(node.args[1:], parts[1:], strict=True):
            minus = part.text.startswith("-") and _is_signed(term, part)
            text += f" - {part.text[1:]}" if minus else f" + {part.at(FACTOR)}"
        if len(text) > LONGEST_EVALUATED:
            return self._listed(SUM, parts)
        return self._joined(parts, text, TERM)

    def _listed(self, name: str, parts: list[Text]) -> Text:
        return self._joined(parts, f"{name}({', '.join(part.text for part in parts)})", ATOM)

    def _product(self, node: Any) -> Text:
        number, *factors = node.args
        parts = [self._part(factor) for factor in node.args]
        sign = ""
        if isinstance(number, sympy.Number) and number < 0:
            sign = "-"
            if number != -1 or not isinstance(number, sympy.Integer):
                factors.insert(0, -number)
            elif isinstance(factors[0], (sympy.Number, sympy.Mul)):
                return self._listed(PRODUCT, parts)
        else:
            factors.insert(0, number)
        if factors[0] == 1 or isinstance(factors[0], sympy.Mul):
            return self._listed(PRODUCT, parts)
        first = factors[0]
        head = _number(first) if isinstance(first, sympy.Number) else self._part(first)
        text = head.text if isinstance(first, sympy.Rational) else head.at(BASE)
        if _is_divisor(first):
            text = f"{self._part(first.base).at(ATOM)}**-1"
        for factor in factors[1:]:
            if _is_divisor(factor):
                text += f"/{self._part(factor.base).at(BASE)}"
            else:
                text += f"*{self._part(factor).at(BASE)}"
        return self._joined(parts, sign + text, FACTOR if not sign else TERM)

    def _power(self, node: Any) -> Text:
        base, exponent = self._part(node.base), self._part(node.exp)
        if node.exp == sympy.S.Half:
            return self._joined([base], f"sqrt({base.text})", ATOM)
        if _is_divisor(node):
            return self._joined([base], f"1/{base.at(BASE)}", FACTOR)
        power = exponent.text if isinstance(node.exp, sympy.Integer) else exponent.at(ATOM)
        return self._joined([base, exponent], f"{base.at(ATOM)}**{power}", BASE)

    def _call(self, node: Any) -> Text:
        arguments = node.pargs if isinstance(node, sympy.Heaviside) else node.args
        if isinstance(node, sympy.exp) and node.args == (1,):
            return Text(f"exp({SUM}(1))")  # exp(1) is the constant E
        return self._listed(NAME_OF_CLASS[node.func], [self._part(argument) for argument in arguments])

    def _function(self, node: Any) -> Text:
        if node.func != sympy.Function(node.func.__name__):
            raise RefusalError(f"{formula(node, 60)}, a function with assumptions")
        return self._listed(node.func.__name__, [self._part(argument) for argument in node.args])

    def _relation(self, node: Any) -> Text:
        left, right = parts = [self._part(side) for side in node.args]
        return self._joined(parts, f"{left.at(TERM)} {node.rel_op} {right.at(TERM)}", IF)

    def _logic(self, node: Any) -> Text:
        parts = [self._part(part) for part in node.args]
        return self._joined(parts, _LOGIC[node.func].join(part.at(ATOM) for part in parts), IF)

    def _choice(self, node: Any) -> Text:
        condition, first, second = parts = [self._part(part) for part in node.args]
        second = self._last(node.args[2], ITE)
        return self._joined(parts, f"({first.at(ATOM)} if {condition.at(ATOM)} else {second.at(ATOM)})", ATOM)

    def _branches(self, node: Any) -> Text:
        pairs = [(self._part(value), self._part(condition)) for value, condition in node.args]
        last = "None"
        if len(pairs) > 1 and node.args[-1].cond == sympy.true:
            pairs.pop()
            last = self._last(node.args[-1].expr, sympy.Piecewise).text
        parts = [part for pair in pairs for part in pair]
        text = "".join(f"{value.text} if {condition.text} else " for value, condition in pairs)
        return self._joined(parts, f"({text}{last})", ATOM)

    def _last(self, node: Any, kind: Any) -> Text:
        """Return the text of the expression after the last "else" of a condition.

        If it has branches, it gets a definition. Otherwise these branches would be read back as branches of the outer
        condition. `kind` is the class of the outer condition.
        """
        entry = self._part(node)
        if isinstance(node, kind) and entry.text.startswith("("):
            entry = self._known[node] = self._defined(entry)
        return entry


def _is_divisor(node: Any) -> bool:
    return isinstance(node, sympy.Pow) and node.exp == -1 and not isinstance(node.base, sympy.Number)


def _is_signed(term: Any, part: Text) -> bool:
    """Return True if the text of `term` begins with a minus sign that belongs to a number.

    The term is that number, or a product that begins with it.
    """
    if part.strength == ATOM:
        return False
    if isinstance(term, sympy.Number):
        return True
    return isinstance(term, sympy.Mul) and isinstance(term.args[0], sympy.Number)


def _number(number: Any) -> Text:
    if isinstance(number, sympy.Rational):
        return Text(str(number), TERM if number < 0 else ATOM if number.q == 1 else FACTOR)
    if number._prec == 53 and sympy.Float(value := float(number)) == number:
        return Text(repr(value), ATOM if value >= 0 else TERM)
    sign, mantissa, exponent, _ = number._mpf_
    return Text(f"{FLOAT}({'-' * sign}{int(mantissa)}, {int(exponent)}, {int(number._prec)})")


BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_")
"""Characters of TOML keys without quotation marks."""


def scene_text(statement: Statement) -> str:
    """Return the text of a scene file that reads back as the statement, symbol for symbol.

    The scene has `evaluate = false`, so SymPy does not rearrange its expressions. Raises StatementError for parts that
    scenes cannot contain, such as derivatives of functions without a formula, or functions with assumptions.
    """
    return "\n".join(_SceneWriter(statement.open_form or statement).lines()) + "\n"


def sign_of(parameter: Any) -> str:
    """Return the assumptions of a parameter in the words of the table [signs], such as "real" or "positive"."""
    for words in ({"real": True}, {}, {"positive": True}, {"nonnegative": True}):
        if parameter == sympy.Symbol(parameter.name, **words):
            return next(iter(words), NO_SIGN)
    assumed = {word: value for word, value in parameter._assumptions_orig.items() if word != "commutative"}
    return " ".join(f"{'' if value else 'not '}{word}" for word, value in sorted(assumed.items()))


class _SceneWriter:
    """Writer of one statement as the lines of a scene file. Raises StatementError if scenes cannot contain a part."""

    def __init__(self, statement: Statement) -> None:
        self.statement, names = statement, statement.rotations
        self.typed = statement.reading or statement
        self.leaves = {leaf: symbol.name for leaf, symbol in statement.plain.items()}
        for function in statement.given:
            rates = ((k, sympy.Derivative(function, (t, k))) for k in range(1, MOST_RATES + 1))
            self.leaves |= {function: name_of(function), **{rate: rate_name(name_of(function), k) for k, rate in rates}}
        self.leaves |= {parameter: parameter.name for parameter in statement.parameters}
        for each in map(rotation_of, names):
            self.leaves |= {f: name_of(f) for f in (*each.matrix, *each.body, *each.space)}
        taken = [*self.leaves.values()]
        self.leaves[t] = t.name
        self.leaves |= {symbol: symbol.name for symbol in (impact_speed, along)}
        for symbol in set().union(*(root.free_symbols for root in self.roots())):
            if (constraint := constraint_of(symbol)) is not None:
                self.leaves[symbol] = f"{MULTIPLIER}({constraint})"
        self.measured = dict(self.named_tables(taken))
        self.shared = SharedText(self.roots(), self.leaves, (*taken, *self.measured))
        symbol_texts = {leaf: text for leaf, text in self.leaves.items() if leaf.is_Symbol}
        self.alone = SharedText((), symbol_texts, taken)

    def roots(self) -> list[Any]:
        """Return all expressions of the statement, in the order in which they are written."""
        statement, typed = self.statement, self.typed
        energies = [typed.kinetic] if typed.lagrangian_alone else [typed.kinetic, typed.potential]
        constraints = [constraint.expression for constraint in typed.constraints]
        points = [entry for point in (*statement.positions.values(), *statement.surfaces.values()) for entry in point]
        contacts = [part for each in statement.contacts for part in each.expressions]
        events = [
            part for e in statement.run.events for part in (e.expression, *e.reset.values(), *e.settings.values())
        ]
        return [*energies, typed.dissipation, *typed.forces, *constraints, *contacts, *points, *events]

    def named_tables(self, taken: list[str]) -> Iterator[tuple[str, str]]:
        """Yield (name, text) of each table of measured values, as in ("table_1", "{ argument = x, points = ... }").

        Afterwards `leaves` maps the table's spline to the name. `taken` are names that the tables must not have.
        """
        plain = SharedText((), dict(self.leaves), taken)
        nodes = dict.fromkeys(
            node for root in self.roots() for node in sorted(root.atoms(sympy.Piecewise), key=sympy.default_sort_key)
        )
        for node, made_from in ((node, table_of(node)) for node in nodes):
            if made_from is not None:
                name = next(name for k in count(1) if (name := f"table_{k}") not in (*taken, *self.leaves.values()))
                argument = self.text("the argument of a table", made_from[0], plain)
                self.leaves[node] = name
                yield name, f"{{ argument = {argument}, {_columns(made_from[1], ('points', 'values'))} }}"

    def lines(self) -> Iterator[str]:
        """Yield the lines of the scene file."""
        statement = self.statement
        yield f"name = {_quoted(statement.name)}"
        for key in ("about", "source"):
            if text := getattr(statement, key):
                yield f"{key} = {_quoted(text)}"
        yield "evaluate = false"
        if functions := sorted({function.func.__name__ for function in statement.unknown}):
            yield f"functions = [{_joined(map(_quoted, functions))}]"
        yield f"coordinates = [{', '.join(map(_quoted, statement.names))}]"
        if statement.rotations:
            yield f"rotations = [{', '.join(map(_quoted, statement.rotations))}]"
        for key in ("lagrangian",) if self.typed.lagrangian_alone else ("kinetic", "potential"):
            yield f"{key} = {self.text(ENERGIES[key], getattr(self.typed, key))}"
        if statement.dissipation != 0:
            yield f"dissipation = {self.text('the dissipation', self.typed.dissipation)}"
        if statement.redundant != REFUSE:
            yield f"redundant = {_quoted(statement.redundant)}"
        if statement.simultaneous:
            yield f"simultaneous = {_quoted(statement.simultaneous)}"
        if statement.links:
            shown = ([link.start, link.end, *([link.kind] * (link.kind != ROD))] for link in statement.links)
            yield f"links = [{', '.join(f'[{_joined(map(_quoted, link))}]' for link in shown)}]"
        events = [line for event in statement.run.events for line in self.event(event)]
        for key, entries in self.tables().items():
            if entries:
                yield f"\n[{key}]"
                yield from (f"{_key(name)} = {value}" for name, value in entries.items())
        yield from events

    def event(self, event: Event) -> Iterator[str]:
        """Yield the lines of the table [[events]] for one event."""
        yield "\n[[events]]"
        yield f"when = {self.text('an event', event.expression)}"
        if event.direction:
            yield f"direction = {event.direction}"
        if event.terminal:
            yield f"terminal = {event.terminal}"
        values = {label_of(key): value for key, value in {**event.reset, **event.settings}.items()}
        if values:
            texts = (f"{_key(name)} = {self.text('a reset', value)}" for name, value in values.items())
            yield f"reset = {{ {_joined(texts)} }}"

    def tables(self) -> Mapping[str, Mapping[str, str]]:
        """Return {table: {key: text of its value}} for the tables of the file."""
        statement = self.statement
        forces = ((name_of(key), force) for key, force in self.typed.applied.items())
        states = zip(statement.state_names, statement.initial, strict=True)
        settings = {key: getattr(statement.run, key) for key in ("t_end", "rtol", "atol", "step")}
        run = {key: repr(float(value)) for key, value in settings.items() if value is not None}
        if statement.run.method is not None:
            run["method"] = _quoted(statement.run.method)
        signs = {parameter.name: sign_of(parameter) for parameter in statement.parameters}
        return {
            "parameters": {
                p.name: repr(float(statement.defaults[p])) if p in statement.defaults else _quoted(OPEN)
                for p in statement.parameters
            },
            "signs": {name: _quoted(sign) for name, sign in signs.items() if sign != "real"},
            "given": {name_of(function): self.motion(function) for function in statement.given},
            "initial": {name: repr(value) for name, value in states if value or name in statement.names},
            "forces": {name: self.text(f"the force on {name}", force) for name, force in forces if force != 0},
            "constraints": {
                constraint.name: self.text(constraint.name, constraint.expression)
                for constraint in self.typed.constraints
            },
            **{f"contacts.{_key(each.name)}": self.contact(each) for each in statement.contacts},
            **{
                key: {
                    name: f"[{_joined(self.text(f'{what} {name}', entry) for entry in point)}]"
                    for name, point in getattr(statement, key).items()
                }
                for key, what in (("positions", "the position of"), ("surfaces", "the surface"))
            },
            "tables": self.measured,
            "definitions": {name: f"'{text}'" for name, text in self.shared.definitions.items()},
            "dimensions": dict(self.dimensions()),
            "run": run,
        }

    def text(self, what: str, expression: Any, shared: SharedText | None = None) -> str:
        """Return an expression as a quoted text. `what` is the name of the expression in errors.

        `shared` is the writer whose definitions the text may use. None is the writer for the whole file.
        """
        try:
            return f"'{(shared or self.shared).text(expression)}'"
        except RefusalError as error:
            raise StatementError(
                f"{self.statement.name} cannot be written as a scene: {what} contains {error}."
            ) from None

    def contact(self, each: Contact) -> Mapping[str, str]:
        """Return {key: text} for the table of a contact. Its slip and friction are lists if they have two entries."""
        what = f"the contact {each.name}"
        friction = each.friction[:1] if each.friction[0] == each.friction[1] else each.friction
        entries = {"gap": [each.gap], "slip": each.slip, "restitution": [each.restitution], "friction": friction}
        texts = {key: [self.text(what, part) for part in parts] for key, parts in entries.items() if any(parts)}
        return {key: parts[0] if len(parts) == 1 else f"[{_joined(parts)}]" for key, parts in texts.items()}

    def motion(self, function: Any) -> str:
        """Return the values of a given function as text: an expression, or lists of times and values."""
        motion = motion_of(function)
        if motion is None or motion.values is None:
            return _quoted(OPEN)
        if isinstance(motion.values, TabulatedFunction):
            return f"[{_columns(motion.values)}]"
        text = self.text(f"the given function {name_of(function)}", motion.values, self.alone)
        return text if text != f"'{OPEN}'" else f"'({OPEN})'"

    def dimensions(self) -> Iterator[tuple[str, str]]:
        """Yield (name, quoted unit or dimension) of each symbol whose dimension is known.

        The symbol t is left out if its unit is the second, which is the default.
        """
        for symbol, dimension in self.statement.dimensions.items():
            name = symbol.name if isinstance(symbol, sympy.Symbol) else name_of(symbol)
            if symbol == t and dimension == named("second"):
                continue
            powers = [base if power == 1 else f"{base}**({power})" for base, power in dimension.exponents]
            yield name, _quoted(dimension.unit or "*".join(powers) or "1")


def _columns(table: TabulatedFunction, names: Sequence[str] = ("", "")) -> str:
    """Return the points and the values of a table as text: "[0.0, 1.0], [0.0, 0.9]".

    With the `names` of the two lists, the text is "points = [0.0, 1.0], values = [0.0, 0.9]".
    """
    rows = (f"[{_joined(map(repr, row))}]" for row in (table.points, table.values))
    return _joined(f"{name} = {row}" if name else row for name, row in zip(names, rows, strict=True))


def _joined(texts: Iterable[str]) -> str:
    return ", ".join(texts)


def _quoted(text: str) -> str:
    """Return a text as a TOML string. JSON escapes the same characters as TOML, except the control character DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if set(name) <= BARE and NAME.fullmatch(name) else _quoted(name)
