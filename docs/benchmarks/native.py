"""C of this folder, compiled by gcc and loaded, and the libraries of SUNDIALS that it may call."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path

import sksundae
from measure import FOLDER

FLAGS = ("-O3", "-march=native")
SUNDIALS = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense")


def compiled(name: str) -> ctypes.CDLL:
    """Return the library of a C file of this folder."""
    with tempfile.TemporaryDirectory() as folder:
        target = (Path(folder) / name).with_suffix(".so")
        subprocess.run(["gcc", *FLAGS, "-shared", "-fPIC", "-o", target, FOLDER / name, "-lm"], check=True)
        return ctypes.CDLL(str(target))


def load_sundials(solver: str) -> None:
    """Load the libraries of a solver that scikit-sundae brings, so that C that is loaded later finds their symbols."""
    libraries = Path(sksundae.__file__).parent.parent / "scikit_sundae.libs"
    for name in (*SUNDIALS, solver):
        (path,) = libraries.glob(f"libsundials_{name}-*")
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
