"""Wrong starts, grids, samples, executors and stores are refused with messages."""

import json
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.stats import norm, qmc

import lagrange as lg
from lagrange.members import store, table

THREE = [0.1, 0.2, 0.3]


@cache
def model() -> Any:
    return lg.scene("pendulum").compile()


def run(initial: Any = None, **options: Any) -> lg.Ensemble:
    return lg.ensemble(model(), 0.1, {"theta": THREE} if initial is None else initial, **options)


def refused(make: Any, *texts: str, error: type[Exception] = lg.StatementError) -> None:
    with pytest.raises(error) as refusal:
        make()
    for text in texts:
        assert text in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


class Columns:
    """An array of another package, such as a pandas Series."""

    ndim = 1

    def __init__(self, values: Any) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return np.array(self.values, dtype=dtype)

    def __len__(self) -> int:
        return len(self.values)


def test_what_numpy_takes_for_an_array_is_one() -> None:
    whole = run({"theta": [0.0, 1.0, 2.0]}).y
    for given in (range(3), Columns([0.0, 1.0, 2.0]), (0, 1, 2), np.arange(3, dtype="f2")):
        assert np.array_equal(run({"theta": given}).y, whole)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ([1.0, np.nan], "theta is nan for member 1: give finite values."),
        ([np.inf, 1.0], "theta is inf for member 0: give finite values."),
        ([1j, 2.0], "theta has entries of type complex128: give real numbers."),
        (["a", "b"], "theta has entries of type <U1: give real numbers."),
        ([True, False], "theta has entries of type bool: give real numbers."),
        ([None, 1.0], "theta has entries of type object: give real numbers."),
        ([[1.0, 2.0], [3.0]], "theta is not an array"),
        ([[1.0, 2.0]], "theta has an array of shape (1, 2): give (members,)"),
        ([], "theta has an array without values"),
        (np.ma.array([1.0, 2.0], mask=[False, True]), "theta is a masked array"),
        (Columns([1.0, np.nan]), "theta is nan for member 1"),
        (np.array(1.0), "no value varies between members"),
        ({1.0, 2.0}, "theta is {1.0, 2.0} (set): give a number."),
        ("abc", "theta is 'abc' (str): give a number."),
        (None, "theta is None: give a number."),
    ],
)
def test_starts_that_are_no_numbers(given: Any, text: str) -> None:
    refused(lambda: run({"theta": given}), text)
    refused(lambda: run({}, parameters={"l": given}), text.replace("theta", "l"))


def test_a_name_that_has_two_values() -> None:
    theta = model().statement.coordinates[0]
    refused(lambda: run({theta: THREE, "theta": 1.0}), "theta has both varying values and a single value")
    refused(lambda: run({theta: THREE, "theta": THREE}), "the values of theta are given twice")
    refused(lambda: run(parameters={"l": THREE, sp.Symbol("l"): 1.0}), "l has both varying values")
    refused(lambda: lg.grid({theta: THREE, "theta": THREE}), "axes has theta twice")
    refused(lambda: lg.sample({theta: (0, 1), "theta": (0, 1)}, 3), "ranges has theta twice")


@pytest.mark.parametrize(
    ("axis", "text"),
    [
        ((0, 1, 0), "the number of values of theta = 0: give a whole number from 1"),
        ((0, 1, 1.5), "the number of values of theta = 1.5"),
        ((0, 1, True), "the number of values of theta is True (bool)"),
        ((0, 1, "3"), "the number of values of theta is '3' (str)"),
        ((0, 1, 10**12), "the number of values of theta = 1000000000000: give a whole number from 1 to"),
        ((0, 1, 1), "theta has 1 value between 0 and 1, and both ends belong to it"),
        ((np.nan, 1, 3), "an end of theta is nan"),
        ((0, np.inf, 3), "an end of theta is inf"),
        ((-1e308, 1e308, 3), "give (low, high, count), or a list of finite values."),
        ((0, 1), "the axis theta is (0, 1): give (low, high, count), or a list"),
        (2.0, "the axis theta is 2.0"),
        ("wide", "theta is the text 'wide': give real numbers"),
        (np.zeros((2, 2)), "the axis theta is array"),
        (np.ma.array([1.0, 2.0], mask=[False, True]), "theta is a masked array"),
    ],
)
def test_an_axis_without_values(axis: Any, text: str) -> None:
    refused(lambda: lg.grid({"theta": axis}), text)


class Distribution:
    """A probability distribution whose quantiles are given by a function."""

    def __init__(self, quantile: Any) -> None:
        self.ppf = quantile


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((1, 1), "the range of theta goes from 1 to 1"),
        ((0, 1, 2), "the range of theta is (0, 1, 2): give (low, high), or a distribution"),
        ((0, np.inf), "an end of theta is inf"),
        (norm(0, -1), "the distribution of theta gives nan as a value"),
        (norm([0, 1], 1), "the distribution of theta gives no values"),
        (
            Distribution(lambda parts: 1.0),
            "the distribution of theta returns values of shape () for probabilities of shape (4,)",
        ),
        (Distribution(lambda parts: parts * 1j), "the distribution of theta has entries of type complex128"),
    ],
)
def test_a_distribution_without_values(given: Any, text: str) -> None:
    refused(lambda: lg.sample({"theta": given}, 4), text)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"count": 0}, "count, the number of members, = 0"),
        ({"count": 1.5}, "count, the number of members, = 1.5"),
        ({"count": True}, "count, the number of members, is True"),
        ({"count": 10**13}, "count, the number of members, = 10000000000000: give a whole number from 1 to"),
        ({"seed": -1}, "seed = -1: give a whole number of at least 0"),
        ({"seed": None}, "seed is None"),
        ({"method": None}, "the methods of a sample are sobol, latin and random"),
    ],
)
def test_a_sample_of_no_number(options: dict[str, Any], text: str) -> None:
    refused(lambda: lg.sample({"theta": (0, 1)}, **{"count": 3, **options}), text)


