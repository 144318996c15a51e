"""Rotations R in SO(3) as part of a statement: `lagrange.rotation`, with a quaternion of length one as coordinates.

R and its rates do not depend on the length of the quaternion, so no force changes this length. `with_length` adds an
inertia for it. The length then stays constant. Source: D. T. Greenwood, Advanced Dynamics, 2003, section 3.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache
from itertools import chain
from typing import Any, NoReturn

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray
from sympy.core.function import AppliedUndef
from sympy.matrices.expressions.matexpr import MatrixElement

from lagrange.errors import StatementError, listing, located, shown
from lagrange.statement.coordinate import (
    COORDINATES,
    RATE,
    ROTATION,
    check_name,
    function_of_time,
    name_of,
    rotation_name,
    row_label,
    t,
    velocity_of,
)
from lagrange.statement.expression import (
    SHORTHAND,
    NonScalar,
    as_typed,
    check_once,
    entries,
    in_full,
    is_shorthand,
    real_number,
    refusing_deep,
)
from lagrange.statement.space import (
    SpaceMatrix,
    body_rates,
    check_triangle,
    cross_matrix,
    in_space,
    matrix_of,
    of_length,
    product,
    quaternion_of,
    space_rates,
    velocities_at,
)

ENTRIES = "wxyz"  # Suffixes of the names of a quaternion's entries: the scalar, then the vector
AXES = "xyz"  # Suffixes of the names of axes: R_xz is an entry of the matrix, R_body_x a rate about a body axis


def _refusal(instead: str) -> Callable[..., NoReturn]:
    """Return a method that refuses an operation on a rotation. In the remedy `instead`, {0} is the rotation's name."""

    def refuse(self: Rotation, *others: Any, **options: Any) -> NoReturn:
        del others, options
        raise StatementError(f"{self.name} is a rotation, a 3 by 3 matrix: {instead.format(self.name)}.")

    return refuse


