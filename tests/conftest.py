"""What every test shares: no window is ever opened, and random examples repeat in continuous integration."""

from __future__ import annotations

import os
import signal

import hypothesis
import matplotlib as mpl

mpl.use("Agg")

# A shell that starts the tests in the background lets them ignore Ctrl-C; what is tested is what a terminal does.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Deadlines measure the machine, not the code: the first call of a kernel compiles it.
hypothesis.settings.register_profile("here", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "here")
