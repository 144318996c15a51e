"""Ensembles: each member equals its single run, whatever the other members do and however they are divided."""

import multiprocessing
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.members import jobs, store
from lagrange.members.jobs import processors, threads_of
from tests.models import shared_scene as system
from tests.refusals import refusal
from tests.systems import rod_pendulum

METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "tsit5": {"rtol": 1e-7, "atol": 1e-9},
    "rk4": {"step": 0.01},
    "verlet": {"step": 0.01},
    "radau5": {"rtol": 1e-7},
}
"""Methods that run in lanes, and one that does not."""

SPREAD = 21
"""Members: two vectors of eight and five more, so that lanes run out of members at different times."""


def starts(name: str) -> dict[str, Any]:
    first, value = next(iter(zip(system(name).compile().layout.names(), system(name).statement.initial, strict=False)))
    return {first: value + np.linspace(-0.2, 0.25, SPREAD)}


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["pendulum", "henon-heiles", "double-pendulum"])
def test_a_member_ends_where_a_run_of_its_own_ends(name: str, method: str) -> None:
    """Lanes and single runs differ by rounding, which grows by less than a factor of 100 until t = 3."""
    if (name, method) == ("double-pendulum", "verlet"):
        pytest.skip("its mass matrix changes along the motion")
    initial, settings = starts(name), METHODS[method]
    runs = lg.ensemble(system(name), 3.0, initial, method=method, keep=("end", "counts"), **settings)
    assert set(runs.status) == {lg.Status.SUCCESS} and not runs.messages and (runs.t == 3.0).all()
    key = next(iter(initial))
    for i in (0, 7, 8, SPREAD - 1):
        alone = system(name).run(3.0, {key: initial[key][i]}, method=method, **settings)
        assert np.allclose(runs.y[:, i], alone.y[:, -1], rtol=1e-11, atol=1e-12), (i, runs.y[:, i] - alone.y[:, -1])
        assert runs.steps[i] == alone.steps


def test_parameters_vary_and_outputs_are_those_of_a_run() -> None:
    times = np.array([0.0, 0.1, 0.1, 1.3, 2.0])
    drawn = lg.sample({"l": (0.5, 1.5), "g": (9.0, 10.0)}, 13, seed=3)
    runs = lg.ensemble(system("pendulum"), 2.0, parameters=drawn, t_eval=times)
    assert runs.y.shape == (2, 5, 13)
    for i in (0, 6, 12):
        alone = system("pendulum").run(2.0, parameters={"l": runs["l"][i], "g": runs["g"][i]}, t_eval=times)
        assert np.allclose(runs.y[:, :, i], alone.y, rtol=1e-12, atol=1e-13)


def test_a_member_that_fails_says_why_and_stops_where_a_run_stops() -> None:
    runs = lg.ensemble(system("henon-heiles"), 15.0, {"x": [0.1, 1.0, 0.2]}, t_eval=[1.0, 14.0, 15.0])
    assert [item.value for item in runs.status] == ["success", "step_too_small", "success"]
    alone = system("henon-heiles").run(15.0, {"x": 1.0}, t_eval=[1.0, 14.0, 15.0])
    assert list(runs.messages) == [1] and "singularity there" in runs.messages[1]
    assert repr(runs.messages).startswith("<messages of 1 member, of member 1: taylor stopped at")
    assert runs.messages[1].split(" on the way")[0] == alone.message.split(" on the way")[0]
    assert np.isnan(runs.y[:, 1:, 1]).all() and np.isfinite(runs.y[:, 0, 1]).all()
    assert np.isfinite(runs.y[:, :, [0, 2]]).all()


def test_an_energy_that_moves_is_told_as_in_a_run() -> None:
    settings: dict[str, Any] = {"method": "euler", "step": 0.1}
    runs = lg.ensemble(system("pendulum"), 60.0, {"theta": [0.01, 2.5]}, **settings)
    for i, theta in enumerate((0.01, 2.5)):
        alone = system("pendulum").run(60.0, {"theta": theta}, **settings)
        assert runs.status[i] is alone.status
        assert runs.status[i] is lg.Status.SUCCESS or runs.messages[i] == alone.message


