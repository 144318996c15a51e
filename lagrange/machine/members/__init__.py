"""Procedures in machine code for many members at once, one in each lane of a vector."""
