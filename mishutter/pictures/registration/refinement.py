r"""A velocity by what changes from frame to frame along it.

Frames along a velocity that is off by $\delta$ change by $-t_k\,\delta\cdot s_k$, where $s_k$ is
the slope of the light. The light of each pixel is as unknown as the velocity: the part of a change
that it would explain tells nothing.

Slopes of a mean of frames hold its noise. Where they hold little else, the push of the frames is
noise as well, and counts for as little: of $g \sim \mathcal N(H\delta, G)$, with the squares $G$ of
all slopes and $H$ of the light's own, the velocity is told as by $H G^{-1} H$.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_NEAR = 0.005
"""Way by the last step, at the frame farthest from the picture, at which steps end; px."""
_BLOCK = 12
"""Side of the parts of a thing that are held to agree on its velocity; px."""


class Push(NamedTuple):
    """The push of the pixels of a thing on its velocity."""

    # Force on the velocity, and its curvature, of each pixel
    forces: Float[np.ndarray, "2 rows columns"]
    curvatures: Float[np.ndarray, "2 2 rows columns"]
    by_noise: float  # The part of the curvature that is of the noise of slopes


class Told(NamedTuple):
    """The information of frames on a velocity."""

    information: Float[
        np.ndarray, "2 2"
    ]  # Inverse of the covariance; of a velocity of px/s, s^2/px^2
    push: Float[np.ndarray, "2"]  # The same times the change of the velocity
    # Covariance of the push, by how the parts of the thing disagree
    scatter: Float[np.ndarray, "2 2"]

    @staticmethod
    def by(parts: Sequence[Push]) -> "Told":
        """The information of several pushes."""
        information, push, scatter = np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2))
        for part in parts:
            curvature = np.sum(part.curvatures, axis=(2, 3)) + 1e-12 * np.eye(2)
            values, turn = np.linalg.eigh(curvature)
            share = np.maximum(values - part.by_noise, 0) / values
            gain = (turn * share) @ turn.T
            information += (turn * (share**2 * values)) @ turn.T
            push += gain @ np.sum(part.forces, axis=(1, 2))
            each = in_blocks(part.forces)
            scatter += gain @ np.maximum(each @ each.T, 0) @ gain
        return Told(information, push, scatter)


def push_of_light(
    frames: Float[np.ndarray, "frames rows columns"],
    weights: Float[np.ndarray, "frames rows columns"],
    times: Float[np.ndarray, "frames"],
    smooth: Float[np.ndarray, "rows columns"],
    *,
    noise: float | Float[np.ndarray, "rows columns"],
    slope_noise: float,
) -> Push:
    """The push of a thing's own light.

    Args:
        frames: Frames along the velocity.
        weights: Weight of each pixel, 0 where it shows something else.
        times: Times of the frames.
        smooth: The mean of the frames, so smooth that it has slopes.
        noise: Variance of a pixel of the frames.
        slope_noise: Variance of a slope of one frame by noise, over that.
    """
    worth = np.maximum(np.sum(weights, axis=0), 1e-9)
    mean = np.sum(weights * frames, axis=0) / worth
    late = times[:, None, None] - np.sum(weights * times[:, None, None], axis=0) / worth
    slopes = np.array(np.gradient(smooth))
    square = np.sum(weights * late**2, axis=0)
    pushes = np.sum(weights * late * (frames - mean), axis=0)
    outer = slopes[:, None] * slopes[None] * (square / noise)
    return Push(-slopes * (pushes / noise), outer, float(np.sum(square / worth)) * slope_noise)


class Prior(NamedTuple):
    """A velocity as it is known before it is refined."""

    velocity: Float[np.ndarray, "2"]
    uncertainty: float  # Standard deviation of each component
    free: tuple[bool, bool] = (True, True)  # Whether each component is not 0


def refined(
    velocity: Float[np.ndarray, "2"],
    told_at: Callable[[np.ndarray], Told],
    prior: Prior,
    furthest: float,
    num_steps: int = 8,
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """A velocity moved to where the frames along it differ least, and its covariance.

    Args:
        velocity: The first velocity.
        told_at: What frames along a velocity tell of it.
        prior: What is known beforehand.
        furthest: Time from the picture to the farthest frame.
        num_steps: Number of steps.
    """
    free = np.flatnonzero(prior.free)
    among = np.ix_(free, free)
    certain = np.eye(2) / prior.uncertainty**2
    told, longest, last = told_at(velocity), 1.0, np.zeros(2)
    for _ in range(num_steps):
        pull = told.push + certain @ (prior.velocity - velocity)
        step = np.zeros(2)
        step[free] = np.linalg.solve((told.information + certain)[among], pull[free])
        # A mean of frames that are out of place has too little slope: steps by it are too long.
        if step @ last < 0:
            longest = furthest * float(np.linalg.norm(last)) / 2
        length = furthest * float(np.linalg.norm(step))
        last = step * min(1.0, longest / max(length, 1e-9))
        velocity = velocity + last
        told = told_at(velocity)
        if length < _NEAR:
            break
    covariance = np.zeros((2, 2))
    inverse = np.linalg.inv((told.information + certain)[among])
    covariance[among] = inverse @ (told.scatter + certain)[among] @ inverse
    return velocity, covariance


def in_blocks(forces: Float[np.ndarray, "2 rows columns"]) -> Float[np.ndarray, "2 blocks"]:
    """Sums of forces over the blocks of a thing."""
    for axis in (1, 2):
        starts = np.arange(0, forces.shape[axis], _BLOCK)
        forces = np.add.reduceat(forces, starts, axis=axis)
    return forces.reshape(2, -1)


def no_less(
    covariance: Float[np.ndarray, "n n"], least: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    """A covariance that is in no direction less than another, which is positive definite."""
    root = np.linalg.cholesky(least)
    inverse = np.linalg.inv(root)
    values, turn = np.linalg.eigh(inverse @ covariance @ inverse.T)
    turned = root @ turn
    return (turned * np.maximum(values, 1)) @ turned.T
