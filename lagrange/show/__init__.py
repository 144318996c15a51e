"""Output for people: solutions, plots, derivations, files."""
