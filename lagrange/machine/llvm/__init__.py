"""Procedures printed as LLVM IR, compiled to machine code, kept in a cache in memory, called from Python."""
