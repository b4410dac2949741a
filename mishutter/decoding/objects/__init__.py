"""Several things before a background: their outlines and velocities, and one picture of all."""
