"""The algorithms of a run, each stated once as procedures for every machine."""
