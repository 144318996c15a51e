"""What is measured along a run: drifts, invariants, constraint violations and constraint forces."""
