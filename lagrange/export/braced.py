"""What printers of languages with braces and semicolons share."""

from __future__ import annotations

from lagrange.export.identifiers import ascii_name
from lagrange.procedure.form import PARTIAL
from lagrange.procedure.source_printer import SourcePrinter


class BracedPrinter(SourcePrinter):
    """Prints one procedure; a language says how names are declared, what is called, and how loops count."""

    def tail(self) -> list[str]:
        """Return the lines behind the body."""
        return ["}"]

    def legal(self, stem: str) -> str:
        """Return a name of the language made of a stem; it may be taken."""
        return ascii_name(stem)

    def assign(self, target: str, text: str) -> str:
        """Return an assignment."""
        return f"{target} = {text};"

    def comment(self, text: str) -> str:
        """Return a comment of one line."""
        return f"// {text}"

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
