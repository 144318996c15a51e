"""Write the picture that moves on the page of animations: python docs/double_pendulum.py"""

from __future__ import annotations

from pathlib import Path

import lagrange as lg

solution = lg.scene("double-pendulum").run(8.0, {"theta1": 2.0, "theta2": 2.5})
print(solution.animate(Path(__file__).with_suffix(".gif").with_stem("double-pendulum"), fps=20, size=(440, 440)))
