"""Decoders: from a capture back to the picture."""
