"""The problem of a design: motions, scenes and their files, images, shutters."""
