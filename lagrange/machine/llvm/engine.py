"""Compile LLVM IR to machine code, load it, and call it. Compiled code is cached in memory.

Code may be tiered: compiled quickly at first, and with optimization after many steps. Both versions do the same
operations in the same order, so that results agree to the last bit. LLVM reassociates or contracts operations only with
fast-math flags, which the code does not have.

An ordinary call through ctypes takes 0.1 us for each argument, and cannot return several results. A procedure therefore
reads its arguments from one array of 8-byte words, and writes its results to it.
"""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any
from weakref import WeakValueDictionary

import llvmlite.binding as llvm
import numpy as np

from lagrange.algorithm.linear.symmetric import (
    factor_dense,
    factor_pivoted,
    invert_dense,
    solve_factored,
    solve_pivoted,
)
from lagrange.machine.backend import Shared
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import argument_type, result_type, separated
from lagrange.machine.llvm.procedures import declaration, function, joined, module
from lagrange.machine.llvm.processor import start
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure, transitive_callees
from lagrange.statement.run_settings import check_time

CACHE_BYTES = 32_000_000
"""Largest total size of the compiled code in the cache, in bytes. The least recently used code is dropped first. A
right-hand side takes some 5 kB, a loop over steps of an implicit method 50 kB.
"""


class ObjectCode:
    """Cache in memory of object code (compiled modules), by the IR text. It holds up to `room` bytes.

    So a system that is stated again, or changed and changed back, is not compiled again.
    """

    def __init__(self, room: int = CACHE_BYTES) -> None:
        self._room, self._taken = room, 0
        self._codes: OrderedDict[bytes, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Empty the cache, for measurements of compile times."""
        with self._lock:
            self._codes.clear()
            self._taken = 0

    def of(self, text: str, how: str, compiled: Callable[[], bytes]) -> bytes:
        """Return the object code of the IR `text` from the cache. If it is missing, get it from `compiled()`.

        `how` names the compile options, which are part of the key of the cache.
        """
        key = hashlib.sha256(f"{how}\n{text}".encode()).digest()
        with self._lock:
            if key in self._codes:
                self._codes.move_to_end(key)
                return self._codes[key]
        code = compiled()  # No lock is held here: two threads that compile the same text get the same code.
        with self._lock:
            if key not in self._codes:
                self._codes[key] = code
                self._taken += len(code)
            while self._taken > self._room:
                _, oldest = self._codes.popitem(last=False)
                self._taken -= len(oldest)
        return code


_LOADING, _LINKING = threading.Lock(), threading.Lock()

_ENGINES: WeakValueDictionary[bytes, _Engine] = WeakValueDictionary()
"""Loaded code that is still in use, by the checksum of its object code."""

COMPILED = ObjectCode()

LARGE_MODULE = 1_000_000
"""Number of characters of IR, some 12,000 operations, above which code is compiled without optimization. The Jacobian
of a chain of 30 links (23,000 operations) then compiles in 1.2 s instead of 5.3 s, and runs 1.3 times as long (73 us).
No right-hand side of a scene is that large.
"""


def dense_solver() -> tuple[Procedure, ...]:
    """Return the procedures that factor matrices and solve linear systems. Kernels with large systems call them.

    `linear_solver` compiles their module.
    """
    return factor_pivoted.form(), solve_pivoted.form(), factor_dense.form(), solve_factored.form(), invert_dense.form()


class Module(Shared):
    """Machine code of the functions in one IR text. The code is loaded as long as this object exists."""

    is_final = True
    """True: this code is never replaced by optimized code, unlike that of a `TieredModule`."""

    def __init__(
        self, text: str, *, optimize: bool = False, merge: bool = False, quickly: bool = False, often: bool = False
    ) -> None:
        """Compile the functions of an IR text and load them.

        With `optimize` LLVM's passes run, except those that transform loops. With `merge` only the procedures marked
        for inlining are inlined, and their local arrays are kept in registers. With `quickly` code generation does not
        optimize, for code that runs rarely. Code generation does not optimize a large text either, unless the code runs
        `often`.
        """
        start()
        effort = 0 if quickly or (len(text) > LARGE_MODULE and not often) else 2
        passes = _optimize if optimize else _merge if merge else None
        how = f"{effort} {passes.__name__ if passes else ''}"
        self.ir = text
        self._engine = _loaded(COMPILED.of(text, how, lambda: _compiled(text, effort, passes)))
        self._addresses: dict[str, int] = {}

    def address(self, name: str) -> int:
        """Return the memory address of the function `name`."""
        if name not in self._addresses:
            self._addresses[name] = self._engine.address(name)
        return self._addresses[name]

    def count(self, steps: int) -> bool:
        """Return False: optimized code never replaces this code, however many `steps` it takes."""
        return False


def provide(procedures: Sequence[Procedure], code: Module) -> Module:
    """Let modules loaded later call `procedures`, whose machine code is in `code`, by name. Return `code`."""
    for procedure in procedures:
        llvm.add_symbol(procedure.name, code.address(procedure.name))
    return code


def _compiled(text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
    """Compile an IR text, and return its object code.

    `passes` runs LLVM's optimization passes: it is called with the parsed module and the target machine. None runs no
    passes. `effort` is the optimization level of code generation, 0 to 3.
    """
    check_time()
    parsed = llvm.parse_assembly(text)
    parsed.verify()
    machine = _target_machine(effort)
    if passes is not None:
        passes(parsed, machine)
    return bytes(machine.emit_object(parsed))


class _Engine:
    """The owner of an LLVM engine, the object of LLVM that loads code and owns its memory.

    `_ENGINES` has weak references to such owners. They expire before LLVM frees the engine. With weak references to
    the engine itself, another thread could still get the engine while LLVM frees it.
    """

    def __init__(self, engine: Any) -> None:
        self._engine = engine

    def address(self, name: str) -> int:
        """Return the memory address of the function `name`."""
        return int(self._engine.get_function_address(name))


def _loaded(code: bytes) -> _Engine:
    """Load object code, and return the engine that owns its memory.

    If the same object code is already loaded, its engine is returned.
    """
    key = hashlib.sha256(code).digest()
    with _LINKING:
        engine = _ENGINES.get(key)
        if engine is None:
            # An engine destroys its target machine. So it gets its own, which compiles nothing.
            idle = llvm.Target.from_default_triple().create_target_machine()
            linked = llvm.create_mcjit_compiler(llvm.parse_assembly(""), idle)
            linked.add_object_file(llvm.ObjectFileRef.from_data(code))
            linked.finalize_object()
            _ENGINES[key] = engine = _Engine(linked)
    return engine


def _optimize(module: Any, machine: Any) -> None:
    """Run LLVM's optimization passes on a parsed module, except those that unroll or vectorize loops.

    Those would take most of the compile time.
    """
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_unrolling = False
    options.loop_vectorization = options.loop_interleaving = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)


def _merge(module: Any, machine: Any) -> None:
    """Run only two of LLVM's passes: inline `alwaysinline` procedures, and keep local arrays in registers."""
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_sroa_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2)))


