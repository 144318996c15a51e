"""Decorators `procedure` and `inline` for plain Python functions, and a cache on disk of rewritten functions.

Parsing and rewriting a function takes 0.9 ms, and an integration method has up to a hundred functions. Rewritten
functions of this package are therefore stored beside the byte code of their modules. A stored file is used only if its
digest agrees with its content, the source file, the front end, and Python's version.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import gc
import inspect
import linecache
import marshal
import os
import sys
import threading
import traceback
import typing
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from hashlib import sha256
from importlib.util import cache_from_source
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload
from weakref import WeakValueDictionary

from lagrange.errors import LagrangeError
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Array, Callee, Kind, Procedure, Record
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.front.control import Ended, Error, is_dynamic
from lagrange.procedure.front.rewriting import Rewriter, as_module
from lagrange.procedure.front.vocabulary import KINDS, leaves, record_of

FRONT = Path(__file__).parent
PACKAGE = FRONT.parents[1]


class _Stored:
    """The rewritten functions of one source file, by key: {(first line, name, True if it is inlined): code}."""

    def __init__(self, file: str) -> None:
        self.path = Path(cache_from_source(file)).with_suffix(".plain")
        self.key = "".join([_front_end(), file, *linecache.getlines(file)]).encode()
        self.codes: dict[tuple[int, str, bool], CodeType] = {}
        with suppress(OSError):
            stored = self.path.read_bytes()
            content = stored[sha256().digest_size :]
            if stored == sha256(self.key + content).digest() + content:
                self.codes = marshal.loads(content)
        self.count = len(self.codes)

    def write(self) -> None:
        """Write the cache file if there are new functions. A folder without write permission is not an error."""
        if len(self.codes) > self.count and not sys.dont_write_bytecode:
            self.count = len(self.codes)
            part = self.path.with_suffix(f".{os.getpid()}")
            with suppress(OSError):
                self.path.parent.mkdir(parents=True, exist_ok=True)
                content = marshal.dumps(self.codes)
                part.write_bytes(sha256(self.key + content).digest() + content)
                part.replace(self.path)


@cache
def _front_end() -> str:
    """Return a digest of Python's version and of the files of this folder: every rewritten function depends on them."""
    return sha256(
        b"".join([sys.version.encode(), *(path.read_bytes() for path in sorted(FRONT.glob("*.py")))])
    ).hexdigest()


_STORED: dict[str, _Stored] = {}
"""Stored functions by source file."""


def _stored(file: str) -> _Stored | None:
    """Return the stored functions of a file, or None for a file outside this package."""
    if file not in _STORED and Path(file).is_relative_to(PACKAGE):
        _STORED[file] = _Stored(file)
    return _STORED.get(file)


def rewritten_code(function: FunctionType, *, inlined: bool) -> CodeType:
    """Return the code object of a plain function, rewritten by `rewriting` to build a procedure.

    The cache file of the function's module is used if it has the code. `inlined` is true for a function that is inlined
    into its callers. Raises LagrangeError if the function cannot be rewritten.
    """
    code = function.__code__
    FILES.add(code.co_filename)
    stored, key = _stored(code.co_filename), (code.co_firstlineno, code.co_qualname, inlined)
    if stored is not None and key in stored.codes:
        return stored.codes[key]
    tree, comments = source_of(function)
    plain = Rewriter(tree, comments, inlined=inlined).function(code.co_freevars)
    result = compile(as_module(plain), code.co_filename, "exec").co_consts[0]
    assert isinstance(result, CodeType)
    if stored is not None:
        stored.codes[key] = result
    return result


def store() -> None:
    """Write the functions that were rewritten since the last call to the cache files."""
    for stored in list(_STORED.values()):
        stored.write()


def source_of(function: FunctionType) -> tuple[ast.FunctionDef, Mapping[int, str]]:
    """Return the syntax tree of a function, and the comments that fill whole lines of its module, by line.

    A comment is a line that begins with `#`, even inside a string. Raises LagrangeError if the source cannot be read.
    """
    code = function.__code__
    functions, comments = _module(code.co_filename)
    tree = functions.get(code.co_firstlineno)
    if tree is None or tree.name != function.__name__:
        raise LagrangeError(
            f"procedure {function.__name__}: its source is not in {code.co_filename}. "
            "Install lagrange with its .py files."
        )
    return tree, comments


