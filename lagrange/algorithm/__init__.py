"""Library of the algorithms of a run, each written once as procedures for every machine."""
