"""States on the constraints: how far a state is off them, and the nearest one that is not."""
