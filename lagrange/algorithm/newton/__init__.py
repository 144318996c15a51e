"""Newton's method for the unknowns of a step, as procedures."""
