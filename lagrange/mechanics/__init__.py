"""What a course of mechanics asks of a system: other forms of it and findings about it, in SymPy, tested by number."""
