"""Pictures: their files, their linear light, and the power spectrum of their rows."""
