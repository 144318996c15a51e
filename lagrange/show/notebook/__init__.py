"""Show systems, derivations and results in a notebook: pages with formulas, and tables with pictures."""
