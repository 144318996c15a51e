"""Taylor series of motions and steps by these series, interpreted and in machine code."""