def test_a_grid_is_every_combination_and_a_sample_is_repeated_by_its_seed() -> None:
    runs = lg.ensemble(system("pendulum"), 0.1, lg.grid({"theta": (0.0, 1.0, 3), "l": [1.0, 2.0]}))
    assert runs["l"].tolist() == [1.0, 2.0] * 3 and runs.given("theta").tolist() == [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]
    result = runs.to_xarray()
    assert dict(result.sizes) == {"theta": 3, "l": 2} and result["theta_dot"].dims == ("theta", "l")
    path = lg.ensemble(system("pendulum"), 0.1, lg.grid({"theta": (0.0, 1.0, 3)}), t_eval=[0.0, 0.1]).to_xarray()
    assert path["theta"].dims == ("theta_start", "t")
    assert np.array_equal(path["theta"][:, 0], path["theta_start"]) and path["theta_start"][2] == 1.0
    for method in ("sobol", "latin", "random"):
        first, second, third = (lg.sample({"m": (0.9, 1.1)}, 37, seed=seed, method=method) for seed in (5, 5, 6))
        every = np.arange(37)
        assert np.array_equal(first.values("m", every), second.values("m", every))
        assert not np.array_equal(first.values("m", every), third.values("m", every))
        assert first.values("m", every).min() >= 0.9 and first.values("m", every).max() <= 1.1


@pytest.mark.slow
def test_what_is_kept_has_its_name_and_the_pair_that_it_was_asked_by() -> None:
    x = system("henon-heiles").coordinates[0]
    starts, times = {"x": [0.1, 0.2]}, [0.5, 1.0]
    runs = lg.ensemble(system("henon-heiles"), 1.0, starts, keep=("end", ("max", x.dot), ("mean", "y")))
    assert np.array_equal(runs["max", x.dot], runs["max(x_dot)"])
    assert np.array_equal(runs["mean", "y"], runs["mean(y)"])
    alone = lg.ensemble(system("henon-heiles"), 1.0, starts, keep=("max", "x_dot"))
    assert np.array_equal(alone["max(x_dot)"], runs["max(x_dot)"])
    with pytest.raises(lg.StatementError, match="state was not kept"):
        _ = alone["x_end"]
    outputs = lg.ensemble(system("henon-heiles"), 1.0, starts, t_eval=times)
    for row, name in enumerate(runs.names):
        assert np.array_equal(runs[f"{name}_end"], runs.y[row])
        assert np.array_equal(outputs[f"{name}_end"], outputs.y[row, -1])
    for name, entry in (("drift", '"drift"'), ("rejected", '"counts"'), ("min(x)", '("min", x)')):
        with pytest.raises(lg.StatementError, match=f"{re.escape(name)} was not kept: add {re.escape(entry)} to keep"):
            _ = runs[name]
    with pytest.raises(lg.StatementError, match="'z_end' is not a coordinate"):
        _ = runs["z_end"]


REFUSALS: list[tuple[dict[str, Any], str]] = [
    (
        {"initial": {"theta1": [1.0] * 3, "theta2": [1.0] * 4}},
        "theta1 has 3 values and theta2 has 4 values: give arrays",
    ),
    (
        {"initial": {"theta3": [1.0]}},
        "'theta3' varies, and is not a coordinate, velocity or parameter of double-pendulum",
    ),
    ({"initial": {"theta1": 1.0}}, "no value varies between members"),
    ({"initial": 3}, "initial is 3: give a dict from name to number or array"),
    ({"initial": {"theta1": [1.0]}, "parameters": {"m3": 1.0}}, "'m3' is not a parameter of this system"),
    ({"initial": {"theta1": [1.0]}, "keep": ("ends",)}, "keep has 'ends', which is none of end, counts"),
    (
        {"initial": {"theta1": [1.0]}, "keep": ()},
        'keep is (): give at least one result, such as ("end", ("max", theta)).',
    ),
    ({"initial": {"theta1": [1.0]}, "keep": ("events",)}, "keep has events, and the ensemble has none"),
    ({"initial": {"theta1": [1.0]}, "keep": (("max", lg.coordinate("w")),)}, "contains w(t), which this"),
    (
        {"initial": {"theta1": [1.0]}, "keep": (("median", lg.coordinate("theta1")),)},
        "keep has ('median', theta1), which is none of",
    ),
    (
        {"initial": {"theta1": [1.0]}, "keep": ("max", "theta3")},
        "'theta3' in keep is neither a coordinate nor a velocity; these are theta1, theta2, theta1_dot and theta2_dot.",
    ),
    ({"initial": {"theta1": [1.0]}, "executor": 3, "workers": 2}, "workers and executor are both given"),
    ({"initial": lg.grid({"theta1": (0, 1, 10**6), "theta2": (0, 1, 10**5)})}, 'give store="runs.zarr"'),
    ({"initial": {"theta1": [1.0]}, "step": 0.1}, "taylor chooses its steps by itself"),
    ({"initial": {"theta1": [1.0, 2.0]}, "parameters": {"m1": [1.0]}}, "theta1 has 2 values and m1 has 1 value"),
    (
        {"initial": lg.grid({"theta1": (0, 1, 3)}), "parameters": {"m1": [1.0, 2.0]}},
        "or, for all combinations, one lg.grid(...) of all that varies.",
    ),
]


