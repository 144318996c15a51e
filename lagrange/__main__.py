"""`python -m lagrange` is the command line."""

from __future__ import annotations

import sys

from lagrange.cli import main

sys.exit(main())
