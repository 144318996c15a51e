"""How a run is computed: the algorithms, each stated once as procedures for every machine."""
