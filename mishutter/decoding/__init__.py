"""Restoration of captures: decoders, borders and image quality."""
