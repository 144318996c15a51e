"""Random plain procedures: exact arithmetic, iterations in a shuffled order, the interpreter and machine code agree."""

from __future__ import annotations

import math
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagrange.procedure.interpreter import run
from tests.procedure.random_functions import SIZE, RandomFunction, example
from tests.procedure.test_front_end import machine_code

DATA = [0.5, -1.25, 0.1, 0.0, -0.0, 1e200, -1e-200, 2.0, 7 / 3, -4.0, 1.0]
INPUTS = [(0.75, -1.5, 2), (math.nan, 1.0, 0), (-math.inf, 0.0, 7), (1e-308, 1e308, 3)]


def bits(value: Any) -> Any:
    """Tell zeros apart; all NaN are one."""
    return "nan" if value != value else struct.pack("<d", value)


@pytest.mark.few
@pytest.mark.parametrize("seed", range(60))
def test_a_random_function_does_the_same_in_every_life(seed: int, tmp_path: Path) -> None:
    plain = example(seed, tmp_path)
    kept_record = plain.function.__globals__["Kept"].record

    def outcome(call: Any, given: tuple[float, float, int]) -> list[Any]:
        data, kept = np.array([*DATA, *[0.0] * 8]), kept_record.structure(0.25, 3)
        x, whole, flag = call(*given, data, np.array(DATA[::-1]), kept)
        return [bits(float(x)), int(whole), bool(flag), *map(bits, data.tolist()[:SIZE]), bits(kept.x), kept.count]

    for option in (False, True):
        form = plain.form(option=option)
        lives = {
            "exact": partial(plain.exactly, option=option),
            "shuffled": partial(plain.exactly, option=option, seed=seed),
            "machine code": machine_code(form),
        }
        for given in INPUTS:
            expected = outcome(partial(run, form), given)
            for name, life in lives.items():
                assert outcome(life, given) == expected, name


def test_random_functions_have_every_construct() -> None:
    text = "".join(RandomFunction(seed).text() for seed in range(60))
    words = (
        "for ",
        "while ",
        "else:",
        " and ",
        " or ",
        " if ",
        "each(",
        "unrolled(",
        "every_other(",
        "fma(",
        "likely(",
    )
    for word in (*words, "return ", "exchange(", "bounded(", "kept.x", "//", "%", "larger("):
        assert word in text
