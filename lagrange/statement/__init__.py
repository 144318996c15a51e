"""The statement of a system: coordinates, energies, forces and parameters in the user's symbols, read and checked."""
