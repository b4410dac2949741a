"""A scene from a clip of one's own camera: its noise, what moves, and how fast."""
