"""Ways are told from the path found, whatever tie it was found from."""

import numpy as np
import pytest

from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import FramePath, TimedFrame
from mishutter.model.motion import FreeMotion, LinearMotion, StillCamera
from mishutter.search.frame_ties import (
    ALTERNATING,
    BRACKETED,
    CIRCLE,
    CROSSED,
    FAN,
    FOLLOW,
    FREE,
    PAN,
    RING,
    STILLS,
    SWEEP,
    SWINGS,
    TWO_SINES,
)
from mishutter.search.frame_words import flights_back, kind_of

PERIOD, LENGTH = 0.02, 0.017
"""Time from frame to frame, and exposure; s."""


def in_plane(x, y, count=4, pan=(0.0, 0.0), said=FREE) -> Exposures:
    """Frames of velocities along two axes, functions of the time in periods, on 400 pieces."""
    duration = (count - 1) * PERIOD + LENGTH
    clock = np.linspace(0, duration, 401)
    velocity = np.stack([x(clock / PERIOD) + 0 * clock, y(clock / PERIOD) + 0 * clock])
    times = (np.arange(count) - (count - 1) / 2) * PERIOD
    path = FramePath(times, np.full(count, LENGTH), np.full(400, duration / 400), velocity)
    return Exposures(said, path, pan=pan)


def sine(turns, size, phase=0.0):
    return lambda t: size * np.sin(2 * np.pi * (turns * t + phase))


def in_turn(t, first, second):
    """One velocity within even frames and another within odd ones."""
    return np.where(np.floor(t + 0.07) % 2 == 0, first, second)


def saw(t):
    """Velocities that grow over each frame, and sink to the first in the gap after it."""
    part = t % 1.0
    lit = LENGTH / PERIOD
    return np.where(part <= lit, part / lit - 0.5, 0.5 - (part - lit) / (1 - lit))


@pytest.mark.parametrize(
    ("x", "y", "kind"),
    [
        (sine(0.4, 900.0), sine(0.4, 900.0, 0.25), CIRCLE),
        (sine(0.4, 900.0), sine(0.4, -900.0, 0.25), CIRCLE),
        (sine(0.4, 900.0), sine(0.4, 300.0, 0.25), TWO_SINES),
        (sine(0.33, 900.0), sine(0.52, 700.0, 0.2), TWO_SINES),
        (
            lambda t: in_turn(t, 1, 0) * 2e3 * saw(t),
            lambda t: in_turn(t, 0, 1) * 1.7e3 * saw(t),
            CROSSED,
        ),
        (lambda t: in_turn(t, 700.0, -500.0), lambda t: in_turn(t, 200.0, 900.0), RING),
        (lambda t: 700.0, lambda t: -400.0, PAN),
        (lambda t: in_turn(t, 700.0, -500.0), lambda t: 0.5 * in_turn(t, 700.0, -500.0), FAN),
        (lambda t: 900.0 * (t - 1.9), lambda t: 700.0 * (t - 1.9), SWEEP),
        (lambda t: 900.0 * (t + 1), lambda t: 700.0 * (t + 1), FREE),
        (lambda t: 2e3 * saw(t), lambda t: 1.5e3 * saw(t), SWINGS),
        (lambda t: 4e2 * t**2 - 8e2, lambda t: in_turn(t, 1.0, 0.4) * 2e3 * saw(t), FREE),
    ],
    ids=range(12),
)
def test_a_path_in_the_plane_has_a_way(x, y, kind):
    """The tie's own name counts for nothing."""
    assert kind_of(in_plane(x, y, said=RING)) == kind


def test_stills_are_of_one_exposure_or_two():
    """A sensor at rest has no way."""
    rest = in_plane(lambda t: 0.0, lambda t: 0.0, said=CIRCLE)
    assert kind_of(rest) == STILLS
    halves = enumerate((0.02, 0.01, 0.01))
    frames = (TimedFrame(StillCamera(half_exposure=half), 0.1 * k) for k, half in halves)
    assert kind_of(Exposures(FAN, tuple(frames))) == BRACKETED


def along(rates, pan=0.0, turning=0.0) -> Exposures:
    """Frames of constant accelerations along an axis, without a jump between them."""
    frames, end = [], 0.0
    for k, rate in enumerate(rates):
        motion = FreeMotion(accelerations=[rate], half_exposure=0.006, velocity=pan)
        begin, last = (float(motion.position(time)) for time in (-0.006, 0.006))
        frames.append(TimedFrame(motion, 0.013 * k, end - begin))
        end += last - begin + 0.001 * pan
    return Exposures(FREE, tuple(frames), pan=turning)


def test_a_stage_that_pans_as_it_swings_does_not_turn_back():
    """One beside a camera that turns so fast does."""
    rates = [2.1e5, -1.9e5, 2.3e5]
    assert kind_of(along(rates)) == ALTERNATING
    assert kind_of(along(rates, pan=4e3)) == FREE
    assert kind_of(along(rates, pan=4e3, turning=4e3)) == ALTERNATING


def followed(*places: float, turning: float = 0.0) -> Exposures:
    """Frames in which a stage goes 36 px, about some places."""
    motion = LinearMotion(half_exposure=0.006, velocity=3e3)
    frames = (TimedFrame(motion, 0.013 * k, place) for k, place in enumerate(places))
    return Exposures(FAN, tuple(frames), pan=turning)


def test_things_are_followed_where_the_stage_flies_back():
    """Against their velocity between frames; a camera that turns does without."""
    assert (
        kind_of(followed(0.0, 0.0, 0.0, 0.0)) == kind_of(followed(0.0, 30.0, 60.0, 90.0)) == FOLLOW
    )
    assert kind_of(followed(0.0, 39.0, 78.0, 117.0)) == PAN
    assert kind_of(followed(0.0, 39.0, 78.0, 117.0, turning=3e3)) == PAN


def test_flights_are_counted():
    """Frames that share a way have none between them."""
    assert flights_back(followed(0.0, 0.0, 0.0, 0.0)) == 3
    assert flights_back(followed(0.0, 39.0, 0.0, 39.0, 0.0, 39.0)) == 2
    assert flights_back(followed(0.0, 39.0, 78.0, 117.0)) == 0
    assert kind_of(followed(0.0, 39.0, 0.0, 39.0, 0.0, 39.0)) == FOLLOW
