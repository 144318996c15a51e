"""The statement of a system: coordinates, energies, forces and parameters, checked, in the user's symbols."""
