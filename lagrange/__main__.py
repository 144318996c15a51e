"""Start the command line: `python -m lagrange`, and the script `lagrange`. Commands are in `lagrange/cli`.

Before the signal handlers are installed, only the modules that these handlers need are imported.
"""

from __future__ import annotations

import sys
from importlib import import_module

PROGRAM = "lagrange.cli.program"
"""Module of the command line, imported after the signal handlers are installed."""

try:
    from lagrange.cli.interruption import SENTENCE, Interruption, complain
except KeyboardInterrupt:
    sys.exit(130)  # Ctrl-C in the milliseconds before it is handled


def main() -> int:
    """Run the command line and return its exit code, or 128 + the number of the signal that ended it.

    After a signal every exception counts as an interruption, because libraries may replace KeyboardInterrupt by another
    exception.
    """
    interruption, code = Interruption(), 0
    try:
        interruption.listen()
        code = import_module(PROGRAM).main()
        interruption.close()
    except BaseException:
        if interruption.number is None:
            raise
        interruption.close()
        complain(SENTENCE)
    return code if interruption.number is None else interruption.code


if __name__ == "__main__":
    sys.exit(main())
