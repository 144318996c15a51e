"""The machines: numpy, and machine code through LLVM."""