class Rotation(NonScalar):
    """Rotation R in SO(3), from the axes of a body to those of space, made by `lagrange.rotation`.

    `body` and `space` are its rates about the axes of the body and of space, each a vector of three expressions. A
    product R*v is a vector v of the body in the axes of space, R.T*v is a vector of space in the axes of the body, and
    R[i, j] is an entry of the matrix. `quaternion` has the four coordinates: the scalar, then the vector. `turns` are
    quasi-coordinates: small rotations about the axes of the body, whose rates are `body`. Derivations use them.
    """

    _op_priority = 100.0
    """Priority in products with SymPy matrices: the factor with the higher priority computes the product."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.remedy = (
            f"give an entry {name}[i, j], a rate {name}.body[i], or a component of a turned vector, ({name}*v)[i]"
        )
        self.quaternion = tuple(function_of_time(f"{name}_{entry}", {ROTATION: name}) for entry in ENTRIES)
        velocities = [velocity_of(q) for q in self.quaternion]
        pairs = [f"{a}{b}" for a in AXES for b in AXES]
        self.matrix = self._named(pairs, chain(*matrix_of(self.quaternion))).reshape(3, 3)
        self.body = self._named([f"body_{a}" for a in AXES], body_rates(self.quaternion, velocities))
        self.turns = tuple(
            function_of_time(f"{name}_turn_{a}", {RATE: rate}) for a, rate in zip(AXES, self.body, strict=True)
        )
        self.space = self._named([f"space_{a}" for a in AXES], space_rates(self.quaternion, velocities))

    def _named(self, names: Sequence[str], values: Iterable[Any]) -> Any:
        """Return a vector of named functions of time, each of which abbreviates one of the `values`.

        The name of the rotation precedes each name, as in R_body_x.
        """
        pairs = zip(names, values, strict=True)
        named = [function_of_time(f"{self.name}_{name}", {SHORTHAND: value}) for name, value in pairs]
        return SpaceMatrix(named)

    def __repr__(self) -> str:
        return f"<Rotation {self.name}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rotation) and other.name == self.name

    def __hash__(self) -> int:
        return hash((Rotation, self.name))

    @property
    def T(self) -> Any:
        """The inverse rotation: the transposed matrix."""
        return self.matrix.T

    def __getitem__(self, index: Any) -> Any:
        try:
            entry = self.matrix[index]
        except (IndexError, TypeError, ValueError):
            entry = None
        if entry is None or isinstance(entry, MatrixElement):  # SymPy's result for a symbolic index
            raise StatementError(
                f"{self.name} is a 3 by 3 matrix without an entry {shown(index)}: rows and columns are 0, 1 and 2, as "
                f"in {self.name}[2, 2]."
            )
        return entry

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Rotation):
            return self.matrix * other.matrix
        if isinstance(other, (sympy.MatrixBase, np.ndarray)) and other.shape == (3, 3):
            return self.matrix * sympy.Matrix(other)
        parts = entries(other, f"the vector that {self.name} turns")
        is_matrix = isinstance(other, sympy.MatrixBase)
        if parts is None or len(parts) != 3 or (is_matrix and other.cols != 1):
            description = shown(other) if parts is None else "a row" if len(parts) == 3 else f"{len(parts)} entries"
            raise StatementError(f"{self.name} is a rotation and turns a vector of three entries, not {description}.")
        return self.matrix * (other if is_matrix else in_space(parts))

    __add__ = __radd__ = __sub__ = __rsub__ = __neg__ = __pow__ = __truediv__ = _sympy_ = __array_ufunc__ = _refusal(
        "use its entries {0}[i, j], its rates {0}.body and {0}.space, or a turned vector {0}*v"
    )
    """SymPy calls `_sympy_` for a scalar, and NumPy `__array_ufunc__` for its functions and operators."""
    dot = ddot = property(_refusal("its rates are {0}.body and {0}.space, and the rates of these {0}.body.diff(t)"))
    _before = _refusal("it stands left of the vector that it turns, {0}*v or {0}.T*v")

    __matmul__ = __mul__

    def __rmul__(self, other: Any) -> Any:
        if isinstance(other, sympy.MatrixBase) and other.cols == 3:
            return other * self.matrix
        return self._before(other)


def rotation(name: str) -> Rotation:
    """Return the rotation `name`, from the axes of a body to those of space.

    `R.body` and `R.space` are its rates about these axes, `R*v` is a rotated vector, `R.T*v` a vector rotated back, and
    `R[i, j]` an entry of the matrix. A System contains it through the four coordinates of its quaternion, such as R_w.
    Raises StatementError for a name that is not an identifier.
    """
    result = rotation_of(check_name(name, "rotation"))
    COORDINATES.declare(tuple(map(name_of, result.quaternion)))
    return result


rotation_of = cache(Rotation)
"""Return the rotation of a name, as `rotation` does, without recording it in the order of declaration."""


def shorthands(rotations: Iterable[str]) -> dict[str, Any]:
    """Return {name: function of time} for all entries and rates of rotations, such as R_xx, R_body_x and R_space_x."""
    turned = map(rotation_of, rotations)
    return {name_of(f): f for each in turned for f in (*each.matrix, *each.body, *each.space)}


@refusing_deep
def in_coordinates(state: Mapping[Any, Any], values: Mapping[Any, Any], table: str = "initial") -> dict[Any, Any]:
    """Return `state`, a table of values, with quaternions and their velocities in place of rotations and rates.

    Keys of `state` are coordinates, velocities, rotations R, and rates such as R.body or R.body[2]. The value of a
    rotation is a quaternion or a rotation matrix. The value of R.body or R.space is three numbers or expressions, and
    the value of any other key is one. `values` has the present values of all coordinates and velocities. A turned
    rotation without rates in `state` keeps its rates about the axes of the body. If `state` has one or two rates about
    the axes of body or space, the others about these axes stay. `table` names the table in messages. Raises
    StatementError for a value that is not a rotation, for rates about the axes of both body and space, and for a
    rotation given both whole and by entries.
    """
    plain, rates = split_rates(state, values, table)
    kind = {"initial": "the start", "the reset": "the reset"}.get(table, "the attitude")
    check_once([*map(row_label, plain)], table)
    by_entry = {row_label(key): value for key, value in plain.items()}
    starts = {key: plain.pop(key) for key in list(plain) if isinstance(key, Rotation)}
    for each in starts:
        if each.quaternion[0] not in values:
            raise StatementError(f"{table} names the rotation {each.name}, which is not in this system.")
    for each in _rotations_of(tuple(values)):
        if each not in starts and each.body not in rates and each.space not in rates:
            continue
        if each.body in rates and each.space in rates:
            raise StatementError(f"{table} gives both {each.name}.body and {each.name}.space: give one of the two.")
        velocities = [*map(velocity_of, each.quaternion)]
        wholes = dict.fromkeys(each.quaternion if each in starts else (), each.name)
        if each.body in rates or each.space in rates:
            wholes |= dict.fromkeys(velocities, f"rates of {each.name}")
        for entry, whole in wholes.items():
            if row_label(entry) in by_entry:
                raise StatementError(f"{table} gives both {whole} and {row_label(entry)}: give one of the two.")
        now, moving = ([by_entry.get(row_label(x), values[x]) for x in part] for part in (each.quaternion, velocities))
        q = quaternion_of(starts[each], f"{kind} of {each.name}") if each in starts else now
        kept, vector = (space_rates, each.space) if each.space in rates else (body_rates, each.body)
        given_rates = rates.get(vector, [None] * 3)
        w = [old if new is None else new for old, new in zip(kept(now, moving), given_rates, strict=True)]
        moved = velocities_at(q, w, space=vector is each.space)
        plain |= dict(zip(each.quaternion, q, strict=True))
        plain |= dict(zip(velocities, moved, strict=True))
    return plain


def reset_of_coordinates(reset: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return an event's reset, with quaternion entries as keys in place of rotations and rates such as R.body."""
    named, others = dict[Any, Any](), dict[Any, Any]()
    for key, value in reset.items():
        rates = isinstance(key, sympy.MatrixBase) or is_shorthand(key)
        (named if rates or isinstance(key, Rotation) else others)[key] = value
    wholes = (sympy.Matrix(key.quaternion) if isinstance(key, Rotation) else in_full(key) for key in named)
    functions = {f for whole in wholes for f in whole.atoms(AppliedUndef) if rotation_name(f) is not None}
    state = {symbol: symbol for q in sorted(functions, key=str) for symbol in (q, velocity_of(q))}
    return others | in_coordinates(named, state, "the reset")


