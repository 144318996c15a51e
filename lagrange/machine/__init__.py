"""The machines that run programs: NumPy with printed Python, and machine code through LLVM."""
