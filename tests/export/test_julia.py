"""Exported Julia, which does not run here: its text, its form, and its numbers by a reader of what it uses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.contents import module_of, wanted
from lagrange.export.languages.julia import source
from lagrange.export.module import SourceModule
from lagrange.export.registry import find
from tests.covering import Share
from tests.export.graphs import as_module, graph, points, rarer, rarer_results, wrong
from tests.export.julia_reader import check, loaded, reals
from tests.export.systems import every_scene, held, named
from tests.export.test_modules import AWKWARD, coupled

QUANTITIES_OF_ALL = ["rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations"]

ENERGY = '''\
"""
    energy!(out, t, y, p)

The energy v.p - L, which is T + V where T is quadratic in the velocities. out: energy.
"""
function energy!(out, t, y, p)
    length(y) < 2 && throw(DimensionMismatch("y has fewer than 2 numbers"))
    length(p) < 5 && throw(DimensionMismatch("p has fewer than 5 numbers"))
    length(out) < 1 && throw(DimensionMismatch("out has fewer than 1 numbers"))
    m = p[1]
    theta = y[1]
    theta_dot = y[2]
    x14 = p[4] * (theta_dot * theta_dot)
    out[1] = m * (x14 - (p[5] * cos_of(theta) + 0.5 * x14))
    return false
end
'''


def module(system: lg.System, contents: list[str]) -> SourceModule:
    model = system.compile("numpy")
    return module_of(model, wanted(find("julia"), model, contents, (), None), ())


@pytest.mark.parametrize("name", ["test", "random", "dict", "base", "sin"])
def test_no_module_has_the_name_of_one_of_the_library(name: str, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    lg.System(kinetic=x.dot**2 / 2, potential=x**2, name=name).export("julia", tmp_path, ["rhs"])
    own = f"{name.capitalize()}_2" if name != "sin" else "Sin"  # sin is a function, and Sin nothing
    assert f"\nmodule {own}\n" in (tmp_path / f"{name}.jl").read_text()
    assert f"{own}.rhs!(" in (tmp_path / f"{name}_test.jl").read_text()


def test_the_text_of_the_pendulum(tmp_path: Path) -> None:
    made = lg.scene("pendulum").export("julia", tmp_path, QUANTITIES_OF_ALL)
    names = ["pendulum.jl", "pendulum_test.jl"]
    assert [path.name for path in made.files] == names
    texts = [path.read_text() for path in made.files]
    for text in texts:
        assert text.isascii()
        assert text.endswith("\n")
        assert not text.endswith("\n\n")
    assert texts[0].startswith("# pendulum: equations of motion, made by lagrange\n# A plane pendulum, ")
    assert "\nmodule Pendulum\n" in texts[0]
    assert "        if Pendulum.rhs!(out, times[k], states[k], p)\n" in texts[1]
    assert texts[1].endswith("\nexit(test_all() > 0 ? 1 : 0)\n")
    lg.scene("pendulum").export("julia", tmp_path, ["energy"])
    assert f"\n{ENERGY}\n" in made.files[0].read_text()


def right(made: SourceModule) -> None:
    """Check the form of a module, and do its self-test."""
    text = source(made)
    check(text)
    known = loaded(text)
    p = reals([0.0] * known["PREPARED_SIZE"])
    with np.errstate(all="ignore"):
        assert not known["prepare_changes"](p, reals(known["DEFAULT_PARAMETERS"]))
        for one in made.checks:
            for t, y, expected, allowed in zip(one.times, one.states, one.results, one.allowed, strict=True):
                out = reals([0.0] * len(expected))
                assert not known[f"{one.name}_changes"](out, t, reals(y), p)
                assert (np.abs(np.subtract(out.values, expected)) <= allowed).all(), one.name


@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-double-pendulum"))
def test_a_scene_conforms(scene: str) -> None:
    system = lg.scene(scene)
    right(module(system, [*QUANTITIES_OF_ALL, *held(system)]))


@pytest.mark.parametrize(
    ("text", "broken"),
    [
        ("    out[1] = theta_dot\n", "    out[1] = (theta_dot\n"),
        ("    out[1] = theta_dot\n", "    out[1] = thetadot\n"),
        ("    return false\nend\n", "    return false\n"),
        ("    theta = y[1]\n", "    theta = y[1];\n"),
    ],
)
def test_what_is_broken_is_found(text: str, broken: str) -> None:
    made = source(module(lg.scene("pendulum"), ["rhs"]))
    check(made)
    assert text in made
    with pytest.raises(AssertionError):
        check(made.replace(text, broken, 1))


def test_random_graphs(share: Share) -> None:
    programs = [graph(seed, without=["erf"]) for seed in range(share(60))]
    text = source(as_module(programs, [rarer()]))
    check(text)
    known = loaded(text)
    complaints: list[str] = []
    with np.errstate(all="ignore"):
        for k, program in enumerate(programs):
            for y in points(k, 6):
                out = reals([0.0] * len(program.outputs))
                known[f"{program.name}_changes"](out, 0.0, reals(y), reals([0.0]))
                complaints += wrong(program, y, [float(value) for value in out.values])
        assert not complaints, "\n".join(complaints[:20])
        for a, b in ((2.5, -7.0), (-0.4, -0.0), (3.5, 9.0), (-1e300, 4.0)):
            out = reals([0.0] * 8)
            known["rarer_changes"](out, 0.0, reals([a, b, 0.0, 0.0]), reals([0.0]))
            np.testing.assert_array_equal(out.values, rarer_results(a, b))


def test_awkward_names() -> None:
    words = ("function", "end", "Inf", "NaN", "ifelse", "sin_of", "Float64", "mutable", "begin", "local", "one")
    made = module(named(AWKWARD[:8], (*AWKWARD[8:], *words), "float64"), ["rhs", "energy"])
    right(made)
    assert "\nmodule Float64_2\n" in source(made)


def test_a_singular_matrix_is_a_status() -> None:
    known = loaded(source(module(coupled(), ["rhs"])))
    p = reals([0.0] * known["PREPARED_SIZE"])
    with np.errstate(all="ignore"):
        assert not known["prepare_changes"](p, reals(known["DEFAULT_PARAMETERS"]))
        y = reals([0.0, 0.0, 0.5, 0.1])
        assert known["rhs_changes"](reals([0.0] * 4), 0.0, y, p)