def linear_solver(*, often: bool) -> None:
    """Compile the procedures of `dense_solver`, so that modules loaded later can call them.

    They are compiled once per process, and once more with LLVM's passes when a model needs them `often`. The passes
    take 150 ms, longer than all other compilation for a small model. Without them the solver compiles in 5 ms.
    """
    # Without the lock, two threads that compile their first models could register symbols of a discarded module.
    with _LOADING:
        if often or not _linear_solver.cache_info().currsize:
            _linear_solver(often)


@cache
def _linear_solver(often: bool) -> Module:
    return provide(dense_solver(), Module(module(dense_solver()), optimize=often, quickly=not often))


def calling_solver(procedure: Procedure) -> Module:
    """Return the compiled module of a procedure that calls procedures of `dense_solver`.

    It is compiled once per process. Modules loaded later can call the procedure by its name.
    """
    linear_solver(often=False)
    with _LOADING:
        return _calling_solver(procedure)


@cache
def _calling_solver(procedure: Procedure) -> Module:
    return provide([procedure], Module(module([procedure], elsewhere=dense_solver())))


@cache
def _target_machine(effort: int = 2) -> Any:
    """Return LLVM's target machine (code generator) for this processor. `effort` is the optimization level, 0 to 3.

    There is one for each level, and all modules share it, because its set-up takes time.
    """
    start()
    features = llvm.get_host_cpu_features().flatten()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features, opt=effort
    )


STEPS_BEFORE_OPTIMIZING = 5000
"""Number of steps after which code is compiled with optimization. The series of a double pendulum compiles in 59 ms
with optimization and 19 ms without; a loop over Runge-Kutta steps in 77 and 18 ms. Steps without optimization take 1.1
to 1.5 times as long, and up to 2.6 times with Newton's method or ten coordinates. So 5,000 of them lose 1 to 40 ms.
"""

STEPS_BEFORE_LATE_OPTIMIZING = 200_000
"""Number of steps after which large code is compiled with optimization. The code for ensembles of a double pendulum in
lanes compiles in 1 to 4 s with optimization and 0.1 to 0.9 s without; steps take up to three times as long without it.
The loop over steps with events compiles in 0.7 and 0.2 s, and its steps take 1.1 to 1.6 times as long. So 200,000 steps
lose 0.02 to 0.2 s.
"""


