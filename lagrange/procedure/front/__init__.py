"""The front end: a plain Python function is read once, and becomes a procedure.

    @procedure
    def factor(n: int, a: In, factors: Out) -> bool:
        ...

    factor(3, a, factors)       # runs as it stands, on NumPy arrays
    factor.form()               # the procedure: printed, compiled, run by the interpreter

`vocabulary` has the words beside Python's own, `plain` the decorators; `docs/dev/procedures.md` says what all of them
mean.
"""
