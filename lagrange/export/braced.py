"""Base class of printers for languages with braces and semicolons."""

from __future__ import annotations

from lagrange.export.file_printer import FilePrinter
from lagrange.export.lines import continued
from lagrange.procedure.form import PARTIAL


class BracedPrinter(FilePrinter):
    """Prints one procedure. Subclasses define declarations and calls; `index_type` is the type of a loop index."""

    index_type: str

    def tail(self) -> list[str]:
        """Return the lines after the body."""
        return ["}"]

    def broken(self, line: str) -> list[str]:
        """Return a line as several where it is long; a comment stays whole."""
        return [line] if line.lstrip().startswith(("//", "/*")) else continued(line)

    def assign(self, target: str, text: str) -> str:
        """Return an assignment."""
        return f"{target} = {text};"

    def comment(self, text: str) -> str:
        """Return a comment of one line."""
        return f"// {text}"

    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block."""
        match kind, texts:
            case "for", (index, start, stop, step):
                moved = f"{index}++" if step == "1" else f"{index} += {step}"
                return f"for ({self.index_type} {index} = {start}; {index} < {stop}; {moved}) {{"
            case "forever", _:
                return "for (;;) {"
            case "else", _:
                return "} else {"
            case _:
                return f"{kind} ({texts[0]}) {{"

    def closing(self, kind: str) -> str:
        """Return the line that closes a block."""
        return "}"

    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""
        return "break;"

    def partial(self, ref: int, place: str) -> str:
        """Return a partial sum."""
        return f"{self.text(ref)}[{place}]"

    def modulo(self, index: str) -> str:
        """Return an index modulo four."""
        return f"{index} & {PARTIAL - 1}"
