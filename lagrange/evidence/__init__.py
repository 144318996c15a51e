"""Is it right? Compiled quantities against numerical differentiation of the energies as stated."""
