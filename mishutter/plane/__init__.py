"""Things that move in any direction, and frames of a sensor that moves in the plane."""
