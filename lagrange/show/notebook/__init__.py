"""Output in notebooks: pages of systems, derivations and results, and tables with pictures."""
