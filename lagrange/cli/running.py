"""Commands that run systems: `lagrange run`, `race` and `ensemble`."""

from __future__ import annotations

import argparse
import math
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lagrange as lg
from lagrange.cli.arguments import (
    DONE,
    FAILED,
    INTERRUPTED,
    PICTURES,
    Answer,
    CommandParser,
    add_start,
    code_of,
    count,
    entries,
    folder,
    given_number,
    load_scene,
    number,
    start,
)
from lagrange.errors import StatementError, listing, suggestion
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import check_place, write_atomically
from lagrange.statement.run_settings import REDUCTIONS

if TYPE_CHECKING:
    from lagrange.show.ensemble import Ensemble
    from lagrange.system import System


def add_run(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `run`, such as --points and --out."""
    add_start(command)
    command.add_argument("--points", metavar="N", help="output at N equally spaced times instead of at every step")
    command.add_argument(
        "--out", metavar="DIR", help="folder for trajectory.csv, trajectory.png and card.json; made if need be"
    )
    command.add_argument(
        "--no-check", action="store_true", help="skip the check of the compiled equations before the run"
    )


def run(request: argparse.Namespace) -> Answer:
    """Run a scene, write the requested files, and return its status card."""
    run_arguments = start(request)
    points = count("--points", request.points)
    system = load_scene(request)
    target = folder(request.out) if request.out is not None else None
    t_eval = _times(system, run_arguments, points)
    solution = system.run(**run_arguments, t_eval=t_eval, progress=not request.json, check=not request.no_check)
    return _in_folder(code_of(solution), solution, solution.card(), target)


def _times(system: System, run_arguments: dict[str, Any], points: int | None) -> Any:
    """Return `points` equally spaced output times from 0 to the end of a run, or None if `points` is None.

    `run_arguments` are the keyword arguments of the run.
    """
    import numpy as np

    return None if points is None else np.linspace(0.0, _end(system, run_arguments), points)


def _end(system: System, run_arguments: dict[str, Any]) -> float:
    """Return the end time in `run_arguments`, the keyword arguments of a run, or the stated one if that is None."""
    t_end: float | None = run_arguments["t_end"]
    return system.statement.run.t_end if t_end is None else t_end


def _in_folder(code: int, result: Any, data: dict[str, Any], target: Path | None) -> Answer:
    """Write the files of a result into the folder `target`, unless that is None, and return the answer of the command.

    The answer has the exit code `code`, the result as text, and `data` with the paths of the files.
    """
    files = [] if target is None else result.to_folder(target)
    written = "" if target is None else f"\nwritten to {target}: {listing(path.name for path in files)}"
    return Answer(code, repr(result) + written, {**data, "files": [str(path) for path in files]})


def add_race(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `race`, such as --methods and --out."""
    add_start(command, method=False)
    command.add_argument("--methods", metavar="A,B", help="methods, such as dop853,rk4 (default: a telling choice)")
    command.add_argument("--tolerances", metavar="X,Y", help="tolerances of adaptive methods (default: 1e-3 to 1e-13)")
    command.add_argument("--steps", metavar="H,K", help="steps of methods with fixed steps (default: nine that fit)")
    command.add_argument("--outputs", metavar="N", help="look at the errors at N times instead of the end")
    command.add_argument("--relative", action="store_true", help="divide each entry's error by the entry's size")
    command.add_argument("--digits", metavar="N", help="digits of the reference (default: 22)")
    command.add_argument("--repeats", metavar="N", help="timed runs, of which the fastest counts (default: 5)")
    command.add_argument("--max-wall", metavar="S", help="seconds after which a run is ended (default: 10)")
    command.add_argument("--out", metavar="DIR", help="folder for table.csv and plot.png; made if need be")


def race(request: argparse.Namespace) -> Answer:
    """Race methods on a scene, write the table and the picture, and return the measured errors and times."""
    settings: dict[str, Any] = {
        "methods": None if request.methods is None else [name.strip() for name in request.methods.split(",")],
        **{
            key: [number(f"--{key}", part.strip()) for part in getattr(request, key).split(",")]
            for key in ("tolerances", "steps")
            if getattr(request, key) is not None
        },
        **{key: given_number(f"--{key}", getattr(request, key)) for key in ("outputs", "digits", "repeats")},
        "max_wall": given_number("--max-wall", request.max_wall),
    }
    run_arguments = start(request)
    system = load_scene(request)
    target = folder(request.out) if request.out is not None else None
    options = {key: value for key, value in settings.items() if value is not None}
    result = lg.race(system, **run_arguments, relative=request.relative, **options)
    return _in_folder(DONE if any(entry.complete for entry in result) else FAILED, result, result.to_dict(), target)


TABLE, STORE = ".csv", ".zarr"
"""Suffixes of outputs of an ensemble: a CSV file with a line per member, and a folder that is written in blocks."""


def add_ensemble(command: CommandParser) -> None:
    """Add to the parser `command` the options of the command `ensemble`, such as --vary and --keep."""
    command.add_argument(
        "--vary",
        metavar="NAME=LOW:HIGH:COUNT",
        action="append",
        default=[],
        help="equally spaced values of a coordinate, a velocity or a parameter, such as theta=-3:3:1000 or "
        "theta=-90deg:90deg:100; given twice, all combinations",
    )
    command.add_argument(
        "--keep",
        metavar="LIST",
        default="end",
        help="names with commas: end, counts, drift, or max:NAME, min:NAME, mean:NAME of a coordinate or a velocity "
        "(default: end)",
    )
    command.add_argument("--points", metavar="N", help="keep the states at N equally spaced times as well")
    command.add_argument(
        "--out",
        metavar="FILE",
        help="picture to write, .png, .svg or .pdf; table with a line for each member, .csv; or folder in the format "
        "zarr, .zarr, with which the same command goes on where it was stopped",
    )
    command.add_argument(
        "--what", metavar="NAME", help="what the picture shows, such as theta or max:theta (default: what is kept)"
    )
    command.add_argument("--style", choices=("light", "dark"), default="light", help="colours (default: light)")
    command.add_argument("--workers", metavar="N", help="threads (default: one for each core)")
    command.add_argument(
        "--progress", action="store_true", help="write progress as lines if standard error is not a terminal"
    )
    add_start(command)


def ensemble(request: argparse.Namespace) -> Answer:
    """Run a scene from many initial states or with many parameters, and report how the runs ended."""
    run_arguments = start(request)
    axes, out = _axes(request.vary), _target(request)
    members = math.prod(values for _, _, values in axes.values())
    if members > MOST_WITHOUT_STORE and (out is None or out.suffix.lower() != STORE):
        raise StatementError(
            f"--vary gives {members:.3g} members, which run for minutes to days: give --out runs{STORE}, a folder from "
            f"which the same command continues after an interruption, or at most {MOST_WITHOUT_STORE:,} members."
        )
    points = count("--points", request.points)
    system = load_scene(request)
    fixed = {**run_arguments["initial"], **run_arguments["parameters"]}
    if twice := next((name for name in axes if name in fixed), None):
        raise StatementError(
            f"{twice} has both a range of values, --vary {twice}, and a single value: leave one of them out."
        )
    varied = lg.grid({**{name: [value] for name, value in fixed.items()}, **axes})
    kept = [text.strip() for text in request.keep.split(",")]
    counted = ("steps", "rejected", "evaluations") if "counts" in kept else ()
    results = [text for text in kept if text == "drift" or ":" in text]
    known = dict.fromkeys([*axes, *system.statement.state_names, *results, "t_end", *counted])
    what = _drawn(request, out, axes, [*known], points)
    workers: Any = None if request.workers is None else number("--workers", request.workers)
    how = {key: run_arguments[key] for key in ("method", "rtol", "atol", "step") if run_arguments[key] is not None}
    runs = lg.ensemble(
        system,
        _end(system, run_arguments),
        varied,
        keep=[tuple(text.split(":", 1)) if ":" in text else text for text in kept],
        t_eval=_times(system, run_arguments, points),
        workers=workers,
        store=out if out is not None and out.suffix.lower() == STORE else None,
        progress="lines" if request.progress else not request.json,
        **how,
    )
    counts = Counter(runs.status.tolist())
    ended = {status.value: counts[status] for status in lg.Status if counts[status]}
    stopped = counts[lg.Status.INTERRUPTED] > 0
    report = repr(runs) + (_written(runs, out, what, request.style, stopped=stopped) if out is not None else "")
    data = {"members": len(runs), "shape": [n for n in varied.shape if n > 1], "status": ended, "wall": runs.wall}
    data |= {"form": runs.form, "file": None if out is None else str(out)}
    code = INTERRUPTED if stopped else DONE if set(ended) <= {"success", "event"} else FAILED
    return Answer(code, report, data)


def _target(request: argparse.Namespace) -> Path | None:
    """Return the path of the file or folder that --out names, or None without --out.

    Raises StatementError for an unknown suffix, and for a file that cannot be written. The check is made before the
    runs, which may take long.
    """
    if request.out is None:
        return None
    out = Path(request.out)
    ending = out.suffix.lower()
    if ending not in (*PICTURES, TABLE, STORE):
        netcdf = " A netCDF file is made in Python, by runs.to_xarray().to_netcdf(path)." if ending == ".nc" else ""
        raise StatementError(
            f"--out {request.out}: give a name that ends in .png, .svg or .pdf for a picture, in {TABLE} for a table, "
            f"or in {STORE} for a folder with the results of any number of members.{netcdf}"
        )
    if ending != STORE:
        check_place(out)
    return out


MOST_WITHOUT_STORE = 10_000_000
"""Largest number of members without a store. An ensemble of this size takes minutes even for the fastest systems, and
without a store it cannot be continued after an interruption."""


def _written(runs: Ensemble, out: Path, what: str | None, style: str, *, stopped: bool) -> str:
    """Write the table of an ensemble, or the picture of the quantity `what`, to `out`; return a line that reports this.

    `style` is the style of the picture. If `stopped`, the line says how to continue the interrupted ensemble.
    """
    ending = out.suffix.lower()
    if ending == STORE:
        return f"\nwritten to {out}{'; the same command goes on from here' if stopped else ''}"
    if ending == TABLE:
        runs.to_csv(out)
    else:
        figure = runs.plot(what, style=style)
        write_atomically(out, lambda file: figure.savefig(file, format=ending[1:], dpi=FILE_DPI))
    return f"\nwritten to {out}"


def _axes(texts: list[str]) -> dict[str, tuple[float, float, int]]:
    """Return (low, high, count) of each varied quantity by name; `texts` are the arguments of --vary."""
    if not texts:
        raise StatementError("nothing varies: give --vary NAME=LOW:HIGH:COUNT, such as --vary theta=-3:3:100.")
    axes = {}
    for name, (first, last, value_count) in entries("--vary", texts, "LOW:HIGH:COUNT", "theta=-3:3:100").items():
        low, high = number(f"--vary {name}", first), number(f"--vary {name}", last)
        if not re.fullmatch(r"[0-9]{1,12}", value_count):
            raise StatementError(
                f"--vary {name}: {value_count[:80]!r} is not a number of values. Write one such as 100."
            )
        axes[name] = low, high, int(value_count)
    return axes


def _drawn(
    request: argparse.Namespace, out: Path | None, axes: dict[str, Any], known: list[str], points: int | None
) -> str | None:
    """Return the name of the quantity that the picture of an ensemble shows, or None for the default.

    `out` is the file to write, and `axes` has (low, high, count) of each varied quantity by name. `known` are the
    names that can be drawn, and `points` is the number of output times, or None. Raises StatementError for options that
    do not fit each other.
    """
    ending = "" if out is None else out.suffix.lower()
    if ending not in PICTURES:
        if request.what is not None:
            raise StatementError(
                "--what chooses the quantity of a picture, but no picture is written: add --out map.png."
            )
        if ending == TABLE and points is not None:
            raise StatementError(
                "--points: a table has one line per member and no output times: give --out a picture or a .zarr folder."
            )
        return None
    wide = [name for name, (_, _, values) in axes.items() if values > 1]
    if len(wide) > 2 and points is None:
        raise StatementError(
            f"{listing(wide)} vary, and a picture has two axes: vary one or two, or give --out a .zarr folder."
        )
    if request.what is None:
        return None
    how, colon, name = request.what.partition(":")
    if request.what not in known:
        hint = f" Add --keep {request.what}." if how in REDUCTIONS and name in known else ""
        raise StatementError(
            f"--what {request.what[:80]}: this is not a varied or kept quantity; these are {listing(known)}."
            f"{hint or suggestion(request.what[:80], known)}"
        )
    return f"{how}({name})" if colon else how
