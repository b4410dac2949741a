"""Argument checks, compilation, threads, validation and files."""
