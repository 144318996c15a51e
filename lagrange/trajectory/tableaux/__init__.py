"""Coefficients of integration methods as data, and the order conditions against which they are checked."""
