"""What the user said: coordinates, energies, forces, parameters; checked, in the user's symbols."""
