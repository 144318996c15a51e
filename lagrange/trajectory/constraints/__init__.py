"""States and constraints: violations, projection onto the constraints, dependent constraints, discontinuities."""