def set_rates(states: NDArray[np.float64], coordinates: tuple[Any, ...], values: Mapping[Any, Any]) -> None:
    """Set angular velocities of rotations in the m states (q, v), an array (m, 2n), in place.

    `values` maps rates such as R.body[2] to m numbers, and `coordinates` are q. Other rates about the same axes stay.
    """
    for each, rows, moving in quaternion_rows(coordinates) if values else ():
        for rates, rates_of in ((each.body, body_rates), (each.space, space_rates)):
            if values.keys().isdisjoint(rates):
                continue
            q, v = [*states[:, rows].T], [*states[:, moving].T]
            w = [values.get(rate, old) for rate, old in zip(rates, rates_of(q, v), strict=True)]
            moved = velocities_at(q, w, space=rates is each.space)
            states[:, moving] = np.transpose(moved)


def split_rates(
    table: Mapping[Any, Any], coordinates: Iterable[Any], label: str, what: str = ""
) -> tuple[dict[Any, Any], dict[Any, list[Any]]]:
    """Return the entries of a table that are not rates of rotations, and {vector of rates: three values} for the rates.

    Keys for rates are R.body, R.space and their names with three values, and rates such as R.body[2] or "R_body_z". A
    missing value is None. In messages `label` names the table, and `what` precedes the name of a rate. Raises
    StatementError for other vectors, for entries of a rotation's matrix and for repeated keys.
    """
    components: dict[Any, tuple[Any, Sequence[int]]] = {}
    wholes: dict[str, Any] = {}
    for each in _rotations_of(tuple(coordinates)):
        wholes |= {each.name: each, f"{each.name}.body": each.body, f"{each.name}.space": each.space}
        for rates in (each.body, each.space):
            components[rates] = rates, range(3)
            for k, rate in enumerate(rates):
                components[rate] = components[name_of(rate)] = rates, (k,)
    names = {whole: name for name, whole in wholes.items()}
    keys = [wholes.get(key, key) for key in table]
    check_once([names[key] for key in keys if key in names], label)
    plain: dict[Any, Any] = {}
    values: dict[Any, list[Any]] = {}
    for key, value in zip(keys, table.values(), strict=True):
        if key not in components:
            if isinstance(key, sympy.MatrixBase) or is_shorthand(key):
                raise StatementError(
                    f"{label} names {shown(key)}: use R.body or R.space of a rotation R of this system."
                )
            plain[key] = value
            continue
        rates, axes = components[key]
        vector = name_of(rates[0])[:-2].replace("_body", ".body").replace("_space", ".space")
        row = values.setdefault(rates, [None] * 3)
        parts = [value] if len(axes) == 1 else entries(value, f"{what}{vector}")
        if parts is None or len(parts) != len(axes):
            raise StatementError(f"{what}{vector} is {shown(value)}: give its components about the axes x, y and z.")
        for k, part in zip(axes, parts, strict=True):
            if row[k] is not None:
                raise StatementError(f"{label} names {name_of(rates[k])} twice: give one value.")
            is_number, rate = isinstance(part, (int, float)), f"{what}{name_of(rates[k])}"
            typed = (real_number if is_number else as_typed)(part, rate)
            row[k] = part if is_number else typed
    return plain, values


