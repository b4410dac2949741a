"""A finished design, and its file."""
