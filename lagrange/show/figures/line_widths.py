"""Line widths of all figures and animations, in typographic points."""

FRAME = 0.7  # Grid and frame of a panel, and the lines at zero
FLOOR = 0.8  # Floor under paths in space, and the shadows on it
THIN = 0.9  # Paths of points, orbits, borders of regions, and edges of shapes
MANY = 1.0  # Drifts, single members and outer quantiles of an ensemble, and methods of other libraries in a race
PLANE = 1.1  # Curves in a phase plane, and nullclines
CURVE = 1.3  # Quantities over time, or along a varied quantity
BOLD = 1.6  # Rods, springs, and the main curve of a figure
BRANCH = 1.8  # Branches of equilibria, and the median in a histogram
AT_REST = 1.4  # Links of the positions at rest, in a figure of modes
SEPARATRIX = 2.0
SURFACE = 2.4

NEAREST, FARTHEST = 1.6, 0.4  # Widths of a path in space: of its nearest part, and the limit for parts far away

MOVING_CURVE, COMING_CURVE = 1.5, 1.2  # In an animation: a curve up to the time of the frame, and after it
MOVING_ROD, MOVING_SPRING, MOVING_EDGE = 2.4, 1.4, 1.2
MOVING_SURFACE = 3.0
TRAIL = 2.0
MARK = 1.0  # In an animation: the line at the time of the frame, and from a point to its shadow