STRETCH = 1e-4
"""Tolerance for the length of a quaternion at a start, and for the share of its velocity that changes the length.

The length is one. At the end of a long run at loose tolerances it differs from one by 1e-5.
"""


@located("initial")
def check_start(coordinates: Sequence[Any], values: ArrayLike) -> None:
    """Raise StatementError for a quaternion whose length is not one, or whose velocity changes its length.

    `values` are states (q, v) of the `coordinates` q: one state (2n,), or m states (2n, m).
    """
    state = np.asarray(values, dtype=float)
    for each, rows, moving in quaternion_rows(tuple(coordinates)):
        q, v = state[rows], state[moving]
        sizes = np.sqrt((q * q).sum(axis=0))
        if (abs(sizes - 1) > STRETCH).any():
            size = float(np.atleast_1d(sizes)[abs(sizes - 1).argmax()])
            raise StatementError(of_length(f"the start of {each.name}", size))
        if (abs((q * v).sum(axis=0)) > STRETCH * np.sqrt((v * v).sum(axis=0))).any():
            raise StatementError(
                f"the start of {each.name} has velocities of {each.name}_w to {each.name}_z that change the length of "
                f"the quaternion: give {each.name}.body or {each.name}.space."
            )


@lru_cache(maxsize=256)
def quaternion_rows(coordinates: tuple[Any, ...]) -> list[tuple[Rotation, list[int], list[int]]]:
    """Return (rotation, indices of its quaternion in a state (q, v), indices of its velocities) for each rotation."""
    quaternions = []
    for each in _rotations_of(coordinates):
        rows = [coordinates.index(q) for q in each.quaternion]
        quaternions.append((each, rows, [row + len(coordinates) for row in rows]))
    return quaternions


@lru_cache(maxsize=256)
def _rotations_of(coordinates: tuple[Any, ...]) -> tuple[Rotation, ...]:
    """Return the rotations with quaternions in `coordinates`. Raises StatementError for an incomplete quaternion."""
    names = dict.fromkeys(name for name in map(rotation_name, coordinates) if name is not None)
    for each in map(rotation_of, names):
        if missing := [name_of(q) for q in each.quaternion if q not in coordinates]:
            raise StatementError(f"coordinates lacks {listing(missing)} of the rotation {each.name}: name all four.")
    return tuple(map(rotation_of, names))


def in_symbols(names: Iterable[str], rotations: Iterable[str]) -> list[str]:
    """Return the `names` of a state for a message, with R and R.body in place of quaternion entries and their rates."""
    known = symbols_of_entries(rotations)
    return [*(name for name in names if name not in known), *dict.fromkeys(known.values())]


def symbols_of_entries(rotations: Iterable[str]) -> dict[str, str]:
    """Return {name of a quaternion entry: "R", name of its velocity: "R.body"} for all rotations, such as R."""
    parts = (("", ""), ("_dot", ".body"))
    return {f"{name}_{entry}{end}": f"{name}{of}" for name in rotations for end, of in parts for entry in ENTRIES}


def is_scalar(coordinate: Any) -> bool:
    """Return True for the scalar entry of a quaternion, which is 1 in the identity rotation."""
    name = rotation_name(coordinate)
    return name is not None and coordinate == rotation_of(name).quaternion[0]


TORQUES = "forces", "the torque on "  # For messages on torques: name of the table, and prefix of the name of a rate