FILES: set[str] = set()
"""Files that contain plain functions. Messages state lines in these files."""


@cache
def _module(file: str) -> tuple[Mapping[int, ast.FunctionDef], Mapping[int, str]]:
    """Return the functions of a file by first line (the line of the first decorator), and its comments by line."""
    FILES.add(file)
    lines = linecache.getlines(file)
    functions = {
        min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)]): node
        for node in _functions(ast.parse("".join(lines)).body)
    }
    stripped = {number: line.strip() for number, line in enumerate(lines, 1)}
    return functions, {number: line.lstrip("# ") for number, line in stripped.items() if line.startswith("#")}


def _functions(body: Iterable[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a block, including those inside classes, functions and branches."""
    for statement in body:
        if isinstance(statement, ast.FunctionDef):
            yield statement
        yield from _functions(getattr(statement, "body", ()))
        yield from _functions(getattr(statement, "orelse", ()))


Args = ParamSpec("Args")
Result = TypeVar("Result")
Owner = TypeVar("Owner")
Rest = ParamSpec("Rest")

_BUILDING = threading.RLock()
"""Reentrant lock for building all procedures, because building one also builds its callees."""


@contextmanager
def _building() -> Iterator[None]:
    """Context that holds the lock for building procedures and suspends garbage collection.

    A collection walks through all objects, which takes longer than building.
    """
    with _BUILDING:
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            if was_enabled:
                gc.enable()


@dataclasses.dataclass(frozen=True)
class Bundle:
    """The type of a parameter that is a dataclass. Each field becomes a parameter with its own name."""

    of: type
    types: Mapping[str, Stated]
    """Types of fields that depend on known parameters; other fields have annotations."""


Stated = Kind | Array | Record | Callee | tuple["Stated", ...] | Bundle | type | None
"""The type of a parameter: a number, an array, a record, a function, a dataclass, a tuple of such types, or None."""


class Located(LagrangeError):
    """An error whose message begins with the file and the line that caused it."""


class PlainFunction(Generic[Args, Result]):
    """A plain Python function from which procedures are built. A direct call runs it in Python."""

    inlined = False

    def __init__(self, function: Callable[Args, Result]) -> None:
        self.function: Any = function
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self.__wrapped__ = function
        self.signature = inspect.signature(function)

    def __call__(self, *args: Args.args, **kwargs: Args.kwargs) -> Result:
        result: Result = self.function(*args, **kwargs)
        return result

    def __reduce__(self) -> str:
        """Return the name of this object in its module, for copies and pickles."""
        return self.__name__

    def bound(self, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of every argument and of every free variable of the function, by name."""
        try:
            binding = self.signature.bind(*args, **kwargs)
        except TypeError as error:
            raise Error(f"{self.__name__}: {error}.") from None
        binding.apply_defaults()
        cells = self.function.__closure__ or ()
        free = {name: cell.cell_contents for name, cell in zip(self.function.__code__.co_freevars, cells, strict=True)}
        return {**binding.arguments, **free}

    @cached_property
    def rewritten(self) -> Callable[..., Any]:
        """The function rewritten by `rewriting`: it builds a procedure instead of computing.

        Its first argument is a `Tracer`, which adds a statement to the procedure for each step of the function.
        """
        function: FunctionType = self.function
        return FunctionType(rewritten_code(function, inlined=self.inlined), function.__globals__)


class Inline(PlainFunction[Args, Result]):
    """A function that is inlined into its callers, with arguments and results of any type.

    It may also `yield` values to a loop of its caller.
    """

    inlined = True

    @overload
    def __get__(self, owner: None, kind: type) -> Inline[Args, Result]: ...
    @overload
    def __get__(self: Inline[Concatenate[Owner, Rest], Result], owner: Owner, kind: type) -> Callable[Rest, Result]: ...
    def __get__(self, owner: Any, kind: type) -> Any:
        return self if owner is None else MethodType(self, owner)

    def traced(self, tracer: Tracer, /, *args: Any, **kwargs: Any) -> Any:
        """Add the statements of the function to the present block, and return its result."""
        return self.rewritten(tracer, **self.bound(args, kwargs))


class Plain(PlainFunction[Args, Result]):
    """A procedure written as a plain function.

    Parameters after `*` are static: `form(**known)` builds it for their values.
    """

    def __init__(
        self, function: Callable[Args, Result], *, noinline: bool, types: Mapping[str, Callable[..., Any]]
    ) -> None:
        super().__init__(function)
        self.noinline, self.types = noinline, types
        parameters = self.signature.parameters.values()
        self.known = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
        self._forms: MutableMapping[Hashable, Procedure] = WeakValueDictionary()
        self._kept: dict[Hashable, Procedure] = {}
        """Forms for known numbers, texts and options. A form for other objects is kept as long as these exist."""

    def form(self, **known: Any) -> Procedure:
        """Return the procedure for these values of the static parameters, built once for each set of values."""
        missing = [name for name in self.known if name not in known and self._default(name) is inspect.Parameter.empty]
        unknown = [name for name in known if name not in self.known]
        if missing or unknown:
            wrong = f"give {', '.join(missing)}" if missing else f"leave {', '.join(unknown)} out"
            names = ", ".join(self.known) or "none"
            raise LagrangeError(f"procedure {self.__name__} has the static parameters {names}: {wrong}.")
        values = {name: known.get(name, self._default(name)) for name in self.known}
        key = tuple((type(value), value) for value in values.values())
        form = self._forms.get(key)
        if form is None:
            with _building():
                form = self._forms.get(key)
                if form is None:
                    form = self._forms[key] = self._build(values)
                    if all(isinstance(value, (int, float, str, enum.Enum)) for value in values.values()):
                        self._kept[key] = form
                    store()
        return form

    def _default(self, name: str) -> Any:
        return self.signature.parameters[name].default

    def traced(self, tracer: Tracer, /, *args: Any, **kwargs: Any) -> Any:
        """Add a call of the procedure to the present block, and return its results."""
        arguments = self.bound(args, kwargs)
        known = {name: arguments.pop(name) for name in self.known}
        late = [name for name, value in known.items() if is_dynamic(value)]
        if late:
            raise Error(f"{late[0]} of {self.__name__} must be known when it is built: give a constant.")
        for name in self.function.__code__.co_freevars:
            arguments.pop(name)
        return tracer.call_procedure(
            self.form(**known), [leaf for value in arguments.values() for leaf in leaves(value)]
        )

    def _build(self, known: Mapping[str, Any]) -> Procedure:
        hints = typing.get_type_hints(self.function, include_extras=True)
        about = inspect.getdoc(self.function) or ""
        p = Builder(self.__name__ + _suffix(known), about.split("\n\n")[0].replace("\n", " "), noinline=self.noinline)
        scope: dict[str, Any] = dict(known)
        for name in self.signature.parameters:
            if name not in known:
                scope[name] = _parameter(p, name, self._type(name, hints, known))
        results = results_of(hints.get("return", type(None)))
        tracer = Tracer(p, results)
        arguments, rewritten = self.bound((), scope), self.rewritten
        try:
            with suppress(Ended):
                rewritten(tracer, **arguments)
        except (LagrangeError, TypeError, AttributeError, ValueError, LookupError, NameError, ArithmeticError) as error:
            raise self._located(error, p.name) from error
        return p.finish(*results)

    def _type(self, name: str, hints: Mapping[str, Any], known: Mapping[str, Any]) -> Stated:
        """Return the type of the parameter `name`: from the decorator, or else from its annotation in `hints`.

        The decorator may have a function that returns the type. `known` has the values of the static parameters, by
        name.
        """
        if name in self.types:
            stated = self.types[name]
            made: Stated = stated(**{key: known[key] for key in inspect.signature(stated).parameters if key in known})
            return made
        if name not in hints:
            raise LagrangeError(f"procedure {self.__name__}: the parameter {name} has no type.")
        return type_of(hints[name])

    def _located(self, error: Exception, name: str) -> Located:
        """Return an error whose message begins with the file and line of the plain function at which `error` arose.

        `name` is the procedure's name.
        """
        if isinstance(error, Located):
            return error
        frames = traceback.extract_tb(error.__traceback__)
        inside = [frame for frame in frames if frame.filename in FILES]
        line = f"{inside[-1].filename}, line {inside[-1].lineno}: `{inside[-1].line}`: " if inside else ""
        said = str(error).removeprefix(f"procedure {name}: ")
        return Located(f"procedure {name}: {line}{said}")


@overload
def procedure(function: Callable[Args, Result], /) -> Plain[Args, Result]: ...
@overload
def procedure(
    *, noinline: bool = False, **types: Callable[..., Any]
) -> Callable[[Callable[Args, Result]], Plain[Args, Result]]: ...
def procedure(function: Any = None, /, *, noinline: bool = False, **types: Callable[..., Any]) -> Any:
    """Declare a plain function as a procedure. With `noinline` the procedure is not inlined.

    `types` maps names of parameters to functions that return their types. The arguments of such a function are static
    parameters, selected by their names.
    """
    if function is not None:
        return Plain(function, noinline=False, types={})
    return lambda stated: Plain(stated, noinline=noinline, types=types)


def inline(function: Callable[Args, Result]) -> Inline[Args, Result]:
    """Declare that a plain function, method or generator is inlined into its callers."""
    return Inline(function)


def type_of(annotation: Any) -> Stated:
    """Return the parameter type for an annotation. Raises LagrangeError for an annotation without a type."""
    if annotation in KINDS:
        return KINDS[annotation]
    if isinstance(annotation, (Kind, Array, Record, Callee)):
        return annotation
    metadata = getattr(annotation, "__metadata__", ())
    if metadata and isinstance(metadata[0], Array):
        return metadata[0]
    if isinstance(annotation, type):
        made = record_of(annotation)
        if made is not None:
            return made
        if issubclass(annotation, enum.IntEnum):
            return WHOLE
        if dataclasses.is_dataclass(annotation):
            return annotation
    if typing.get_origin(annotation) is Callable:
        parameters, result = typing.get_args(annotation)
        types = tuple(type_of(parameter) for parameter in parameters)
        return Callee(typing.cast("tuple[Kind | Array, ...]", types), results_of(result))
    raise LagrangeError(
        f"{annotation} is not a type of a parameter: use float, int, bool, In, Out, a record or a bundle."
    )


def results_of(annotation: Any) -> tuple[Kind, ...]:
    """Return the kinds of the results for a return annotation."""
    if annotation in (None, type(None)):
        return ()
    parts = typing.get_args(annotation) if typing.get_origin(annotation) is tuple else (annotation,)
    kinds = [type_of(part) for part in parts]
    return tuple(kind for kind in kinds if isinstance(kind, Kind))


def _parameter(p: Builder, name: str, stated: Stated) -> Any:
    """Add a parameter with a name and a type to the procedure that `p` builds, and return the parameter.

    For a bundle, one parameter is added for each field. If `stated` is a plain dataclass, the names of these
    parameters begin with `name`.
    """
    if stated is None:
        return None
    if isinstance(stated, tuple):
        return tuple(_parameter(p, f"{name}_{i}", part) for i, part in enumerate(stated))
    if isinstance(stated, Record):
        return p.record(name, stated)
    if isinstance(stated, Callee):
        return p.function(name, stated)
    if isinstance(stated, (Kind, Array)):
        return p.given(name, stated)
    bundle, prefix = (stated, "") if isinstance(stated, Bundle) else (Bundle(stated, {}), f"{name}_")
    hints = typing.get_type_hints(bundle.of, include_extras=True)
    fields = [field.name for field in dataclasses.fields(bundle.of)]
    types = {field: bundle.types[field] if field in bundle.types else type_of(hints[field]) for field in fields}
    return bundle.of(**{field: _parameter(p, prefix + field, part) for field, part in types.items()})


def _suffix(known: Mapping[str, Any]) -> str:
    """Return a suffix for a procedure's name, made of the values `known` of its static parameters.

    A true option adds its name; a number, text or enum member adds itself.
    """
    parts = []
    for name, value in known.items():
        if isinstance(value, bool):
            parts += [name] if value else []
        elif isinstance(value, (int, str)):
            parts.append(str(value).replace("-", "m"))
        elif isinstance(value, enum.Enum):
            parts.append(value.name.lower())
        else:
            parts += [getattr(value, "procedure_name", "")]
    return "".join(f"_{part}" for part in parts if part)


__all__ = ["Inline", "Plain", "inline", "procedure", "sys"]