@pytest.mark.parametrize(("request_", "text"), REFUSALS, ids=[text[:30] for _, text in REFUSALS])
def test_what_cannot_be_meant_is_refused(request_: dict[str, Any], text: str) -> None:
    assert text in refusal(lg.ensemble, system("double-pendulum"), 1.0, **request_)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: lg.grid({}), "axes is empty: give a dict"),
        (lambda: lg.grid({"x": []}), "the axis x is []: give (low, high, count)"),
        (lambda: lg.sample({"x": "wide"}, 3), "the range of x is 'wide': give (low, high), or a distribution"),
        (lambda: lg.sample({"x": (0.0, 1.0)}, 3, method="sobal"), "Did you mean 'sobol'?"),
        (lambda: lg.ensemble(cast(Any, "double-pendulum"), 1.0), "is not a system"),
    ],
)
def test_grids_and_samples_refuse_in_words(make: Any, text: str) -> None:
    assert text in refusal(make)


# --- flows ----------------------------------------------------------------------------------------------------
# Members one after the other of which only the last state is kept: they end as runs do, and fail as runs do.


@pytest.mark.parametrize(("method", "settings"), [("taylor", {"rtol": 1e-9}), ("radau5-index2", {"rtol": 1e-6})])
def test_members_with_constraints_end_where_runs_end(method: str, settings: dict[str, Any]) -> None:
    rod, angles = rod_pendulum(), np.linspace(0.0, 1.5, 5)
    runs = lg.ensemble(rod, 1.0, {"x": np.cos(angles), "y": -np.sin(angles)}, method=method, **settings)
    assert runs.form == "runs one after the other"
    for i, angle in enumerate(angles):
        alone = rod.run(1.0, {"x": np.cos(angle), "y": -np.sin(angle)}, method=method, **settings)
        assert runs.y[:, i].tobytes() == alone.y[:, -1].tobytes(), i


# --- one ensemble in many partitions: the bits of a member do not depend on the partition ----------------------


COUNT = 53
"""Members: lanes run out of them at different times, and some leave."""
ORDER = np.random.default_rng(1).permutation(COUNT)
VALUES = np.linspace(-1.0, 1.0, COUNT)

Columns = dict[str, Any]


@cache
def model() -> Any:
    return lg.scene("henon-heiles").compile()


def run(which: Any = slice(None), **options: Any) -> Columns:
    """Return the results of some members."""
    starts = {"x": VALUES[which], "y": 0.3 * VALUES[::-1][which]}
    x, y = model().statement.coordinates
    keep: tuple[Any, ...] = ("end", "drift", ("max", x), ("min", x**2 - y), ("mean", y))
    # Members with events may leave their lanes, where evaluations are counted in another way.
    if watched := options.pop("watched", False):
        options["events"] = [lg.event(x, terminal=2), y]
    keep = (*keep, ("events", 3) if watched else "counts")
    runs = lg.ensemble(model(), 15.0, starts, keep=keep, t_eval=[1.0, 7.5, 15.0], **options)
    return {column.name: runs.results.column(column.name) for column in runs.columns}