def forces_on_coordinates(forces: Any, coordinates: Iterable[Any]) -> Any:
    """Return a table of forces with generalized forces on coordinates in place of torques on rotations.

    Torques are given for rates about the axes of the body, R.body, or of space, R.space. The generalized force on an
    entry of the quaternion is the sum of each torque times the derivative of its rate by the velocity of the entry.
    Raises StatementError for a number of torques other than three, and for {R: ...}, which does not name axes.
    """
    if not isinstance(forces, Mapping):
        return forces
    table, torques = split_rates(forces, coordinates, *TORQUES)
    for key in table:
        if isinstance(key, Rotation):
            raise StatementError(f"forces names the rotation {key.name}: give torques on {key.name}.body or .space.")
    for each in _rotations_of(tuple(coordinates)):
        for rates in (each.body, each.space):
            for q in each.quaternion if rates in torques else ():
                slopes = (sympy.diff(in_full(rate), velocity_of(q)) for rate in rates)
                parts = (torque * slope for torque, slope in zip(torques[rates], slopes, strict=True) if torque)
                table[q] = table.get(q, sympy.S.Zero) + sum(parts)
    return table


def reading(
    energies: Mapping[str, Any],
    forces: Any,
    dissipation: Any,
    zeros: Iterable[Any],
    coordinates: Sequence[Any],
    names: Sequence[str],
) -> dict[str, Any] | None:
    """Return the fields of a statement in which small rotations replace quaternions, for readable derivations.

    Its expressions contain rates about the axes of the bodies and entries of R. `energies` are L, or T and V, and
    `zeros` the expressions of the constraints. Energies, constraints, `forces` and `dissipation` are as the user typed
    them. `names` are the names of the rotations. Returns None if a typed expression contains an entry of a quaternion.
    """
    turned = list(map(rotation_of, names))
    replacements: dict[Any, Any] = {}
    for each in turned:
        moved = each.matrix * cross_matrix(each.body)
        replacements |= {velocity_of(entry): rate for entry, rate in zip(each.matrix, moved, strict=True)}
    quaternions = {q for each in turned for q in each.quaternion}
    positions = [q for q in coordinates if q not in quaternions] + [turn for each in turned for turn in each.turns]
    table = dict.fromkeys(positions, sympy.S.Zero)
    plain, torques = split_rates(forces or {}, coordinates, *TORQUES)
    for key, value in plain.items():
        table |= {q: as_typed(value, "a force") for q in coordinates if key in (q, name_of(q))}
    for each in turned:
        body, space = ([torque or 0 for torque in torques.get(rates, (0, 0, 0))] for rates in (each.body, each.space))
        table |= dict(zip(each.turns, each.T * space + body, strict=True))
    if not quaternions.isdisjoint(table):
        return None
    kinetic, *rest = (energy.xreplace(replacements) for energy in energies.values())
    potential = rest[0] if rest else sympy.S.Zero
    drag = as_typed(dissipation, "the dissipation").xreplace(replacements)
    applied, constraints = (tuple(x.xreplace(replacements) for x in part) for part in (table.values(), zeros))
    for each in turned:
        _check_smooth_at_rest(each, potential, drag, applied)
    if any(part.has(*quaternions) for part in (kinetic, potential, drag, *applied, *constraints)):
        return None
    return {
        "kinetic": kinetic,
        "potential": potential,
        "lagrangian": kinetic - potential,
        "coordinates": tuple(positions),
        "dissipation": drag,
        "forces": applied,
        "constraints": constraints,
        "entries": tuple(tuple(each.matrix) for each in turned),
    }


_SINGULAR = (sympy.nan, sympy.zoo, sympy.oo, -sympy.oo, sympy.DiracDelta)  # Found in singular expressions


