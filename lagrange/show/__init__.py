"""What a person sees: solutions, plots, derivations, files."""
