r"""The velocity of a thing, by what changes from frame to frame along it.

Frames along a velocity that is off by $\delta$ change by $-t_k\,\delta\cdot s_k$, where $s_k$ is
the slope of the light: that of the thing's own within its outline, and its contrast with what is
behind times the slope of the cover at the outline. The light of each pixel, or its cover, is as
unknown as the velocity: the part of a change that either would explain tells nothing.

Slopes of a mean of frames hold its noise. Where they hold little else, the push of the frames is
noise as well, and counts for as little: of $g \sim \mathcal N(H\delta, G)$, with the squares $G$ of
all slopes and $H$ of the thing's own, the velocity is told as by $H G^{-1} H$.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.grids import filled, from_outline, smoothed, splines
from mishutter.decoding.objects.outlines import Along, Lights, behind_in_frames, pure

_INNER = 3
"""Pixels within an outline that show the thing alone."""
_BAND = 3.0
"""Pixels to both sides of an outline at which the contrast with what is behind tells."""
_EDGE = 1.5
"""Gaussian under which a cover is taken for one of known slope; px."""
_SLOPE_NOISE = 1 / (8 * np.pi)
"""Variance of a slope by noise of unit variance, under a Gaussian of 1 px."""
_NEAR = 0.005
"""Way by the last step, at the frame farthest from the picture, at which steps end; px."""
_BLOCK = 12
"""Side of the parts of a thing that are held to agree on its velocity; px."""


class _Push(NamedTuple):
    """The push of the pixels of a thing on its velocity."""

    # Force on the velocity, and its curvature, of each pixel
    forces: Float[np.ndarray, "2 rows columns"]
    curvatures: Float[np.ndarray, "2 2 rows columns"]
    by_noise: float  # The part of the curvature that is of the noise of slopes


class Told(NamedTuple):
    """The information of frames on a velocity."""

    information: Float[np.ndarray, "2 2"]  # Inverse of the covariance; s^2/px^2
    push: Float[np.ndarray, "2"]  # The same times the change of the velocity; s/px
    # Covariance of the push, by how the parts of the thing disagree
    scatter: Float[np.ndarray, "2 2"]


def refine_velocity(
    arrangement: Arrangement, number: int, lights: Lights | None, num_steps: int = 8
) -> None:
    """Moves a thing's velocity to where the frames along it differ least.

    Args:
        arrangement: The things.
        number: That of the thing.
        lights: Light of the layers, by which the outline tells; None for what is within it alone.
        num_steps: Number of steps.
    """
    stills, thing = arrangement.stills, arrangement.things[number]
    free = np.flatnonzero(stills.moves)
    among = np.ix_(free, free)
    prior = np.eye(2) / thing.uncertainty**2
    furthest = float(np.max(np.abs(stills.times)))
    told, longest, last = told_of(arrangement, number, lights), 1.0, np.zeros(2)
    for _ in range(num_steps):
        pull = told.push + prior @ (thing.first - thing.velocity)
        step = np.zeros(2)
        step[free] = np.linalg.solve((told.information + prior)[among], pull[free])
        # A mean of frames that are out of place has too little slope: steps by it are too long.
        if step @ last < 0:
            longest = furthest * float(np.linalg.norm(last)) / 2
        length = furthest * float(np.linalg.norm(step))
        last = step * min(1.0, longest / max(length, 1e-9))
        thing.velocity = thing.velocity + last
        told = told_of(arrangement, number, lights)
        if length < _NEAR:
            break
    thing.covariance = np.zeros((2, 2))
    inverse = np.linalg.inv((told.information + prior)[among])
    apart = told.scatter[among]
    thing.covariance[among] = inverse @ (apart + prior[among]) @ inverse


def told_of(arrangement: Arrangement, number: int, lights: Lights | None) -> Told:
    """The information of frames on a thing's velocity, at the one that it has."""
    thing, window = arrangement.things[number], arrangement.things[number].window
    along, front = _along(arrangement, number)
    inside = window.of(thing.matte) > 0.5
    inner = np.asarray(ndimage.binary_erosion(inside, iterations=_INNER))
    inner = inner if inner.sum() > 99 else inside
    information, push, scatter = np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2))
    light, within = _within(arrangement, thing, along, front * inner)
    parts = [within]
    if lights is not None:
        parts.append(_at_outline(arrangement, number, (along, front), filled(light, inner), lights))
    for part in parts:
        curvature = np.sum(part.curvatures, axis=(2, 3)) + 1e-12 * np.eye(2)
        values, turn = np.linalg.eigh(curvature)
        share = np.maximum(values - part.by_noise, 0) / values
        gain = (turn * share) @ turn.T
        information += (turn * (share**2 * values)) @ turn.T
        push += gain @ np.sum(part.forces, axis=(1, 2))
        each = _in_blocks(part.forces)
        scatter += gain @ np.maximum(each @ each.T, 0) @ gain
    return Told(information, push, scatter)