def _check_smooth_at_rest(rotation: Rotation, potential: Any, drag: Any, forces: Iterable[Any]) -> None:
    """Raise StatementError for V, dissipation or forces that are singular where the rates of a rotation are zero.

    These expressions contain rates about the axes of body and space, and entries of the rotation matrix.
    """
    plain, body = {rate: sympy.Dummy(real=True) for rate in (*rotation.body, *rotation.space)}, f"{rotation.name}.body"
    rates = tuple(plain.values())
    potential, drag, *forces = (part.xreplace(plain) for part in (potential, drag, *forces))
    slopes = [drag.diff(rate) for rate in rates] + [potential.diff(rate, other) for rate in rates for other in rates]
    at_rest = dict.fromkeys(rates, sympy.S.Zero)
    for what, parts in (("a force", forces), ("the dissipation or the potential energy", slopes)):
        if any(part.has(*rates) and part.xreplace(at_rest).has(*_SINGULAR) for part in parts):
            raise StatementError(
                f"{what} has a root or a quotient that is singular where {body} is zero: make it smooth at rest, such "
                f"as sqrt({body}.dot({body}) + e**2) with a small e."
            )


def of_quaternions(accelerations: Mapping[Any, Any], names: Sequence[str]) -> dict[Any, Any]:
    """Return accelerations {coordinate: expression}, with quaternions in place of small rotations.

    In the argument the rotation of each body is described by three small rotations about its axes. The accelerations of
    the quaternions follow from dq/dt = q (s, w)/2, where w are the rates about the axes of the body and s = 2 |q|'/|q|,
    with |q|'' = 0. `names` are the names of the rotations.
    """
    solved = {q: in_full(value) for q, value in accelerations.items()}
    for each in map(rotation_of, names):
        q, rates = each.quaternion, [velocity_of(entry) for entry in each.quaternion]
        stretch = 2 * sum(a * b for a, b in zip(q, rates, strict=True)) / sum(a**2 for a in q)
        from_rates = product(rates, (stretch, *map(in_full, each.body)))
        from_accelerations = product(q, (-(stretch**2) / 2, *(solved.pop(turn) for turn in each.turns)))
        solved |= {entry: (a + b) / 2 for entry, a, b in zip(q, from_rates, from_accelerations, strict=True)}
    return solved


def in_body_rates(formula: Any, names: Iterable[str]) -> Any:
    """Return `formula` with rates about the axes of the body in place of rates about the axes of space.

    `names` are the names of the rotations. The orthogonality of the rotation matrix is used if that shortens it.
    """
    rotations, replacements = list(map(rotation_of, names)), {}
    formula = formula.xreplace(
        {rate: turned for each in rotations for rate, turned in zip(each.space, each.matrix * each.body, strict=True)}
    )
    for each in rotations:
        for i in range(3):
            for j in range(i, 3):
                (a, b, c), (d, e, f) = each.matrix[:, i], each.matrix[:, j]
                replacements[c * f] = sympy.Integer(i == j) - a * d - b * e
    other = sympy.expand(sympy.expand(formula).subs(replacements))
    return other if other.count_ops() < formula.count_ops() else formula


def explanation(name: str, values: Mapping[Any, float]) -> str:
    """Return sentences on the symbols of the rotation `name`, with its quaternion from the initial `values`."""
    matrix = f"{name}_xx to {name}_zz are the entries of the rotation {name}."
    rates, turns = (listing(f"{name}_{kind}_{axis}" for axis in AXES) for kind in ("body", "turn"))
    start = ", ".join(f"{values[q]:.6g}" for q in rotation_of(name).quaternion)
    return (
        f"{matrix} {rates} are its rates about the axes of the body. {turns} are quasi-coordinates, small turns "
        f"about these axes; the derivative of L by one contains p x {name}_body, since the axes turn with the body. "
        f"{name} starts as the quaternion ({start})."
    )


def start_in_turns(names: Iterable[str], coordinates: Iterable[Any], initial: Mapping[Any, float]) -> tuple[float, ...]:
    """Return the initial state (q, v) in which three small angles about the body axes replace each quaternion.

    The angles start at zero, and their rates are the angular velocity. `names` are the names of the rotations.
    `coordinates` include the angles. `initial` maps all other coordinates, the quaternions, and velocities to values.
    """
    start = dict(initial)
    for each in map(rotation_of, names):
        velocities = [initial[velocity_of(entry)] for entry in each.quaternion]
        rates = body_rates([initial[entry] for entry in each.quaternion], velocities)
        start |= dict.fromkeys(each.turns, 0.0)
        start |= {velocity_of(turn): rate for turn, rate in zip(each.turns, rates, strict=True)}
    coordinates = tuple(coordinates)
    return tuple(start[symbol] for symbol in (*coordinates, *map(velocity_of, coordinates)))


