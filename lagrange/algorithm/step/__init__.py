"""Steps of a step program as procedures: memory layout, operations on vectors, and one whole step."""
