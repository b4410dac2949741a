"""Labelled grids of designs: grid, run, search, store, cluster and trade-offs."""
