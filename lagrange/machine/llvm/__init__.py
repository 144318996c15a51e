"""Procedures printed as LLVM IR, compiled to machine code, kept in a cache on disk, and called from Python."""
