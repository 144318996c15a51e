"""Taylor series of motions and the steps that they give, interpreted and in machine code."""
