"""How a program is run: algorithms with loops and memory, stated once for every language."""
