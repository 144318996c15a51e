"""The machines that run programs: one prints them as Python for NumPy, the other compiles machine code with LLVM."""