@cache
def whole(method: str, *, watched: bool) -> Columns:
    return run(method=method, workers=1, watched=watched)


def ordered(order: Any, **options: Any) -> Columns:
    """Run members in another order, and return their results in the original order."""
    return {name: rows[np.argsort(order)] for name, rows in run(order, **options).items()}


def in_parts(parts: list[Any], **options: Any) -> Columns:
    """Run members in several smaller ensembles."""
    right = whole(options["method"], watched=options["watched"])
    result = {name: np.empty_like(rows) for name, rows in right.items()}
    for part in parts:
        for name, rows in run(part, **options).items():
            result[name][part] = rows
    return result


@contextmanager
def spawned() -> Iterator[Any]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


@contextmanager
def clustered(**options: Any) -> Iterator[Any]:
    distributed: Any = pytest.importorskip("distributed")
    with distributed.LocalCluster(dashboard_address=None, **options) as cluster, distributed.Client(cluster) as client:
        yield client


def executed(made: Callable[[], Any], **options: Any) -> Columns:
    with made() as executor:
        return run(executor=executor, **options)


def stored(folder: Path, **options: Any) -> Columns:
    pytest.importorskip("zarr")
    run(store=folder / "runs.zarr", **options)
    return run(store=folder / "runs.zarr", **options)


EVERY = list(range(COUNT))
PARTITIONS: Mapping[str, tuple[int, Callable[..., Columns]]] = {
    **{
        f"chunks of {size} on {workers} threads": (size, lambda folder, w=workers, **o: run(workers=w, **o))
        for size, workers in ((1, 1), (1, 3), (5, 2), (8, 1), (8, 3), (11, 2), (64, 2))
    },
    "last first": (64, lambda folder, **o: ordered(np.array(EVERY[::-1]), **o)),
    "any order": (64, lambda folder, **o: ordered(ORDER, **o)),
    "any order in small chunks": (3, lambda folder, **o: ordered(ORDER, workers=2, **o)),
    "every other one": (64, lambda folder, **o: in_parts([EVERY[::2], EVERY[1::2]], **o)),
    "one by one": (64, lambda folder, **o: in_parts([[i] for i in EVERY], workers=1, **o)),
    "parts of different lengths": (64, lambda folder, **o: in_parts([EVERY[:3], EVERY[3:20], EVERY[20:]], **o)),
    "a pool of threads": (7, lambda folder, **o: executed(lambda: ThreadPoolExecutor(3), **o)),
    "a store": (64, stored),
    "a store of small blocks": (5, lambda folder, **o: stored(folder, workers=2, **o)),
}
ELSEWHERE: Mapping[str, tuple[int, Callable[..., Columns]]] = {
    "processes": (7, lambda folder, **o: executed(spawned, **o)),
    "processes and a store": (7, lambda folder, **o: executed(spawned, store=folder / "runs.zarr", **o)),
    "a cluster": (7, lambda folder, **o: executed(lambda: clustered(n_workers=2, threads_per_worker=1), **o)),
    "a cluster of threads": (9, lambda folder, **o: executed(lambda: clustered(n_workers=1, processes=False), **o)),
}
"""Partitions whose workers take seconds to start."""

PARTITIONED = ("taylor", "dop853", "rk4", "verlet", pytest.param("radau5", marks=pytest.mark.slow))


def same(
    partition: tuple[int, Callable[..., Columns]],
    method: str,
    folder: Path,
    patch: pytest.MonkeyPatch,
    *,
    watched: bool = False,
) -> None:
    size, result = partition
    right = whole(method, watched=watched)
    patch.setattr(jobs, "FIRST_CHUNK", min(size, 8))
    patch.setattr(jobs, "LARGEST_CHUNK", size)
    patch.setattr(store, "LARGEST_BLOCK", size)
    given = result(folder, method=method, watched=watched)
    assert set(given) == set(right)
    assert method != "taylor" or len(set(right["status"].tolist())) >= 2, "all members end in the same way"
    for name, rows in right.items():
        assert given[name].tobytes() == rows.tobytes(), name


