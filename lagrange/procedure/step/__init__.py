"""A step program as procedures: where its vectors stand, what is done with them, and one whole step."""
