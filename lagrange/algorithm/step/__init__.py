"""Steps of a method as procedures: memory layout, vectors, one whole step, and loops over steps."""
