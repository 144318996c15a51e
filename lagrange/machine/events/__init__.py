"""Events along steps in machine code."""
