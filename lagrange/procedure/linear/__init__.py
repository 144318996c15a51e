"""Linear systems as procedures."""
