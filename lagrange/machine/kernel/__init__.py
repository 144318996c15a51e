"""Right-hand sides and other programs of one state or many, interpreted and in machine code."""
