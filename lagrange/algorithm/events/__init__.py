"""Events along a step: where functions on it are zero, and in which order."""
