"""The exposure integral: trajectories, crossings, kernels and transfer functions."""
