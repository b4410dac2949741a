"""Pictures moved over one another: windows between pixels, velocities along which frames agree."""
