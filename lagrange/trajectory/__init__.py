"""Runs: methods, the loop over driver calls, events, contacts, constraints, dense output, and how a run ends."""
