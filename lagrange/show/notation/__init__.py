"""Formulas on paper: order, signs, fractions and roots, in text, Unicode, LaTeX and MathML."""
