"""Frames whose rows are exposed one after another, against dense covariances of their pixels.

The response of each pixel is that of a global shutter as late as its row is. Frames have unlike
noises, and their sensor moves.
"""

import numpy as np
import pytest

from mishutter import FreeMotion, PlaneFrames, Scene, Sensor, TimedFrame
from mishutter.camera.responses import frequencies_on
from mishutter.camera.rows import counted_in
from mishutter.decoding.frame_likelihood import Own, Prior, slope_at
from mishutter.decoding.rolling import RowTimes

NOISES = np.array([2e-2, 5e-3, 1e-2])
LIGHT = {"photon_rate": 3e4, "read_noise": 6.0}
EXPOSURE = 0.012
EXACT = {"along": 1e-8, "across": 1e-8, "plane": 1e-5}
"""Residuals at which gradients end."""


def on_parabolas():
    """Three frames on parabolas of unlike curvature, the last of which goes back."""
    motions = zip((9e4, 4e4, -7e4), (-0.03, -0.01, 0.02), strict=True)
    return [
        TimedFrame(FreeMotion(accelerations=[a], half_exposure=EXPOSURE / 2), t, 2.0 * k)
        for k, (a, t) in enumerate(motions)
    ]


def own_of(kind, noises=NOISES, *, has_levels=True, seed=0):
    """Frames of lines along or across the readout, or of the plane, and a velocity of theirs."""
    random = np.random.default_rng(seed)
    if kind == "plane":
        shape, velocity = (9, 7), np.array([-160.0, 110.0])
        scene = Scene.any_direction(300.0, **LIGHT, sensor=Sensor(readout=0.008, rows_read="up"))
        times = RowTimes.of(scene.sensor, shape, in_plane=True)
        path = np.array([[150.0, -220.0, 60.0], [-90.0, 180.0, 40.0]])
        taken = PlaneFrames(
            np.array([0.02, 0.06, 0.1]), np.full(3, EXPOSURE), np.full(2, 0.06), path
        )
    else:
        axis, shape = ("columns", (2, 30)) if kind == "along" else ("rows", (5, 30))
        velocity = np.array([-430.0])
        sensor = Sensor(readout=0.004, axis=axis, rows_read="up" if kind == "along" else "down")
        scene = Scene(np.linspace(-600.0, 600.0, 5), **LIGHT, sensor=sensor)
        times, taken = RowTimes.of(sensor, shape), on_parabolas()
    frames = 0.2 * random.normal(size=(3, *shape))
    return Own(frames, noises, taken, Prior(scene), times, has_levels), velocity


def pixels_of(level, velocity):
    """Waves that each pixel sees: of pictures, frames, rows and columns; waves of half of a DFT."""
    canvas, paths = level.canvas, level.rows.paths
    each = [level._replace(rows=None, instants=paths.at(d)) for d in paths.delays.tolist()]
    every = np.stack([one.responses(velocity[None])[:, 0] for one in each], axis=1)
    lines = [m + np.arange(n) for m, n in zip(canvas.margin, canvas.sensor, strict=True)]
    turns = [
        np.exp(2j * np.pi * np.outer(line, np.ravel(f)))
        for line, f in zip(lines, frequencies_on(canvas.shape), strict=True)
    ]
    if len(turns) == 2:
        return np.einsum("krdf,rd,cf->krcdf", every, turns[0], turns[1])[None]
    if paths.is_along:
        own = every * turns[0][:, None]
        return np.stack([np.swapaxes(own, 1, 2)] * canvas.frames.shape[1])
    return np.swapaxes(every * turns[0], 0, 1)[:, :, None]


