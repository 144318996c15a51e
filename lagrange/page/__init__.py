"""The web page of a system: one HTML file that computes the motion in JavaScript and draws it."""
