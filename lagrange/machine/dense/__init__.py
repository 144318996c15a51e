"""Dense output: the polynomials of steps and their values at many times, interpreted and in machine code."""
