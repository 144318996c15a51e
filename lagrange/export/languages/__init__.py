"""The languages that models are written in, one module each; `lagrange.export.registry` lists them."""
