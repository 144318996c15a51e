"""Dense output: the polynomial of a step by its coefficients, for each kind of path, and its values at many times."""