@pytest.mark.parametrize("method", PARTITIONED)
@pytest.mark.parametrize("partition", PARTITIONS)
def test_a_partition(partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(PARTITIONS[partition], method, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "verlet"])
@pytest.mark.parametrize("partition", ["chunks of 1 on 3 threads", "any order in small chunks"])
def test_a_partition_of_runs_with_events(
    partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same(PARTITIONS[partition], method, tmp_path, monkeypatch, watched=True)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["taylor", "radau5"])
@pytest.mark.parametrize("partition", ELSEWHERE)
def test_a_partition_elsewhere(partition: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(ELSEWHERE[partition], method, tmp_path, monkeypatch)


# The largest memory since this program began; that of `getrusage` counts what the process had that started it.
MEMORY = """
import sys
import lagrange as lg
model = lg.scene("double-pendulum").compile()
grid = lg.grid({"theta1": (-3, 3, 1000), "theta2": (-3, 3, int(sys.argv[1]) // 1000)})
options = {"store": sys.argv[2]} if len(sys.argv) > 2 else {}
runs = lg.ensemble(model, 0.05, grid, **options)
lines = open("/proc/self/status").read().splitlines()
peak = next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
kept = 0 if options else sum(column.bytes for column in runs.columns) * len(runs)
print(peak - kept)
"""


def peak(*arguments: str) -> int:
    done = subprocess.run([sys.executable, "-c", MEMORY, *arguments], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells the memory of a program alone")
def test_memory_is_bounded(tmp_path: Path) -> None:
    """A million members need less than 500 MB beside their results, a store with five times as many no more."""
    pytest.importorskip("zarr")
    assert peak("1000000") < 500e6
    few, many = (peak(str(count), str(tmp_path / f"{count}.zarr")) for count in (400_000, 2_000_000))
    # An allocator keeps some of what it was given back.
    assert many < 500e6 and many - few < 50e6


# --- workers --------------------------------------------------------------------------------------------------
# Workers on other hardware: they run members by other code, and the result says that digits may differ.


STARTS = {"x": np.linspace(-0.3, 0.3, 13)}


def without_llvmlite() -> None:
    """Make imports of llvmlite fail, as if it were not installed."""
    gone: Any = None
    sys.modules.update({"llvmlite": gone, "llvmlite.binding": gone})


def on_a_smaller_processor() -> None:
    """Compile code for vectors of four numbers."""
    llvm: Any = pytest.importorskip("llvmlite.binding")
    features = llvm.get_host_cpu_features()
    features.update({name: False for name in features if name.startswith("avx512")})
    llvm.get_host_cpu_name, llvm.get_host_cpu_features = lambda: "haswell", lambda: features


def ran(begin: Callable[[], None]) -> lg.Ensemble:
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=begin) as executor:
        return lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS, executor=executor)


@pytest.mark.slow
def test_a_worker_without_a_compiler_runs_by_numpy() -> None:
    runs = ran(without_llvmlite)
    assert runs.form.startswith("runs one after the other by numpy; a worker has no llvmlite: the last digits may")
    here = lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS)
    assert np.allclose(runs.y, here.y, rtol=1e-9, atol=1e-10) and "digits" not in here.form


@pytest.mark.slow
def test_a_worker_of_another_processor_compiles_for_it() -> None:
    pytest.importorskip("llvmlite")
    runs = ran(on_a_smaller_processor)
    assert "4 members side by side; workers compiled for haswell with vectors of 4, not for" in runs.form
    assert "the last digits may differ from those of this machine" in runs.form
    assert np.allclose(runs.y, lg.ensemble(lg.scene("henon-heiles"), 3.0, STARTS).y, rtol=1e-12, atol=1e-13)


def test_a_machine_without_a_compiler_runs_ensembles_by_numpy() -> None:
    model = lg.scene("pendulum").compile(target="numpy")
    runs = lg.ensemble(model, 1.0, {"theta": [0.1, 0.2]}, method="rk4", step=0.1)
    assert runs.form == "runs one after the other by numpy"


