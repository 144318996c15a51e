"""Who runs it: numpy, or machine code through LLVM."""
