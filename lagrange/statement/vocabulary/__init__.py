"""Vocabulary of expressions: letters of names, elementary functions, and names of functions in texts."""
