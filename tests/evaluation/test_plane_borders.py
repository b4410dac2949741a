"""What frames in the plane lose by things that enter and leave the sensor."""

from dataclasses import replace

import numpy as np
import pytest
from support.plane import frames_of, scene_of

from mishutter import (
    EvenVelocities,
    ListedVelocities,
    PlaneFrames,
    RingOfVelocities,
    Scene,
    exposures_psnr,
)
from mishutter.evaluation.registration import loss_of_width

SHARP = 1e-5
"""An exposure in which nothing moves by a hundredth of a pixel; s."""


def short(times) -> PlaneFrames:
    """Frames at rest that see no blur."""
    exposures = np.full(len(times), SHARP)
    return PlaneFrames(np.array(times), exposures, np.ones(1), np.zeros((2, 2)))


def moving_at(velocity) -> Scene:
    return Scene.any_direction(ListedVelocities([velocity]), photon_rate=3e8, read_noise=9.0)


def error(scene: Scene, frames: PlaneFrames) -> float:
    return 10 ** (-float(exposures_psnr(scene, frames)) / 10)


@pytest.mark.parametrize(("turn", "sign"), [(0, 1), (1, -1)])
def test_points_that_one_of_two_frames_sees_have_the_error_of_one(turn, sign):
    """Of a thing that drifts by two fifths of the sensor they are two fifths, along either axis."""
    velocity = np.roll([sign * 800.0, 0.0], turn).tolist()
    scene, both = moving_at(velocity), short([-0.005, 0.005])
    own = error(scene, both)
    mean = 0.6 * own + 0.4 * error(scene, short([0.0]))
    loss = loss_of_width(scene, both, width=20.0)
    assert loss == pytest.approx(10 * np.log10(mean / own), rel=2e-3)
    assert loss > 0.3


def test_points_far_from_all_frames_have_the_error_of_no_picture():
    """A thing that is gone from a small sensor in both frames is restored as the mean."""
    scene, frames = moving_at([40000.0, -30000.0]), short([-0.005, 0.005])
    nothing = error(replace(scene, photon_rate=0.0), frames)
    loss = loss_of_width(scene, frames, width=10.0)
    assert loss == pytest.approx(10 * np.log10(nothing / error(scene, frames)), rel=1e-3)


def test_points_that_no_frame_sees_count_by_their_neighbours():
    """Two corners, of a thing that crosses the sensor: worse than seen once, better than nothing.

    The mean is over the whole picture that is restored, of which they are a part.
    """
    scene, both = moving_at([400.0, -800.0]), short([-0.005, 0.005])
    own, one = error(scene, both), error(scene, short([0.0]))
    nothing = error(replace(scene, photon_rate=0.0), both)
    twice, unseen = 0.8 * 0.6, 2 * 0.1 * 0.2
    ends = [twice * own + (1 - twice - unseen) * one + unseen * each for each in (one, nothing)]
    least, most = 10 * np.log10(np.array(ends) / own)
    assert least + 0.5 < loss_of_width(scene, both, width=20.0) < most - 0.5


def test_wide_sensors_lose_little_and_more_drift_loses_more():
    """The loss of two sines falls as the sensor widens, and is above that of frames at rest."""
    scene, sines, still = scene_of("A"), frames_of("A", 4, "sines"), frames_of("A", 4, "still")
    losses = [loss_of_width(scene, sines, width=width) for width in (150.0, 256.0, 900.0, 1e5)]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.01
    assert losses[0] > 0.8
    assert losses[1] > loss_of_width(scene, still, width=256.0) > 0


@pytest.mark.parametrize(
    "law",
    [
        EvenVelocities(2700.0),
        EvenVelocities(2700.0, 400.0, angle=0.7),
        RingOfVelocities(1300.0),
        ListedVelocities([[900.0, -300.0], [20.0, 1700.0]], [3.0, 1.0]),
    ],
)
def test_velocities_that_stand_for_a_law_have_its_moments(law):
    """The mean and the second moment along three directions."""
    angles = np.array([0.3, 1.1, 2.6])
    parts, (velocities, weights) = law.components(angles, 24), law.stand_ins()
    along = velocities @ np.stack([np.cos(angles), np.sin(angles)])
    assert np.sum(weights) == pytest.approx(1)
    for power in (1, 2):
        moments = np.broadcast_to((parts.weights * parts.speeds**power).sum(-1), angles.shape)
        np.testing.assert_allclose(weights @ along**power, moments, rtol=1e-5, atol=1e-3)
