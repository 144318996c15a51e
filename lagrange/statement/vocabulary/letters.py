"""Letters of names: Latin and Greek letters, digits and underscores. This module does not import SymPy."""

from __future__ import annotations

import re
import unicodedata

GREEK = {
    letter: name.lower() if letter.islower() else name.capitalize()
    for letter in "αβγδεζηθικλμνξρστυφχψωΓΔΘΛΞΣΥΦΨΩ"
    for name in [unicodedata.name(letter).split()[-1].replace("LAMDA", "LAMBDA")]
}
"""Greek letters that a name may contain, with their names. Pi is missing because it is a constant, and others because
they are similar to Latin letters."""

LETTER = f"A-Za-z{''.join(GREEK)}"  # Letters of names, as part of a regular expression

NAME = re.compile(f"[{LETTER}][{LETTER}0-9_]{{0,63}}")

WORD = re.compile(r"[^\W\d][\w\u0300-\u036f]*")
"""Matches a word as people write it: letters of any alphabet, also with accents that are separate characters."""
