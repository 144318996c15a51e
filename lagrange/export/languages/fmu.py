"""FMUs of FMI 2.0 and FMI 3.0: the C sources, their description, and a library for this platform."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from importlib.resources import files as resources
from io import BytesIO
from pathlib import Path

from lagrange.errors import LagrangeError
from lagrange.export.fmu.description import build_description, fmi2_description, fmi3_description, model_header
from lagrange.export.languages.c import header, programs, source
from lagrange.export.module import SourceModule
from lagrange.export.target import Target, register

DATE = (1980, 1, 1, 0, 0, 0)
"""Date of every file in the archive. It is constant, so that one statement always gives the same bytes."""

COMPILER = ("cc", "-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
"""Compiler command for the library, which exports only the functions of FMI."""

ARCHITECTURES = {"x86_64": "x86_64", "AMD64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}


@register
class Fmu(Target):
    """Target `fmu`: an FMU of FMI 2.0 and one of FMI 3.0. Each has a right-hand side, and a run for co-simulation."""

    name = "fmu"
    about = "FMUs of FMI 2.0 and 3.0: model exchange and co-simulation, C sources inside, a library for this platform"
    contents = frozenset(("runs", "main"))
    always = ("rhs", "main")
    shell = (
        "python3 -m zipfile -e {name}_fmi3.fmu {name}_fmi3",
        "cc -std=c99 -O2 -o {name}_{program} {name}_fmi3/sources/{name}.c {name}_fmi3/sources/{name}_{program}.c -lm",
        "./{name}_{program}",
    )
    """Shell lines that unpack the FMU of FMI 3.0, and compile and run a program of its sources."""

    def files(self, module: SourceModule) -> Mapping[str, bytes]:
        """Return the FMU for each version of FMI, by file name."""
        return {f"{module.name}_fmi{major}.fmu": archive(contents(module, major)) for major in (2, 3)}


def contents(module: SourceModule, major: int) -> dict[str, str | bytes]:
    """Return the files in an FMU of FMI `major`, with a compiled library if there is a compiler."""
    inside = resources("lagrange.export.fmu")
    sources = {
        f"{module.name}.h": header(module),
        f"{module.name}.c": source(module),
        **{name: inside.joinpath(name).read_text("ascii") for name in ("fmi-instance.h", "fmi-functions.c")},
    }
    digest = hashlib.sha256("".join([*module.statement, *sources.values()]).encode()).hexdigest()
    token = f"{{{uuid.UUID(digest[:32])}}}"
    sources["fmi-model.h"] = model_header(module, token, major)
    described = fmi2_description(module, token) if major == 2 else fmi3_description(module, token)
    contained: dict[str, str | bytes] = {"modelDescription.xml": described}
    contained |= {f"sources/{name}": text for name, text in (sources | programs(module)).items()}
    if major == 3:
        contained["sources/buildDescription.xml"] = build_description(module)
    where = binary_path(module.name, major)
    if where and shutil.which(COMPILER[0]):
        contained[where] = library(module.name, sources)
    return contained


def binary_path(name: str, major: int) -> str | None:
    """Return the path in an FMU of this platform's library, or None if FMI `major` has no name for the platform."""
    architecture = ARCHITECTURES.get(platform.machine())
    system = {"linux": "linux", "darwin": "darwin"}.get(sys.platform)
    if architecture is None or system is None:
        return None
    suffix = "so" if system == "linux" else "dylib"
    if major == 3:
        return f"binaries/{architecture}-{system}/{name}.{suffix}"
    return f"binaries/{system}64/{name}.{suffix}" if architecture == "x86_64" or system == "darwin" else None


def library(name: str, sources: Mapping[str, str]) -> bytes:
    """Return a compiled shared library of the sources, as bytes. Raises LagrangeError if the compiler fails."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for file, text in sources.items():
            folder.joinpath(file).write_text(text, "ascii")
        command = [*COMPILER, "-o", "library", "fmi-functions.c", f"{name}.c", "-lm"]
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if process.returncode:
            raise LagrangeError(f"{' '.join(command)} failed: {process.stderr.strip()}")
        return folder.joinpath("library").read_bytes()


def archive(found: Mapping[str, str | bytes]) -> bytes:
    """Return a zip archive of the files `found`; the same files give the same bytes."""
    data = BytesIO()
    with zipfile.ZipFile(data, "w") as packed:
        for name, text in found.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            packed.writestr(entry, text)
    return data.getvalue()
