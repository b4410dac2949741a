r"""The velocity of a thing, by what changes from frame to frame along it.

Frames along a velocity that is off by $\delta$ change by $-t_k\,\delta\cdot s_k$, where $s_k$ is
the slope of the light: that of the thing's own within its outline, and its contrast with what is
behind times the slope of the cover at the outline. The light of each pixel, or its cover, is as
unknown as the velocity: the part of a change that either would explain tells nothing.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.grids import from_outline
from mishutter.decoding.objects.light import Knowledge, Layers, Misfit
from mishutter.decoding.objects.outlines import Along, Lights, behind_in_frames, pure
from mishutter.pictures.registration.refinement import (
    Prior,
    Push,
    Told,
    in_blocks,
    no_less,
    push_of_light,
    refined,
)
from mishutter.pictures.registration.windows import filled, smoothed, splines

_INNER = 3
"""Pixels within an outline that show the thing alone."""
_BAND = 3.0
"""Pixels to both sides of an outline at which the contrast with what is behind tells."""
_FILLED = 12.0
"""Widest Gaussian by which light is filled in, as only that near an outline tells; px."""
_EDGE = 1.5
"""Gaussian under which a cover is taken for one of known slope; px."""
_ASIDE = 0.1
"""Way of a thing, at the frame farthest from the picture, by which frames are differenced; px."""
_NOTHING = 1e-12
"""Information on a velocity where frames tell none; s^2/px^2."""
_SLOPE_NOISE = 1 / (8 * np.pi)
"""Variance of a slope by noise of unit variance, under a Gaussian of 1 px."""


def refine_velocity(arrangement: Arrangement, number: int, lights: Lights | None) -> None:
    """Moves a thing's velocity to where the frames along it differ least.

    Args:
        arrangement: The things.
        number: That of the thing.
        lights: Light of the layers, by which the outline tells; None for what is within it alone.
    """
    stills, thing = arrangement.stills, arrangement.things[number]

    def told_at(velocity: np.ndarray) -> Told:
        thing.velocity = velocity
        return told_of(arrangement, number, lights)

    prior = Prior(thing.first, thing.uncertainty, stills.moves)
    furthest = float(np.max(np.abs(stills.times)))
    found = refined(thing.velocity, told_at, prior, furthest)
    thing.velocity, thing.covariance = found


def refine_by_layers(
    arrangement: Arrangement,
    known: Knowledge,
    misfit: Misfit,
    layers: Layers,
    unexplained: Sequence[Callable[[np.ndarray], np.ndarray]],
) -> float:
    r"""Moves velocities to where the layers explain frames best, however each is blurred.

    Of the slope $s$ of the frames by a velocity, what a change of light and outline explains tells
    nothing: with the rest $r$ of it and the residuals $e$ of the frames, a step is
    $(r^\top e/N) / (r^\top r/N)$. Its error is by how the parts of the thing disagree, and by no
    less than the noise.

    Args:
        arrangement: The things.
        known: The statistics of pictures.
        misfit: The misfit of the layers.
        layers: Their light.
        unexplained: For each thing, what light and its outline leave of a change of the frames.

    Returns:
        The longest way of a step, at the frame farthest from the picture; px.
    """
    sight, stills, steps = misfit.sight, arrangement.stills, [0.0]
    late, free = float(np.max(np.abs(stills.times))), np.flatnonzero(stills.moves)
    among, left = np.ix_(free, free), stills.light - sight.frames(layers)
    for number, thing in enumerate(arrangement.things):
        sheet = sight.sheets[number + 1]
        own, forces = np.zeros((2, *left.shape), np.float32), np.zeros((2, *sheet.size))
        for axis in free:
            aside = _ASIDE / late * np.eye(2)[axis]
            after, before = (
                sight.along(number, thing.velocity + by, arrangement.order, known).frames(layers)
                for by in (aside, -aside)
            )
            own[axis] = unexplained[number]((after - before) * (late / (2 * _ASIDE)))
            for way, force in zip(sheet.until, sight.inverse * own[axis] * left, strict=True):
                forces[axis] += sheet.window.aside(way).cut(force)
        information = np.einsum("iklm,jklm->ij", sight.inverse * own, own, dtype=np.float64)
        information += _NOTHING * np.eye(2)
        push = np.sum(sight.inverse * own * left, axis=(1, 2, 3))
        certain = np.eye(2) / thing.uncertainty**2
        push += certain @ (thing.first - thing.velocity)
        inverse = np.linalg.inv((information + certain)[among])
        each = in_blocks(forces)[free]
        scatter = no_less(each @ each.T, information[among])
        thing.covariance[among] = inverse @ (scatter + certain[among]) @ inverse
        step = inverse @ push[free]
        length = late * float(np.linalg.norm(step))
        thing.velocity[free] += step / max(length, 1.0)
        steps.append(length)
    return max(steps)


def told_of(arrangement: Arrangement, number: int, lights: Lights | None) -> Told:
    """The information of frames on a thing's velocity, at the one that it has."""
    thing, window = arrangement.things[number], arrangement.things[number].window
    along, front = _along(arrangement, number)
    inside = window.of(thing.matte) > 0.5
    inner = np.asarray(ndimage.binary_erosion(inside, iterations=_INNER))
    inner = inner if inner.sum() > 99 else inside
    light, within = _within(arrangement, thing, along, front * inner)
    parts = [within]
    if lights is not None:
        parts.append(
            _at_outline(arrangement, number, (along, front), filled(light, inner, _FILLED), lights)
        )
    return Told.by(parts)


def _along(arrangement: Arrangement, number: int) -> tuple[Along, np.ndarray]:
    """Frames along a thing, and where nothing hides it."""
    stills, thing = arrangement.stills, arrangement.things[number]
    along = Along.of(stills, thing.window, thing.velocity)
    front = along.shares(arrangement.front[number], stills.ways(thing.velocity))
    return along, pure(front) * along.seen


def _within(
    arrangement: Arrangement, thing: Thing, along: Along, seen: np.ndarray
) -> tuple[np.ndarray, Push]:
    """The mean light of a thing, and what it tells, within its outline."""
    stills = arrangement.stills
    weights = stills.weights[:, None, None] * seen
    worth = np.maximum(np.sum(weights, axis=0), 1e-9)
    mean = np.sum(weights * along.frames, axis=0) / worth
    is_seen = np.asarray(seen.any(axis=0))
    # An end of what is seen has no slope.
    smooth = smoothed(filled(mean, is_seen, _FILLED), 1.0)
    noise = np.asarray(stills.typical_noise(smooth))
    weights = np.where(is_seen, weights, 0)
    push = push_of_light(
        along.frames, weights, stills.times, smooth, noise=noise, slope_noise=_SLOPE_NOISE
    )
    return mean, push


def _at_outline(
    arrangement: Arrangement,
    number: int,
    seen: tuple[Along, np.ndarray],
    light: np.ndarray,
    lights: Lights,
) -> Push:
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
    return Push(-slopes * np.sum(weights * late * left, axis=0), outer, 0.0)
