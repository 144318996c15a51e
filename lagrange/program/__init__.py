"""In which order it is computed: straight-line programs, and steps of integrators."""
