"""FMUs are valid, agree with our runs in FMPy, and report singular states; their sources compile without warnings."""

import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import LagrangeError
from lagrange.export.languages import fmu as target
from tests.export.callers import held, run
from tests.models import SCENE_NAMES, shared_scene
from tests.statement.examples import VALUES, at, driven

fmpy: Any = pytest.importorskip("fmpy", reason="FMPy is not installed")
validation: Any = pytest.importorskip("fmpy.validation", reason="FMPy is not installed")
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")

WARNINGS = "cc -std=c99 -O2 -Wall -Wextra -Wpedantic -Wconversion -Werror -shared -fPIC -o library"
HEADERS = Path(fmpy.__file__).parent / "c-code"
CONTENTS = ("energy", "jacobian", "mass_matrix", "momenta", "accelerations")


@pytest.fixture(autouse=True)
def _without_optimization(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile without optimization. `test_inputs.py` compiles as a user does."""
    quick = ["-O0" if option == "-O2" else option for option in target.COMPILER]
    monkeypatch.setattr(target, "COMPILER", tuple(quick))


def written(system: lg.System, folder: Path, *contents: str, **options: Any) -> dict[int, Path]:
    """Write both FMUs, and return their paths by version."""
    made = system.export("fmu", folder, contents or None, **options)
    return dict(zip((2, 3), made.files, strict=True))


def simulated(path: Path, kind: str, end: float) -> Any:
    solver = {"solver": "CVode"} if kind == "ModelExchange" else {}
    given = {"fmi_type": kind, "stop_time": end, "relative_tolerance": 1e-12, "output_interval": end / 4, **solver}
    return fmpy.simulate_fmu(str(path), **given)


@contextmanager
def instance(path: Path, kind: str, folder: Path, messages: list[str] | None = None) -> Iterator[Any]:
    """Yield an initialized instance of an FMU, with its value references by name."""
    unpacked = fmpy.extract(str(path), str(folder / f"{path.stem}_{kind}"))
    described = fmpy.read_model_description(unpacked)
    heard = [] if messages is None else messages

    def told(*arguments: Any) -> None:
        heard.append(arguments[-1].decode() if isinstance(arguments[-1], bytes) else str(arguments[-1]))

    made = fmpy.instantiate_fmu(
        unpacked, described, kind, **({"logger": told} if messages is not None else {}), debug_logging=True
    )
    made.references = {item.name: item.valueReference for item in described.modelVariables}
    if described.fmiVersion == "2.0":
        made.setupExperiment(tolerance=1e-12, startTime=0.0)
        made.enterInitializationMode()
        made.read, made.put = made.getReal, made.setReal
    else:
        made.enterInitializationMode(tolerance=1e-12, startTime=0.0)
        made.read, made.put = made.getFloat64, made.setFloat64
    made.exitInitializationMode()
    yield made
    made.terminate()
    made.freeInstance()


@pytest.mark.parametrize(
    "scene", ["double-pendulum", pytest.param("cartesian-double-pendulum", marks=pytest.mark.slow)]
)
def test_a_simulation_equals_ours(scene: str, tmp_path: Path) -> None:
    """Both versions run as model exchange and as co-simulation."""
    system = shared_scene(scene)
    end = min(1.0, system.statement.run.t_end)
    ours = system.run(end, method="dop853", rtol=1e-13, atol=1e-13)
    for path in written(system, tmp_path, *CONTENTS, *held(system)).values():
        assert validation.validate_fmu(str(path)) == []
        for kind, allowed in (
            ("CoSimulation", 1e-9),
            ("ModelExchange", 1e-8 if system.statement.constraints else 1e-9),
        ):
            last = simulated(path, kind, end)[-1]
            assert last[0] == end
            assert list(last)[1:] == pytest.approx(ours.y[:, -1], rel=allowed, abs=allowed), (path.name, kind)


@pytest.mark.conformance
@pytest.mark.parametrize("scene", SCENE_NAMES)
def test_every_scene_is_valid_and_its_sources_are_right(scene: str, tmp_path: Path) -> None:
    system = shared_scene(scene)
    for path in written(system, tmp_path, *CONTENTS, *held(system)).values():
        assert validation.validate_fmu(str(path)) == []
    for command in system.export("fmu", tmp_path, [*CONTENTS, *held(system)]).commands:
        said = run(command, tmp_path)
    assert said.endswith("results are right\n")


@pytest.mark.slow
def test_the_sources_compile_without_a_warning_by_the_headers_of_the_standard(tmp_path: Path) -> None:
    x = lg.coordinate("x")
    bare = lg.System(kinetic=x.dot**2 / 2, potential=cos(x), initial={x: 0.5}, name="pendulum")  # without parameters
    for system, contents in ((bare, []), (shared_scene("pendulum"), ["jacobian"])):
        for major, path in written(system, tmp_path, *contents).items():
            sources = tmp_path / f"{major}{len(contents)}" / "sources"
            with zipfile.ZipFile(path) as packed:
                packed.extractall(sources.parent)
            for more in ("", f"-DFMI{major}_FUNCTION_PREFIX=pendulum_ ", f"-DFMI_STANDARD_HEADERS -I{HEADERS} "):
                run(f"{WARNINGS} {more}fmi-functions.c pendulum.c", sources)


@pytest.mark.slow
def test_parameters_and_states_are_set_and_results_are_read(tmp_path: Path) -> None:
    system = shared_scene("double-pendulum")
    model = system.compile()
    y = np.array([0.4, -0.7, 1.1, 0.2])
    for path in written(system, tmp_path, "energy", "jacobian").values():
        with instance(path, "ModelExchange", tmp_path) as made:
            at, n = made.references, 4
            with pytest.raises(Exception, match="3"):
                made.put([at["theta1"]], [0.4])  # states are set as a whole now
            made.read([at["der(theta1_dot)"]])  # what is prepared for a parameter is prepared again for another value
            made.put([at["l2"]], [0.5])
            (made.newDiscreteStates if path.stem.endswith("2") else made.updateDiscreteStates)()
            made.enterContinuousTimeMode()
            made.setContinuousStates(np.ctypeslib.as_ctypes(y), n)
            given = {"l2": 0.5}
            rates = made.read([at[f"der({name})"] for name in ("theta1", "theta2", "theta1_dot", "theta2_dot")])
            assert rates == pytest.approx(model.rhs(0.0, y, given), rel=1e-13)
            assert made.read([at["energy"], at["l2"]]) == pytest.approx(
                [model.energy(y[:2], y[2:], parameters=given), 0.5]
            )
            knowns = [at["theta1"], at["theta2_dot"]]
            unknowns = [at["der(theta1_dot)"], at["der(theta2_dot)"], at["theta1"]]
            jacobian = model.jacobian(0.0, y, given)
            expected = [*(jacobian[2:, 0] * 2.0 - jacobian[2:, 3]), 2.0]
            assert made.getDirectionalDerivative(unknowns, knowns, [2.0, -1.0]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_a_saved_state_is_restored(tmp_path: Path) -> None:
    for path in written(shared_scene("pendulum"), tmp_path).values():
        with instance(path, "CoSimulation", tmp_path) as made:
            at = [made.references[name] for name in ("theta", "theta_dot")]
            made.doStep(0.0, 0.25)
            two = path.stem.endswith("2")
            saved = (made.getFMUstate if two else made.getFMUState)()
            before = made.read(at)
            packed = (made.serializeFMUstate if two else made.serializeFMUState)(saved)
            made.doStep(0.25, 0.25)
            after = made.read(at)
            restored = (made.deSerializeFMUstate if two else made.deserializeFMUState)(packed)
            (made.setFMUstate if two else made.setFMUState)(restored)
            assert made.read(at) == before
            made.doStep(0.25, 0.25)
            assert made.read(at) == after
            (made.freeFMUstate if two else made.freeFMUState)(saved)


@pytest.mark.slow
def test_events_are_indicators_and_names_stay_different(tmp_path: Path) -> None:
    time, energy = lg.coordinates("time energy")
    g = lg.parameters("g")
    system = lg.System(
        kinetic=time.dot**2 / 2 + energy.dot**2,
        potential=g * sin(time) + energy**2,
        parameters={g: 2.0},
        initial={time: 0.5, energy: 0.25},
        name="fmi",
    )
    for path in written(system, tmp_path, "energy", "events", events=[time - 0.125, energy.dot]).values():
        assert validation.validate_fmu(str(path)) == []
        with instance(path, "ModelExchange", tmp_path) as made:
            assert {"time_2", "energy", "energy_2", "event0", "event1"} <= set(made.references)
            values = (np.ctypeslib.as_ctypes(np.zeros(2)), 2)
            made.getEventIndicators(*values)
            assert list(values[0]) == [0.375, 0.0]
            assert made.read([made.references["energy_2"]]) == pytest.approx([2 * np.sin(0.5) + 0.0625])


@pytest.mark.parametrize("cause", ["at this state", pytest.param("with these parameters", marks=pytest.mark.slow)])
def test_a_singular_matrix_is_a_status_with_a_message(cause: str, tmp_path: Path) -> None:
    x, y, m = lg.coordinate("x"), lg.coordinate("y"), lg.parameters("m")
    kinetic = m * x.dot**2 * sin(x) ** 2 / 2 + y.dot**2 + x.dot * y.dot * sin(x) / 4
    start = {x: 0.5, y: 0.1}
    if cause == "with these parameters":
        kinetic, start = m * x.dot**2 / 2, {x: 0.5}
    system = lg.System(kinetic, -x, parameters={m: 1}, coordinates=[*start], initial=start, name="singular")
    for path in written(system, tmp_path).values():
        messages: list[str] = []
        with instance(path, "ModelExchange", tmp_path, messages) as made:
            if cause == "with these parameters":
                made.put([made.references["m"]], [0.0])
            else:
                (made.newDiscreteStates if path.stem.endswith("2") else made.updateDiscreteStates)()
                made.enterContinuousTimeMode()
                made.setContinuousStates(np.ctypeslib.as_ctypes(np.array([0.0, 0.1, 0.0, 0.0])), 4)
            with pytest.raises(Exception, match="2"):  # discard
                made.read([made.references["der(x_dot)"]])
        assert any(f"a matrix is singular to round-off {cause}" in item for item in messages)


def test_units_are_defined_and_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)  # the description needs no library
    x = lg.coordinates("x")
    m, k = lg.parameters("m k")
    system = lg.System(
        kinetic=m * x.dot**2 / 2,
        potential=k * x**2 / 2,
        parameters={m: 2, k: 3},
        initial={x: 1.0},
        dimensions={x: "m", m: "kg", k: "N/m"},
        name="spring",
    )
    described_system = lg.System.from_statement(replace(system.statement, about="A mass on a spring."))
    for path in written(described_system, tmp_path, "energy").values():
        assert validation.validate_fmu(str(path)) == []
        described = fmpy.read_model_description(str(path))
        assert described.description == "A mass on a spring."
        about = {item.name: item.description for item in described.modelVariables}
        assert (about["x"], about["x_dot"], about["m"]) == ("coordinate", "velocity of x", "parameter")
        units = {item.name: item.unit for item in described.modelVariables if item.unit and item.name != "time"}
        assert {units.pop(name) for name in ("x_dot", "der(x)")} == {"m/s"}
        assert units == {"x": "m", "der(x_dot)": "m/s2", "energy": "J", "m": "kg", "k": "N/m"}
    system.export("c", tmp_path)
    assert "parameters: m = 2.0 [kg], k = 3.0 [N/m]" in (tmp_path / "spring.h").read_text()


@pytest.mark.slow
def test_an_fmu_is_driven_through_its_inputs(tmp_path: Path) -> None:
    time, y = 0.4, np.array([0.7, -1.3])
    for path in written(driven(), tmp_path, "rhs").values():
        with instance(path, "ModelExchange", tmp_path) as made:
            (made.newDiscreteStates if path.stem.endswith("2") else made.updateDiscreteStates)()
            made.enterContinuousTimeMode()
            given = {str(name): value for name, value in at(time).items()}
            made.put([made.references[name] for name in given], [*given.values()])
            made.setTime(time)
            made.setContinuousStates(np.ctypeslib.as_ctypes(y), 2)
            rates = made.read([made.references[name] for name in ("der(theta)", "der(theta_dot)")])
        expected = driven().substitute(VALUES).compile("numpy").rhs(time, y)
        assert rates == pytest.approx(expected, rel=1e-13)


def test_without_a_compiler_there_is_no_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    for path in shared_scene("pendulum").export("fmu", tmp_path).files:
        with zipfile.ZipFile(path) as packed:
            assert not any(name.startswith("binaries") for name in packed.namelist())
            assert "sources/pendulum.c" in packed.namelist()


def test_a_compiler_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target, "COMPILER", ("cc", "--no-such-option"))
    with pytest.raises(
        LagrangeError, match=r"cc --no-such-option -o library fmi-functions\.c pendulum\.c -lm failed: .*no-such"
    ):
        shared_scene("pendulum").export("fmu", tmp_path)
    assert subprocess.run(["ls", str(tmp_path)], capture_output=True, text=True, check=True).stdout == ""
