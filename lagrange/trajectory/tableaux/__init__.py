"""Coefficients of explicit Runge-Kutta methods as data, and the order conditions against which they are checked."""
