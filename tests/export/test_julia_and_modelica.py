"""Exported Julia and Modelica, which do not run here: their functions are translated to Python and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.contents import contents_of, module_of
from lagrange.export.languages import julia, modelica
from lagrange.export.module import SourceModule
from lagrange.export.straight_line import PrintedFunctions
from lagrange.export.target import find
from tests.covering import Share
from tests.export.graphs import as_module, graph, points, wrong
from tests.export.read_as_python import Places, of_julia, of_modelica
from tests.export.systems import every_scene, held, named
from tests.export.test_every_target import accepted, awkward
from tests.export.test_modules import coupled, on_a_sphere

QUANTITIES = ["rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations"]
both = pytest.mark.parametrize("target", ["julia", "modelica"])


class Singular(Exception):
    """Exception for a singular matrix."""


class Read:
    """The functions of a module by name, each a function of time, state and prepared parameters."""

    def __init__(self, target: str, made: SourceModule) -> None:
        self.julia, self.made = target == "julia", made
        if self.julia:
            self.known = of_julia(julia.source(made))
        else:
            functions = PrintedFunctions(made, modelica.LANGUAGE, statuses=False)
            self.known = of_modelica([*modelica.function_lines(functions)])
            self.size = functions.hoisted.size

    def prepared(self, parameters: Sequence[float]) -> Any:
        if not self.julia:
            return self.known["prepare"](Places(parameters))
        p = Places(np.zeros(self.known["PREPARED_SIZE"]))
        assert not self.known["prepare"](p, Places(parameters))
        return p

    def values(self, name: str, t: float, y: Sequence[float], p: Any, size: int) -> list[float]:
        """Return the results of a function at a state. Raises Singular for a singular matrix."""
        with np.errstate(all="ignore"):
            if self.julia:
                out = Places(np.zeros(size))
                if self.known[name](out, np.float64(t), Places(y), p):
                    raise Singular
                return [float(value) for value in out.values]
            try:
                return [float(value) for value in self.known[name](np.float64(t), Places(y), p).values]
            except AssertionError as error:
                if "a matrix is singular" in str(error):
                    raise Singular from None
                raise


def module(target: str, system: lg.System, contents: list[str]) -> SourceModule:
    model = system.compile("numpy")
    return module_of(model, contents_of(find(target), model, contents, (), None), ())


def right(target: str, made: SourceModule) -> Read:
    """Return the functions of a module, after a check that they give the results in its self-test."""
    read = Read(target, made)
    p = read.prepared(made.values)
    for item in made.checks:
        for t, y, expected, allowed in zip(item.times, item.states, item.results, item.allowed, strict=True):
            result = read.values(item.name, t, y, p, len(expected))
            assert (np.abs(np.subtract(result, expected)) <= allowed).all(), item.name
    return read


@both
@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-double-pendulum"))
def test_a_scene_conforms(target: str, scene: str) -> None:
    system = lg.scene(scene)
    right(target, module(target, system, [*QUANTITIES, *held(system)]))


@both
def test_random_graphs(target: str, share: Share) -> None:
    programs = [graph(seed, without=sorted(find(target).inexpressible)) for seed in range(share(60))]
    read = Read(target, as_module(programs))
    p = read.prepared([])
    for k, item in enumerate(programs):
        for y in points(k, 6):
            assert list(wrong(item, y, read.values(item.name, 0.0, y, p, len(item.outputs)))) == []


RESERVED = {"julia": julia.RESERVED, "modelica": modelica.RESERVED}


@pytest.mark.few(1)
@both
def test_awkward_names(target: str) -> None:
    words = [*dict.fromkeys((*islice(awkward(), 30), *filter(accepted, RESERVED[target])))]
    right(target, module(target, named(words[:8], words[8:], "float64"), ["rhs", "energy"]))


@both
@pytest.mark.parametrize("stated", [coupled, on_a_sphere])
def test_a_singular_matrix_is_told(target: str, stated: Callable[[], lg.System]) -> None:
    made = module(target, stated(), ["rhs"])
    read = right(target, made)
    with pytest.raises(Singular):
        read.values("rhs", 0.0, [0.0, 0.0, 0.5, 0.1], read.prepared(made.values), 4)
