"""Steps of methods, step control and Newton's method, interpreted and in machine code."""
