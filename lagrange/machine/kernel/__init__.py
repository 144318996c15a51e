"""Kernels: right-hand sides and other programs for one state or many, interpreted and in machine code."""
