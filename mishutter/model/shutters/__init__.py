"""Shutters: transmittance profiles over one exposure."""