def _along(arrangement: Arrangement, number: int) -> tuple[Along, np.ndarray]:
    """Frames along a thing, and where nothing hides it."""
    stills, thing = arrangement.stills, arrangement.things[number]
    along = Along.of(stills, splines(stills.light), thing.window, thing.velocity)
    front = along.shares(arrangement.front[number], stills.ways(thing.velocity))
    return along, pure(front) * along.seen


def _within(
    arrangement: Arrangement, thing: Thing, along: Along, seen: np.ndarray
) -> tuple[np.ndarray, _Push]:
    """The mean light of a thing, and what it tells, within its outline."""
    stills = arrangement.stills
    weights = stills.weights[:, None, None] * seen
    worth = np.maximum(np.sum(weights, axis=0), 1e-9)
    mean = np.sum(weights * along.frames, axis=0) / worth
    is_seen = np.asarray(seen.any(axis=0))
    # An end of what is seen has no slope.
    smooth = smoothed(filled(mean, is_seen), 1.0)
    times = stills.times[:, None, None]
    late = times - np.sum(weights * times, axis=0) / worth
    noise = stills.typical_noise(smooth)
    slopes = np.array(np.gradient(smooth))
    square = np.sum(weights * late**2, axis=0)
    pushes = np.sum(weights * late * (along.frames - mean), axis=0)
    outer = slopes[:, None] * slopes[None] * (square / noise)
    by_noise = float(np.sum((square / worth * _SLOPE_NOISE)[is_seen]))
    return mean, _Push(-slopes * (pushes / noise), outer, by_noise)


def _at_outline(
    arrangement: Arrangement,
    number: int,
    seen: tuple[Along, np.ndarray],
    light: np.ndarray,
    lights: Lights,
) -> _Push:
    """The push of a thing's outline, by its contrast with what is behind."""
    stills, thing = arrangement.stills, arrangement.things[number]
    (along, front), window = seen, thing.window
    ways = stills.ways(thing.velocity)
    hidden = splines(behind_in_frames(arrangement, lights, number))
    pairs = zip(hidden, ways, strict=True)
    behind = np.stack([window.taken(one, way, is_spline=True) for one, way in pairs])
    known = [window.taken(lights.known, way) for way in ways]
    inside = window.of(thing.matte) > 0.5
    distance = from_outline(inside)
    seen_there = front * (np.stack(known) > 0.99) * (distance <= _BAND)
    cover = smoothed(inside.astype(np.float32), _EDGE)
    slopes = np.array(np.gradient(cover))
    contrast = light - behind
    noise = np.stack([stills.noise(np.maximum(behind, light)[k], k) for k in range(stills.count)])
    weights = seen_there / noise
    left = along.frames - behind - cover * contrast
    late = stills.times[:, None, None] * contrast
    # The cover of a pixel is unknown: what it would explain tells nothing.
    square = np.maximum(np.sum(weights * contrast**2, axis=0), 1e-9)
    late = late - contrast * np.sum(weights * contrast * late, axis=0) / square
    left = left - contrast * np.sum(weights * contrast * left, axis=0) / square
    outer = slopes[:, None] * slopes[None] * np.sum(weights * late**2, axis=0)
    return _Push(-slopes * np.sum(weights * late * left, axis=0), outer, 0.0)


def _in_blocks(forces: Float[np.ndarray, "2 rows columns"]) -> Float[np.ndarray, "2 blocks"]:
    """Sums of forces over the blocks of a thing."""
    for axis in (1, 2):
        starts = np.arange(0, forces.shape[axis], _BLOCK)
        forces = np.add.reduceat(forces, starts, axis=axis)
    return forces.reshape(2, -1)
