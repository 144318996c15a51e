"""The colours of lines that are drawn together."""

from __future__ import annotations

from colorsys import hls_to_rgb

COLOURS = ("#0b6e99", "#d1495b", "#3c7d45", "#a35c00", "#6a4c93", "#00798c", "#8d5b4c", "#4a5568")
"""For up to eight lines on white, told apart by people who see few colours too."""

DARK_COLOURS = ("#4db3e0", "#f0808c", "#79c585", "#e0a458", "#b79ae0", "#4fd0dd", "#c9a090", "#a9b4c4")
"""The same hues in the same order, light enough for dark paper."""

_LIGHTNESS, _SATURATION = (0.33, 0.5, 0.62), (0.75, 0.9, 0.55)


def colours(count: int, few: tuple[str, ...] = COLOURS) -> tuple[str, ...]:
    """Return as many colours, no two the same: beyond eight, hues around the circle, light and dark in turn."""
    if count <= len(few):
        return few[:count]
    shares = (hls_to_rgb(k / count, _LIGHTNESS[k % 3], _SATURATION[k % 3]) for k in range(count))
    return tuple("#" + "".join(f"{round(255 * part):02x}" for part in share) for share in shares)