class Giving:
    """An executor that always returns one given object, or raises it."""

    def __init__(self, given: Any) -> None:
        self.given = given

    def submit(self, *args: Any) -> Any:
        if isinstance(self.given, Exception):
            raise self.given
        return self.given


def future(given: Any) -> Future[Any]:
    made: Future[Any] = Future()
    if isinstance(given, Exception):
        made.set_exception(given)
    else:
        made.set_result(given)
    return made


def test_executors_that_run_nothing() -> None:
    closed = ThreadPoolExecutor(1)
    closed.shutdown()
    refused(lambda: run(executor=closed), "the executor takes no more members (cannot", error=lg.RunError)
    refused(lambda: run(executor=ThreadPoolExecutor), "executor is <class")
    refused(lambda: run(executor="dask"), "executor is 'dask': give a concurrent.futures executor")
    refused(lambda: run(executor=Giving(None)), "executor.submit(...) returned None")
    refused(
        lambda: run(executor=Giving(future(3))), "the executor returned 3 in place of the results", error=lg.RunError
    )
    missing = future(ModuleNotFoundError("No module named 'lagrange'"))
    refused(lambda: run(executor=Giving(missing)), "cannot run members: No module named", error=lg.RunError)


@pytest.mark.parametrize("workers", [0, -1, True, 2.5, "2", np.nan, 10**6])
def test_workers_that_are_no_number(workers: Any) -> None:
    refused(lambda: run(workers=workers), "workers")


def test_places_that_cannot_hold_a_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zarr")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("file", "folder", "link"):
        refused(lambda name=name: run(store=tmp_path / name), f"{name} exists and is not a store", "left as it is")
    refused(lambda: run(store=tmp_path / "file" / "runs.zarr"), "cannot be made (File exists): give a folder")
    refused(lambda: run(store="/proc/runs.zarr"), "/proc/runs.zarr cannot be made")
    refused(lambda: run(store=tmp_path / ("a" * 300)), "cannot be made (File name too long)")
    for given in ("", 3, True, b"runs"):
        refused(lambda given=given: run(store=given), "give the name of a folder")
    refused(lambda: run(store="a\0b"), "which no folder can be called")
    refused(lambda: run(store="s3://bucket/runs.zarr"), "give the name of a folder of this machine")
    assert (tmp_path / "file").read_text() == "mine" and not list((tmp_path / "folder").iterdir())
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    run(store="~/runs.zarr")
    run(store="a/runs.zarr")
    assert (tmp_path / "runs.zarr" / "zarr.json").exists() and (tmp_path / "a" / "runs.zarr").exists()


def test_a_store_of_another_version_or_method(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    target = tmp_path / "runs.zarr"

    def euler(share: float) -> Any:
        def step(f: Any, t: Any, y: Any, h: Any) -> Any:
            slope = f(t, y)
            return y + h * (slope + share * (f(t + h, y + h * slope) - slope))

        return lg.methods.step_method(step, order=1, name="mine", step=0.01)

    run(store=target, method=euler(0.25))
    assert run(store=target, method=euler(0.25)).form == "all members were stored"
    refused(lambda: run(store=target, method=euler(0.5)), "differs in steps. It was left")
    about = json.loads((target / "zarr.json").read_text())
    about["attributes"]["lagrange"]["numpy"] = "1.0"
    (target / "zarr.json").write_text(json.dumps(about))
    refused(
        lambda: run(store=target, method=euler(0.25)), "differs in numpy: numpy was '1.0' and is", "It was left as it"
    )


def test_a_store_whose_description_is_damaged(tmp_path: Path) -> None:
    pytest.importorskip("zarr")

    def made(name: str) -> Path:
        run(store=tmp_path / name)
        return tmp_path / name

    for content in ("", "{", "[]", '{"zarr_format": 3, "node_type": "array"}'):
        target = made(f"about{len(content)}")
        (target / "zarr.json").write_text(content)
        refused(lambda target=target: run(store=target), "exists and is not a store of an ensemble")
        assert (target / "zarr.json").read_text() == content


def test_a_store_that_would_never_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zarr")
    monkeypatch.setattr(store, "MOST_BLOCKS", 2)
    monkeypatch.setattr(store, "LARGEST_BLOCK", 1)
    refused(lambda: run(store=tmp_path / "runs.zarr"), "the results of 3 members take 75 bytes, and a store has room")
    monkeypatch.setattr(table, "MOST_MEMBERS", 8)
    refused(lambda: lg.grid({"theta": THREE, "l": THREE}), "the grid has 9 members: give fewer values")


def test_all_digits_of_a_seed_count() -> None:
    first, second = (lg.sample({"theta": (0, 1)}, 4, seed=seed)["theta"] for seed in (2**53, 2**53 + 1))
    assert not np.array_equal(first, second)


def test_a_sample_of_more_than_a_sequence_has(monkeypatch: pytest.MonkeyPatch) -> None:
    assert qmc.Sobol.MAXDIM == table.MOST_DIMENSIONS
    monkeypatch.setattr(table, "MOST_DIMENSIONS", 3)
    refused(
        lambda: lg.sample({f"p{i}": (0, 1) for i in range(4)}, 2),
        "ranges has 4 entries, but Sobol's sequence has at most 3",
    )
