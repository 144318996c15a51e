"""MP4 files, written by the program ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from typing import BinaryIO

from lagrange.errors import RunError
from lagrange.show.animation.film import Film

PROGRAM = "ffmpeg"


def has_ffmpeg() -> bool:
    """Return whether ffmpeg is installed."""
    return shutil.which(PROGRAM) is not None


def write_mp4(file: BinaryIO, film: Film, interval: float, tell: Callable[[int], None]) -> None:
    """Write all frames to a named file; `tell` is called with the number of each drawn frame.

    Raises RunError with the last line of the output of ffmpeg if it fails.
    """
    width, height = film.size
    command = [
        *(PROGRAM, "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{width}x{height}"),
        *("-framerate", f"{1 / interval:.9g}", "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"),
        *("-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", file.name),
    ]
    with tempfile.TemporaryFile() as said:
        # ffmpeg gets a new session: Ctrl-C reaches only this process, which ends ffmpeg.
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said, start_new_session=True)
        try:
            _feed(process, film, tell)
            process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
        if process.returncode:
            said.seek(0)
            words = said.read().decode(errors="replace").strip().splitlines()
            raise RunError(
                f"ffmpeg made no MP4 ({words[-1] if words else f'exit code {process.returncode}'}). Nothing was "
                "written; name a file that ends in .gif or .html."
            )


def _feed(process: subprocess.Popen[bytes], film: Film, tell: Callable[[int], None]) -> None:
    pipe = process.stdin
    if pipe is None:
        return
    try:
        with pipe:
            for number in range(film.frames):
                pipe.write(film.frame(number).tobytes())
                tell(number)
    except BrokenPipeError:
        process.wait()  # it has ended; its exit code and its output give the reason
