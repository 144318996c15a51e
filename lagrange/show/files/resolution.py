"""The resolution of picture files."""

from __future__ import annotations

FILE_DPI = 150
"""Dots per inch of a picture file, unless others are asked for."""
