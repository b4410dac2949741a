"""A camera as it was built, from its recordings."""
