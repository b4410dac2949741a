"""The recorded picture: capture, occlusion, footage and noise."""
