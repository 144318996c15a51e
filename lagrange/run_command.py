"""The command `lagrange run`, and what the commands that run a scene share."""

from __future__ import annotations

import argparse
from typing import Any

import lagrange as lg
from lagrange.arguments import (
    DONE,
    FAILED,
    INTERRUPTED,
    Answer,
    add_command,
    add_json,
    add_start,
    count,
    folder,
    given_number,
    load_scene,
    start,
)
from lagrange.errors import listing
from lagrange.trajectory.solution import Solution


def add_run(commands: Any) -> None:
    """Add the command to the command line."""
    run_ = add_command(commands, "run", run, "compile a scene, run it and print how it went")
    add_start(run_)
    add_method(run_)
    run_.add_argument("--points", metavar="N", help="output at N equally spaced times instead of at every step")
    run_.add_argument(
        "--out", metavar="DIR", help="folder for trajectory.csv, trajectory.png and card.json; made if need be"
    )
    run_.add_argument("--no-check", action="store_true", help="skip the check of the compiled equations before the run")
    add_json(run_)


def add_method(command: Any) -> None:
    """Add the options that say how a scene is run."""
    command.add_argument("--method", metavar="NAME", help="integrator, such as dop853 or rk4 (default: taylor)")
    command.add_argument("--rtol", metavar="X", help="relative tolerance of an adaptive method")
    command.add_argument(
        "--atol",
        metavar="X",
        help="absolute tolerance of an adaptive method; by default it follows the size of each entry",
    )
    command.add_argument("--step", metavar="H", help="step of a method with fixed steps")


def method(request: argparse.Namespace) -> dict[str, Any]:
    """Return what the options of `add_method` say, by the names that a run takes."""
    numbers = {key: given_number(f"--{key}", getattr(request, key)) for key in ("rtol", "atol", "step")}
    return {"method": request.method, **numbers}


def code_of(solution: Solution) -> int:
    """Return the exit code of a run: done, failed or interrupted."""
    if solution.status is lg.Status.INTERRUPTED:
        return INTERRUPTED
    return DONE if solution.status.complete else FAILED


def run(request: argparse.Namespace) -> Answer:
    """Run a scene, write what came of it, and return its status card."""
    begun, how = start(request), method(request)
    points = count("--points", request.points)
    system = load_scene(request.scene)
    target = folder(request.out) if request.out is not None else None
    t_end = system.statement.run.t_end if begun["t_end"] is None else begun["t_end"]
    solution = system.run(
        **begun,
        **how,
        t_eval=None if points is None else _times(t_end, points),
        progress=not request.json,
        check=not request.no_check,
    )
    files = solution.to_folder(target) if target is not None else []
    written = f"\nwritten to {target}: {listing(path.name for path in files)}" if target is not None else ""
    data = {**solution.card(), "files": [str(path) for path in files]}
    return Answer(code_of(solution), repr(solution) + written, data)


def _times(t_end: float, points: int) -> Any:
    import numpy as np

    return np.linspace(0.0, t_end, points)
