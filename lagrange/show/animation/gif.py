"""Write an animation as a GIF file, or by ffmpeg as an MP4 file."""

from __future__ import annotations

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import RunError
from lagrange.show.animation.film import Film, Pixels
from lagrange.show.figures.style import parts_of

SHORTEST_FRAME = 2
"""Least duration of a frame, in hundredths of a second: browsers show a shorter frame for a tenth of a second."""

_BLENDS = 9  # Shades between the background and each colour, for the edges of lines and for trails
_CLEAR = 255  # Index of the transparent colour: the pixel of the previous frame stays

_FOREVER = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"
"""Extension block that repeats the animation forever."""


def write_gif(file: BinaryIO, film: Film, interval: float, tell: Callable[[int], None]) -> None:
    """Write the frames of a film as a GIF; `tell` is called with the number of each drawn frame.

    Each frame is shown for `interval` seconds; if this is too short for a GIF, some frames are left out. The file
    stores for each frame the smallest rectangle that contains the changed pixels. Unchanged pixels in this rectangle
    are transparent, which compresses well.
    """
    from PIL import GifImagePlugin
    from PIL.Image import fromarray

    every = max(1, int(np.ceil(SHORTEST_FRAME / 100 / interval - 1e-9)))
    numbers = range(0, film.frames, every)
    # Ends of frames are rounded, not their durations, so that rounding errors do not add up.
    ends = np.rint(100 * interval * every * np.arange(len(numbers) + 1)).astype(int)
    colours = _Colours(film.palette)
    width, height = film.size
    file.write(b"GIF89a" + struct.pack("<HHBBB", width, height, 0xF7, 0, 0) + colours.table.tobytes() + _FOREVER)
    before: NDArray[np.uint32] = np.zeros((height, width), dtype=np.uint32)
    for number, duration in zip(numbers, np.diff(ends).tolist(), strict=True):
        frame = film.frame(number)
        whole = frame.view(np.uint32)[:, :, 0]
        changed = whole != before
        top, bottom = _ends(changed.any(axis=1))
        left, right = _ends(changed[top:bottom].any(axis=0))
        part = slice(top, bottom), slice(left, right)
        numbered = np.full(changed[part].shape, _CLEAR, dtype=np.uint8)
        numbered[changed[part]] = colours.nearest[_cells(frame[part][changed[part]])]
        image = fromarray(numbered)
        image.putpalette(colours.table.tobytes())
        for block in GifImagePlugin.getdata(
            image, (left, top), duration=10 * duration, disposal=1, transparency=_CLEAR, interlace=0
        ):
            file.write(block)
        before = whole.copy()
        tell(number)
    file.write(b";")


def _ends(changed: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the index of the first true value in `changed`, and the index after its last one; (0, 1) without any."""
    indices = np.flatnonzero(changed)
    return (int(indices[0]), int(indices[-1]) + 1) if len(indices) else (0, 1)


class _Colours:
    """Colour table of a GIF: `table` (256, 3) has up to 255 colours, those of a film and blends with the background.

    `nearest` has the row of the nearest colour in `table` for each of the 32,768 colours that `_cells` distinguishes.
    """

    def __init__(self, film_colours: tuple[str, ...]) -> None:
        base = np.rint(255.0 * np.array([parts_of(colour) for colour in film_colours]))
        paper = base[0]
        blends = max(2, min(_BLENDS, 254 // (len(base) - 1)))
        shares = np.arange(1, blends + 1) / blends
        shades = [paper + share * (colour - paper) for colour in base[1:] for share in shares]
        colours = np.unique(np.rint([paper, *shades]).astype(np.uint8), axis=0)[:_CLEAR]
        self.table = np.zeros((256, 3), dtype=np.uint8)
        self.table[: len(colours)] = colours
        grid = np.indices((32, 32, 32), dtype=np.float32).reshape(3, -1).T * (255 / 31)
        entries = colours.astype(np.float32)
        far = (entries**2).sum(axis=1)
        self.nearest: Pixels = (far - 2 * grid @ entries.T).argmin(axis=1).astype(np.uint8)
        whole = np.rint(base).astype(np.uint8)  # large areas have these colours, which stay exact
        self.nearest[_cells(whole)] = [int((colours == colour).all(axis=1).argmax()) for colour in whole]


def _cells(pixels: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return an index (K,) for the colour of each pixel (K, 4), rounded to one of 32 by 32 by 32 colours."""
    red, green, blue = (pixels[:, k].astype(np.uint16) >> np.uint16(3) for k in range(3))
    cells: NDArray[np.uint16] = (red << np.uint16(10)) | (green << np.uint16(5)) | blue
    return cells


PROGRAM = "ffmpeg"


def has_ffmpeg() -> bool:
    """Return True if ffmpeg is installed."""
    return shutil.which(PROGRAM) is not None


def write_mp4(file: BinaryIO, film: Film, interval: float, tell: Callable[[int], None]) -> None:
    """Write the frames of a film as an MP4 file; `tell` is called with the number of each drawn frame.

    Each frame is shown for `interval` seconds. Raises RunError with the last line of ffmpeg's output if ffmpeg fails.
    """
    width, height = film.size
    command = [
        *(PROGRAM, "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{width}x{height}"),
        *("-framerate", f"{1 / interval:.9g}", "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"),
        *("-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", file.name),
    ]
    with tempfile.TemporaryFile() as output:
        # ffmpeg gets a new session: Ctrl-C reaches only this process, which ends ffmpeg.
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output, start_new_session=True)
        try:
            _feed(process, film, tell)
            process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
        if process.returncode:
            output.seek(0)
            words = output.read().decode(errors="replace").strip().splitlines()
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
        process.wait()  # ffmpeg has ended; its exit code and its output give the reason
