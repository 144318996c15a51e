"""HTML pages: a system whose motion the page computes in JavaScript, and the player of a recorded run.

Their scripts, styles and frames are in `template/`.
"""
