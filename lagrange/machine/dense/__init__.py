"""Dense output, interpreted and in machine code: the polynomial on each step, and the states at any times."""