class TieredModule(Shared):
    """A module with a function that takes steps, compiled twice: quickly at first, and optimized after many steps.

    `passes` are options of `Module` for the optimized version. Both versions are kept, because other runs may hold the
    address of the first. `needs(well=...)` is called before each compilation; it compiles the procedures of other
    modules that the code calls, optimized if `well`. With `late`, optimization waits for more steps, since it takes
    seconds. Threads may share a module.
    """

    def __init__(
        self, text: str, *, late: bool = False, needs: Callable[..., None] | None = None, **passes: bool
    ) -> None:
        self.ir, self._passes, self._needs = text, {**passes, "often": late}, needs
        if needs is not None:
            needs(well=False)
        self._quick = self._best = Module(text, quickly=True)
        self._left = STEPS_BEFORE_LATE_OPTIMIZING if late else STEPS_BEFORE_OPTIMIZING
        self._lock = threading.Lock()

    @property
    def is_final(self) -> bool:
        """True if the optimized version is compiled, so that addresses no longer change."""
        return self._best is not self._quick

    def address(self, name: str) -> int:
        """Return the address of the function `name` in the best version compiled so far."""
        return self._best.address(name)

    def count(self, steps: int) -> bool:
        """Count `steps` more steps of a run, and compile the optimized version after many steps.

        Return True if that version exists; then the addresses have changed. While another thread compiles it, this
        thread continues with the quick version.
        """
        self._left -= steps
        if self._left <= 0 and self._lock.acquire(blocking=False):
            try:
                if not self.is_final:
                    if self._needs is not None:
                        self._needs(well=True)
                    self._best = Module(self.ir, **self._passes)
            finally:
                self._lock.release()
        return self.is_final


_CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@lru_cache(maxsize=256)
def _function_at(code_address: int) -> Any:
    """Return a ctypes function that calls the machine code at an address, from a cache.

    To create such an object takes about as long as a call.
    """
    return _CALL(code_address)


STEPS = ("budget", "times", "rows")
"""Names of the last parameters of a loop over steps: largest number of steps, arrays for their times and states."""


class CompiledProcedure(Shared):
    """A procedure in machine code. Its arguments are numbers, NumPy arrays, records, and addresses of functions.

    With `tiers` it is compiled quickly at first, and again with optimization after many steps; with `late`, after more
    steps. With `optimize` LLVM runs more of its optimization passes. With `inlined` all callees are inlined unless they
    are `noinline`; otherwise LLVM chooses. The callees in `elsewhere` are compiled in other modules. `needs` is called
    before the code is compiled, to compile these modules.
    """

    def __init__(
        self,
        procedure: Procedure,
        *,
        tiers: bool = False,
        late: bool = False,
        optimize: bool = False,
        inlined: bool = True,
        elsewhere: Sequence[Procedure] = (),
        needs: Callable[..., None] | None = None,
    ) -> None:
        kinds = [parameter.type for parameter in procedure.parameters]
        self.places = {parameter.name: index for index, parameter in enumerate(procedure.parameters)}
        self.reals = frozenset(parameter.name for parameter in procedure.parameters if parameter.type is REAL)
        self.results = [(len(kinds) + i, kind) for i, kind in enumerate(procedure.results)]
        self.only_whole = len(kinds) if procedure.results == (WHOLE,) else None
        """Index, in the array of 8-byte words, of the only result if it is a whole number; None for other results."""
        text = called_ir(procedure, elsewhere, inlined=inlined)
        passes = {"optimize": optimize, "merge": not optimize}
        self.module: TieredModule | Module
        if tiers:
            self.module = TieredModule(text, late=late, needs=needs, **passes)
        else:
            self.module = Module(text, **passes)

    @property
    def run(self) -> Any:
        """The compiled function. Its argument is the address of an array of 8-byte words for arguments and results.

        The function changes when optimized code replaces the quickly compiled code.
        """
        return _function_at(self.module.address("run"))

    @property
    def steps(self) -> int:
        """Address of the compiled function `steps`, by which other compiled code calls this loop over steps."""
        return self.module.address("steps")

    def bound(self) -> CompiledCall:
        """Return an object that stores arguments of the procedure, and runs the procedure with them when called."""
        return CompiledCall(self)

    def __call__(self, *args: Any) -> Any:
        """Run the procedure with arguments in the order of its parameters. Arrays must be contiguous."""
        call = self.bound()
        call.give(**dict(zip(self.places, args, strict=True)))
        return call()


