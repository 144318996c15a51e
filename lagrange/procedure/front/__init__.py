"""The front end: it translates plain Python functions to procedures.

    @procedure
    def factor(n: int, a: In, factors: Out) -> bool:
        ...

    factor(3, a, factors)       # runs in Python, on NumPy arrays
    factor.form()               # the procedure: to be printed, compiled, or run by the interpreter

`vocabulary` has functions and types beyond Python's own, and `decorators` has `procedure` and `inline`.
`docs/dev/procedures.md` defines their meanings.
"""
