"""Linear algebra as procedures: L D L^T and LU factors, inverses, and complementarity problems by Lemke's method."""