class CompiledCall:
    """Stored arguments of a compiled procedure. Calling the object runs the procedure with them."""

    def __init__(self, code: CompiledProcedure) -> None:
        self.code, self._run = code, code.run
        self.words = np.zeros(len(code.places) + len(code.results), dtype=np.int64)
        self._wholes: Any = self.words.data
        self._reals: Any = self.words.view(np.float64).data
        self._address = address(self.words)
        self._kept: dict[str, Any] = {}
        self.is_final = code.module.is_final
        """True if the present code will not be replaced by optimized code."""

    def give(self, **arguments: Any) -> None:
        """Set arguments of the procedure by name. None means no array or no function; unknown names are ignored."""
        indices, reals, references, words = self.code.places, self.code.reals, self._kept, self._wholes
        for name, value in arguments.items():
            if name in reals:
                self._reals[indices[name]] = value
            elif name in indices:
                references[name], words[indices[name]] = value, _word(value)

    def __call__(self) -> Any:
        """Run the procedure with the stored arguments; return None, a value or a tuple of values."""
        self._run(self._address)
        if self.code.only_whole is not None:
            return self._wholes[self.code.only_whole]
        results = [
            self._reals[index] if kind is REAL else bool(self._wholes[index]) if kind is FLAG else self._wholes[index]
            for index, kind in self.code.results
        ]
        return results[0] if len(results) == 1 else tuple(results) or None

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code has now replaced the quickly compiled code."""
        if self.is_final or not self.code.module.count(steps):
            return False
        self._run, self.is_final = self.code.run, True
        return True


def _word(value: Any) -> int:
    """Return the 8-byte word that passes an argument: the address of an array or record, an integer, or 0 for None."""
    if isinstance(value, np.ndarray):
        return address(value)
    if isinstance(value, ctypes.Structure):
        return ctypes.addressof(value)
    return 0 if value is None else int(value)


@lru_cache(maxsize=64)
def compiled(procedure: Procedure) -> CompiledProcedure:
    """Return a procedure compiled to machine code, from a cache if it was compiled before."""
    return CompiledProcedure(procedure)


def called_ir(procedure: Procedure, elsewhere: Sequence[Procedure] = (), *, inlined: bool = True) -> str:
    """Return the IR of a procedure, and of a function `run` by which Python calls it.

    The only argument of `run` is an array of 8-byte words for arguments and results. Callees in `elsewhere` are
    declared but not defined. With `inlined`, all other callees are inlined unless they are `noinline`. Otherwise LLVM
    chooses. If the procedure is a loop over steps (its last parameters are `STEPS`), the IR also has a function
    `steps`, by which other compiled loops call it.
    """
    callees = transitive_callees([procedure], elsewhere)
    functions = [
        function(callee, hidden=True, merged=inlined and not (callee is procedure or callee.noinline))
        for callee in callees
    ]
    functions.append(_run(procedure))
    if [parameter.name for parameter in procedure.parameters][-len(STEPS) :] == list(STEPS):
        functions.append(_steps(procedure))
    return joined(functions, [declaration(callee) for callee in elsewhere])


def _steps(procedure: Procedure) -> str:
    """Return the IR of the function `steps`, of the type `TAKE_STEPS`, by which another compiled loop takes steps.

    Its first argument is the array of words that the function `run` reads. Its next three arguments are arrays whose
    addresses are also in these words. They tell LLVM that a call changes these arrays.
    """
    e = Emitter()
    indices = {parameter.name: index for index, parameter in enumerate(procedure.parameters)}
    for name in STEPS:
        e.put(f"%{name}", "%words", indices[name], "i64" if name == "budget" else "ptr")
    e.do("call void @run(ptr %words)")
    e.do(f"ret i64 {e.get('%words', len(indices), 'i64')}")
    return e.function(
        "define i64 @steps(ptr %words, ptr %reals, ptr %counts, ptr %work, i64 %budget, ptr %times, ptr %rows)"
    )


def _run(procedure: Procedure) -> str:
    """Return the IR of the function `run`, which calls a procedure with arguments from an array of 8-byte words.

    It writes the results into the words after the arguments. A flag is stored as an integer.
    """
    e = Emitter()
    arguments = []
    for index, parameter in enumerate(procedure.parameters):
        kind = argument_type(WHOLE if parameter.type is FLAG else parameter.type)
        word = e.get("%words", index, kind)
        arguments.append(f"i1 {e.value(f'icmp ne i64 {word}, 0')}" if parameter.type is FLAG else f"{kind} {word}")
    call = f"call {result_type(procedure.results)} @{procedure.name}({', '.join(arguments)})"
    if procedure.results:
        results = separated(e, [argument_type(kind) for kind in procedure.results], e.value(call))
        for i, (result_kind, result) in enumerate(zip(procedure.results, results, strict=True)):
            is_flag = result_kind is FLAG
            word = e.value(f"zext i1 {result} to i64") if is_flag else result
            e.put(word, "%words", len(arguments) + i, argument_type(WHOLE if is_flag else result_kind))
    else:
        e.do(call)
    e.do("ret void")
    return e.function("define void @run(ptr %words) #0")
