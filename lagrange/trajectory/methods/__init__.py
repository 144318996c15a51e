"""Integration methods and their claimed properties: Runge-Kutta, splitting, implicit, variational, Taylor."""
