"""The command line as a program: `python -m lagrange`, and the script `lagrange`.

Nothing but what handles signals is imported before they are handled.
"""

from __future__ import annotations

import sys

try:
    import lagrange
    from lagrange.interruption import SENTENCE, Interruption
    from lagrange.streams import complain
except KeyboardInterrupt:
    sys.exit(130)  # Ctrl-C in the milliseconds before it is handled


def main() -> int:
    """Do what the arguments ask for and return the exit code; see `lagrange.cli.main`, and 128 + the signal's number.

    Once a signal has asked for the end, whatever ends the command is that interruption: libraries may have made
    another exception of it.
    """
    interruption, code = Interruption(), 0
    try:
        interruption.listen()
        code = lagrange.cli.main()
        interruption.close()
    except BaseException:
        if interruption.number is None:
            raise
        interruption.close()
        complain(SENTENCE)
    return code if interruption.number is None else interruption.code


if __name__ == "__main__":
    sys.exit(main())
