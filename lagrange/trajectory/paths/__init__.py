"""Dense output: the path between steps, for each kind of method."""
