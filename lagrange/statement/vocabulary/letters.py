"""Characters of names: Latin and Greek letters, digits and underscores. This module does not need SymPy."""

from __future__ import annotations

import re

GREEK = {
    "α": "alpha",
    "β": "beta",
    "γ": "gamma",
    "δ": "delta",
    "ε": "epsilon",
    "ζ": "zeta",
    "η": "eta",
    "θ": "theta",
    "ι": "iota",
    "κ": "kappa",
    "λ": "lambda",
    "μ": "mu",
    "ν": "nu",
    "ξ": "xi",
    "ρ": "rho",
    "σ": "sigma",
    "τ": "tau",
    "υ": "upsilon",
    "φ": "phi",
    "χ": "chi",
    "ψ": "psi",
    "ω": "omega",
    "Γ": "Gamma",
    "Δ": "Delta",
    "Θ": "Theta",
    "Λ": "Lambda",
    "Ξ": "Xi",
    "Σ": "Sigma",
    "Υ": "Upsilon",
    "Φ": "Phi",
    "Ψ": "Psi",
    "Ω": "Omega",
}
"""Greek letters that a name may contain, with their names. Pi is missing because it is a constant; others because they
look like Latin letters."""

LETTER = f"A-Za-z{''.join(GREEK)}"  # The letters of names, as part of a regular expression

NAME = re.compile(f"[{LETTER}][{LETTER}0-9_]{{0,63}}")

WORD = re.compile(r"[^\W\d][\w\u0300-\u036f]*")
"""A word as people write it: letters of any alphabet, with accents that are characters of their own."""
