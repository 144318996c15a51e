"""Exported Julia, which does not run here: its text, its form, and its numbers by a reader of what it uses."""

from __future__ import annotations

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.contents import module_of, wanted
from lagrange.export.languages.julia import source
from lagrange.export.module import SourceModule
from lagrange.export.target import find
from tests.covering import Share
from tests.export.graphs import as_module, graph, points, wrong
from tests.export.julia_reader import check, loaded, reals
from tests.export.systems import every_scene, held, named
from tests.export.test_modules import AWKWARD, coupled

QUANTITIES_OF_ALL = ["rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations"]


def module(system: lg.System, contents: list[str]) -> SourceModule:
    model = system.compile("numpy")
    return module_of(model, wanted(find("julia"), model, contents, (), None), ())


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
        ("== 0.0\nend\n", "== 0.0\n"),
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
    text = source(as_module(programs))
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