# --- threads --------------------------------------------------------------------------------------------------
# The number of threads of an ensemble.


def test_ensembles_run_on_the_processors_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 8}, raising=False)
    assert threads_of(None) == processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert threads_of(None) == 7
    with pytest.raises(StatementError, match="workers = 2000: give a whole number from 1 to 1024"):
        lg.ensemble(lg.scene("pendulum"), 1.0, {"theta": [1.0, 2.0]}, workers=2000)


# --- names of stored quantities are unique, in memory, in a data set and in a store ----------------------------


NAMED_STARTS = {"theta": [0.1, 0.2]}
theta, speed = lg.coordinate("theta"), lg.coordinate("theta").dot
ONE = sp.Rational(10**90 + 1, 10**90)
"""Written out it is longer than a name."""


def pendulum(**options: Any) -> lg.Ensemble:
    return lg.ensemble(lg.scene("pendulum"), 1.0, NAMED_STARTS, **options)


def spring(name: str, **options: Any) -> lg.Ensemble:
    stiffness = sp.Symbol(name)
    system = lg.System(kinetic=speed**2 / 2, potential=stiffness * theta**2 / 2, parameters={stiffness: 1.0})
    return lg.ensemble(system, 1.0, {"theta": [1.0, 1.0]}, parameters={name: [1.0, 2.0]}, **options)


@pytest.mark.slow
def test_expressions_that_begin_alike_are_kept_apart() -> None:
    nearly, more = ONE * theta, ONE * theta**2
    runs = pendulum(keep=(("max", nearly), ("max", more), ("max", nearly)))
    first, second = (column.name for column in runs.columns if column.name.startswith("max"))
    for name, expression in ((first, nearly), (second, more)):
        alone = pendulum(keep=(("max", expression),))
        # Two expressions are compiled together, and one alone, which may round otherwise.
        assert np.allclose(runs[name], alone[alone.columns[-1].name], rtol=1e-14)
    assert (runs[second] < 0.5 * runs[first]).all()


KEPT: dict[str, tuple[Any, Any]] = {
    "letters that a name leaves out": (("max", ONE * theta), ("max", ONE * theta**2)),
    "last digits": (("max", sp.Float(0.1) * theta), ("max", sp.Float(np.nextafter(0.1, 1.0)) * theta)),
    "occurrences": (("events", 1), ("events", 2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("which", KEPT)
def test_a_store_of_other_expressions_is_refused(tmp_path: Path, which: str) -> None:
    pytest.importorskip("zarr")
    first, other = KEPT[which]
    given = {"events": [theta], "store": tmp_path / "runs.zarr"}
    pendulum(keep=(first,), **given)
    assert pendulum(keep=(first,), **given).form == "all members were stored"
    assert re.search(r"differs in (expressions|occurrences)", refusal(pendulum, keep=(other,), **given))


@pytest.mark.parametrize("name", ["status", "t_end", "member", "steps", "theta_end", "theta_start"])
def test_a_parameter_called_as_what_is_kept_is_refused(name: str) -> None:
    assert re.search(f"^the system has the name {name!r}, which is also", refusal(spring, name, keep=("end", "counts")))


def test_a_name_that_is_free_is_taken(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    assert np.array_equal(spring("steps")["steps"], [1.0, 2.0])
    assert np.array_equal(spring("checksum")["checksum"], [1.0, 2.0])
    assert re.search(r"^the system has the name 'checksum'", refusal(spring, "checksum", store=tmp_path / "runs.zarr"))


@pytest.mark.parametrize(
    "starts", [NAMED_STARTS, lg.grid({"theta": [0.1, 0.2], "l": [1.0, 2.0]})], ids=["arrays", "grid"]
)
def test_a_data_set_tells_states_at_times_from_starts(starts: Any) -> None:
    pytest.importorskip("xarray")
    runs = lg.ensemble(lg.scene("pendulum"), 1.0, starts, t_eval=[0.0, 0.5, 1.0])
    result = runs.to_xarray()
    assert np.array_equal(np.unique(result["theta_start"]), [0.1, 0.2])
    assert np.array_equal(result["theta"].to_numpy().reshape(len(runs), 3), runs["theta"].T)
