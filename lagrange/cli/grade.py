"""The command `lagrange grade`, which compares students' equations with a scene: read files, write the table."""

from __future__ import annotations

import argparse
import codecs
import re
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lagrange.cli.arguments import DONE, FAILED, Answer, CommandParser, load_scene
from lagrange.errors import StatementError
from lagrange.show.files.atomic_file import check_place, write_atomically, write_rows
from lagrange.statement.display import columns_of_output, counter, text_table

if TYPE_CHECKING:
    from lagrange.system import System

LARGEST_FILE = 1_000_000  # Largest size of a file of equations, in bytes
LONGEST_SHOWN = 250  # Longest name of a file in a message, in characters
COLUMNS = ("student", "verdict", "finding", "reading")  # Columns of the table of a folder of answers

_CONTROL = re.compile(r"[\0-\x08\x0e-\x1f]|\A(?:%PDF|\{\\rtf)")
"""Pattern of texts that are not plain: a control character, or the beginning of a PDF or RTF file."""

UNREADABLE = "cannot be read"  # Verdict for an answer that cannot be read


def add_grade(command: CommandParser) -> None:
    """Add to the parser `command` the arguments of the command `grade`: the students' equations, and --out."""
    command.add_argument(
        "file",
        metavar="FILE",
        help="equations as people type them, such as  l theta'' + g sin theta = 0;  or a folder with a file a student",
    )
    command.add_argument("--out", metavar="TABLE.csv", help="file for the table of a folder")


def grade(request: argparse.Namespace) -> Answer:
    """Compare the equations in a file, or in each file of a folder, with the equations of a scene.

    The exit code is 0 if all are right, 1 if some are wrong, and 2 if a single file cannot be read.
    """
    if request.out is not None:
        if not _is_folder(request.file):
            raise StatementError(
                "--out: a table is written only for a folder of answers: leave --out out, or give a folder."
            )
        check_place(Path(request.out))
    system = load_scene(request)
    if _is_folder(request.file):
        return _grade_folder(system, Path(request.file), request.out, progress=not request.json)
    row = _graded(system, Path(request.file))
    if row["verdict"] == UNREADABLE:
        raise StatementError(f"{request.file[:LONGEST_SHOWN]}: {row['finding']}")
    data = {key: row[key] for key in ("right", "message", "details", "read", "wrong", "counterexample")}
    return Answer(DONE if row["right"] else FAILED, f"{row['message']} {row['details']}".rstrip(), data)


def _is_folder(name: str) -> bool:
    """Return True if a folder has this name; False also for a name that is too long for the file system."""
    try:
        return Path(name).is_dir()
    except (OSError, ValueError):
        return False


def _grade_folder(system: System, folder: Path, out: str | None, *, progress: bool) -> Answer:
    """Compare every file of a folder with the system, and write the table to `out` if it is not None.

    A file that cannot be read has the verdict `UNREADABLE`; the other files are still compared. `progress` shows the
    number of compared files.
    """
    files = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".") and not path.is_dir()]
    if not files:
        raise StatementError(f"{folder}: the folder has no files. Put one file with equations for each student in it.")
    stems = Counter(path.stem for path in files)
    rows = []
    with counter(len(files), "answer", enabled=progress) as report:
        for count, path in enumerate(files, 1):
            rows.append(_graded(system, path) | {"student": path.stem if stems[path.stem] == 1 else path.name})
            if report is not None:
                report(count)
    cells = [[str(row[column]) for column in COLUMNS] for row in rows]
    verdicts = Counter(row["verdict"] for row in rows)
    right = verdicts["right"]
    table = text_table(COLUMNS[:3], [row[:3] for row in cells], columns=columns_of_output())
    summary = f"{right} of {len(rows)} are right, {verdicts['wrong']} wrong, and {verdicts[UNREADABLE]} cannot be read."
    if any(path.is_dir() for path in folder.iterdir()):
        summary += " Folders inside are left out: put one file for each student in the folder itself."
    if out is not None:
        write_atomically(out, lambda file: write_rows(file, COLUMNS, list(zip(*cells, strict=True))))
        summary += f" Written to {out}."
    return Answer(DONE if right == len(rows) else FAILED, f"{table}\n\n{summary}", {"answers": rows})


def _graded(system: System, path: Path) -> dict[str, Any]:
    """Compare the equations in one file with those of a system, and return a row of the table as a dict.

    The row has the columns of the table except "student", and all fields of the comparison, for --json.
    """
    row: dict[str, Any] = {"file": str(path), "right": False, "reading": ""}
    try:
        result = system.compare(_text(path))
    except StatementError as error:
        return row | {"verdict": UNREADABLE, "finding": str(error)}
    return row | {
        "verdict": "right" if result else "wrong",
        "finding": "" if result else result.message,
        "reading": result.read.replace("\n", "; "),
        "right": bool(result),
        "message": result.message,
        "details": result.details,
        "read": result.read,
        "wrong": [i + 1 for i in result.wrong],
        "counterexample": dict(result.counterexample),
    }


def _text(path: Path) -> str:
    """Return the text of a file. Raises StatementError if it is too large, is not text, or cannot be read."""
    try:
        if not path.is_file():
            raise StatementError("there is no such file. Give a text file with equations, or a folder of such files.")
        if path.stat().st_size > LARGEST_FILE:
            raise StatementError(
                f"the file has more than {LARGEST_FILE} bytes, too many for equations: give a shorter file."
            )
        data = path.read_bytes()
    except OSError as error:
        raise StatementError(
            f"the file cannot be read ({error.strerror}): check its name and its permissions."
        ) from None
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            text = data.decode(encoding)
            if not _CONTROL.search(text):
                return text
    raise StatementError(
        "the file is not plain text; it may be a document of a word processor. Save the answer as plain text."
    )