def dense(level, velocity):
    """Logarithms of likelihood over no picture's, and what the likeliest pictures leave."""
    canvas = level.canvas
    frames = canvas.frames[None] if len(canvas.shape) == 2 else np.swapaxes(canvas.frames, 0, 1)
    frames = frames.reshape(len(frames), len(canvas.noises), -1, canvas.sensor[-1])
    weight = counted_in(canvas.shape[-1]) * canvas.power / np.prod(canvas.shape)
    known = np.eye(canvas.frames[0, 0].size if len(canvas.shape) == 1 else frames[0, 0].size)
    known = known - (0 if canvas.has_levels else 1 / len(known))
    inverse = np.kron(np.diag(1 / canvas.noises), known)
    gains, seen = [], []
    for waves, light in zip(pixels_of(level, velocity), frames, strict=True):
        flat = (waves * np.sqrt(weight)).reshape(light.size, -1)
        # Numbers of unit variance: the real and the imaginary part of each wave.
        root = np.concatenate([flat.real, flat.imag], axis=1)
        covariance, told = root @ root.T, light.ravel()
        explained = covariance @ np.linalg.solve(
            np.eye(told.size) + inverse @ covariance, inverse @ told
        )
        gains.append(told @ inverse @ explained / 2)
        seen.append(explained.reshape(light.shape))
    return np.array(gains), np.array(seen)


KINDS = [("along", True), ("along", False), ("across", True), ("across", False), ("plane", True)]


@pytest.mark.parametrize(("kind", "has_levels"), KINDS)
def test_the_likelihood_of_rows_in_turn_is_that_of_a_dense_covariance(kind, has_levels):
    """At two velocities at once, be the level of each row known or not."""
    own, velocity = own_of(kind, has_levels=has_levels)
    both = np.stack([velocity, 0.4 * velocity])
    level = own.level(both, share=1e-9)
    found = level.likeliest(both, EXACT[kind])
    # Splines between few delays pass the turns of a path by so much.
    within = 1e-4 if kind == "across" else 2e-3
    for number, each in enumerate(both):
        gains, seen = dense(level, each)
        np.testing.assert_allclose(np.ravel(found.gains[number]), gains, rtol=within)
        left = found.seen[:, number]
        left = left[None] if kind == "plane" else np.swapaxes(left, 0, 1)
        np.testing.assert_allclose(left.reshape(seen.shape), seen, atol=within / 10)
        if kind != "plane":
            squares = np.mean(np.abs(pixels_of(level, each)) ** 2, axis=(2, 3))
            told = np.einsum("rkf,k->rf", squares, 1 / own.noises)
            np.testing.assert_allclose(
                found.density[number], told[: found.density.shape[1]], rtol=1e-2
            )


@pytest.mark.parametrize("kind", ["along", "across", "plane"])
def test_slopes_of_rows_in_turn_are_those_of_their_likelihood(kind):
    """By differences of gains, of each component of a velocity."""
    own, velocity = own_of(kind)
    level, side = own.level(velocity[None], share=1e-9), 0.1
    found = np.sum(slope_at(level, velocity, EXACT[kind]).scores, axis=(1, 2, 3))
    for component, slope in zip(side * np.eye(velocity.size), found, strict=True):
        ends = np.stack([velocity + component, velocity - component])
        gains = level.likeliest(ends, EXACT[kind]).gains.reshape(2, -1).sum(axis=1)
        assert slope == pytest.approx((gains[0] - gains[1]) / (2 * side), rel=3e-3)


@pytest.mark.parametrize("kind", ["along", "across", "plane"])
def test_some_frames_are_all_where_the_others_are_noise(kind):
    """The instants of rows count from the first of those that are looked at."""
    own, velocity = own_of(kind)
    some = own.level(velocity[None], part=slice(1, None), share=1e-9)
    noisy, _ = own_of(kind, NOISES * np.array([1e9, 1.0, 1.0]))
    whole = noisy.level(velocity[None], share=1e-9).likeliest(velocity[None], EXACT[kind])
    found = some.likeliest(velocity[None], EXACT[kind])
    np.testing.assert_allclose(found.gains, whole.gains, rtol=2e-3)
    np.testing.assert_allclose(found.seen, whole.seen[1:], atol=2e-4)
