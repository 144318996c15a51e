"""Straight-line programs, step programs and series programs: the operations of a computation, in order."""
