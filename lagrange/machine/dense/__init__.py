"""Dense output on the machines: these evaluate the polynomials of many steps, interpreted or in machine code."""
