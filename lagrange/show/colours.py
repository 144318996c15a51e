"""The colours of lines that are drawn together."""

from __future__ import annotations

from colorsys import hls_to_rgb

COLOURS = ("#0b6e99", "#d1495b", "#3c7d45", "#a35c00", "#6a4c93", "#00798c", "#8d5b4c", "#4a5568")
"""For up to eight lines, told apart by people who see few colours too."""

_LIGHTNESS, _SATURATION = (0.33, 0.5, 0.62), (0.75, 0.9, 0.55)


def colours(count: int) -> tuple[str, ...]:
    """Return as many colours, no two the same: beyond eight, hues around the circle, light and dark in turn."""
    if count <= len(COLOURS):
        return COLOURS[:count]
    shares = (hls_to_rgb(k / count, _LIGHTNESS[k % 3], _SATURATION[k % 3]) for k in range(count))
    return tuple("#" + "".join(f"{round(255 * part):02x}" for part in share) for share in shares)