def with_length(kinetic: Any, coordinates: Sequence[Any]) -> tuple[Any, tuple[str, ...]]:
    """Return a kinetic energy with an inertia for the length of each quaternion q, and the names of the rotations.

    Without this inertia the mass matrix would be singular, since R and its rates do not depend on the length. The added
    term is M (q . q')^2 / (2 q . q), where M is four times the mean moment of inertia. So the mass matrix is as well
    conditioned as that of the rates. Other coordinates in M are replaced by one. An energy that already has the term is
    not changed. Raises StatementError for a rotation without inertia, and for an incomplete quaternion.
    """
    rotations = _rotations_of(tuple(coordinates))
    for each in rotations:
        scalar, *inertias = (row[i] for i, row in enumerate(_inertia(kinetic, each)))
        mean = sympy.expand(sum(inertias) / 3)
        if mean.has(*_SINGULAR):
            raise StatementError(
                f"the kinetic energy has a root or a quotient that is singular where {each.name}.body is zero, so "
                f"{each.name} has no inertia there: make it smooth at rest, such as {each.name}.body.dot("
                f"J*{each.name}.body)/2."
            )
        if mean.is_zero or mean.is_finite is False:
            raise StatementError(without_inertia(each.name))
        if scalar.is_zero:
            along = sum(q * velocity_of(q) for q in each.quaternion)
            kinetic += mean * along**2 / (2 * sum(q**2 for q in each.quaternion))
    return kinetic, tuple(each.name for each in rotations)


def without_inertia(name: str) -> str:
    """Return the message for a rotation `name` that has no kinetic energy at rest."""
    return (
        f"the kinetic energy gives {name} no inertia at rest: add its energy, such as {name}.body.dot(J*{name}.body)/2."
    )


def _inertia(kinetic: Any, each: Rotation, *, still: bool = True) -> list[list[Any]]:
    """Return d2T/dv2 (4, 4) at the identity rotation `each`, where v are the velocities of its quaternion.

    The other coordinates are one, and all velocities zero. If `still` is false, the velocities of the quaternion are
    symbols instead.
    """
    identity = {q: sympy.Integer(q == each.quaternion[0]) for q in each.quaternion}
    others = [f for f in kinetic.atoms(AppliedUndef) if f not in identity and f.args == (t,)]
    rates = {velocity_of(q): sympy.Dummy(real=True) for q in each.quaternion}
    resting = {velocity_of(f): sympy.S.Zero for f in others}
    energy = kinetic.xreplace({**identity, **dict.fromkeys(others, sympy.S.One), **resting, **rates})
    rest = dict.fromkeys(rates.values(), sympy.S.Zero) if still else {}
    return [[sympy.diff(energy, a, b).xreplace(rest) for b in rates.values()] for a in rates.values()]


@lru_cache(maxsize=64)
def inertia_in_parameters(kinetic: Any, name: str) -> list[list[Any]] | None:
    """Return the inertia matrix (3, 3) of the rotation `name` about the axes of its body, as expressions in parameters.

    Returns None if it contains anything but parameters, if the rates are coupled to other velocities, or if the energy
    is not quadratic in the rates: then it is not the inertia of a single rigid body.
    """
    each = rotation_of(name)
    others = [f for f in kinetic.atoms(sympy.Derivative) if rotation_name(f.expr) != name]
    if others and any(kinetic.diff(velocity_of(q)).has(*others) for q in each.quaternion):
        return None
    rows = [[entry / 4 for entry in row[1:]] for row in _inertia(kinetic, each, still=False)[1:]]
    return None if any(entry.atoms(AppliedUndef, sympy.Dummy) for row in rows for entry in row) else rows


def check_moments(kinetic: Any, name: str, values: Mapping[Any, float]) -> None:
    """Raise StatementError if the moments of inertia of the rotation `name` break the triangle inequality.

    The moments follow from `kinetic`, the kinetic energy, with the parameters' `values`. If a value is missing, nothing
    is checked.
    """
    rows = inertia_in_parameters(kinetic, name)
    if rows is None or any(entry.free_symbols.difference(values) for row in rows for entry in row):
        return
    numbers = [[entry.xreplace(dict(values)) for entry in row] for row in rows]
    check_triangle(np.array([numbers], dtype=float), name)
