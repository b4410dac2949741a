"""Sequences of frames, in words."""

import numpy as np
import pytest

from mishutter import Exposures, LinearMotion, StillCamera, TimedFrame


def _fan(num_frames, num_rests):
    """A fan of pans after frames at rest, at whose middle the sensor has no velocity."""
    velocities = np.linspace(-900.0, 900.0, num_frames)
    moving = [LinearMotion(half_exposure=0.0025, velocity=v) for v in velocities]
    motions = [StillCamera(half_exposure=0.0016)] * num_rests + moving
    frames = tuple(TimedFrame(each, 0.006 * k) for k, each in enumerate(motions))
    return Exposures("fan of pans", frames, 20.0, 30.0, 29.0)


@pytest.mark.parametrize(
    ("num_frames", "num_rests", "setting"),
    [
        (5, 0, "5 of 5 ms"),
        (9, 7, "7 of 3.2 ms at rest and 9 of 5 ms"),
        (4, 1, "1 of 3.2 ms at rest and 4 of 5 ms"),
    ],
)
def test_the_middle_of_a_fan_is_not_at_rest(num_frames, num_rests, setting):
    """It happens to have no velocity; frames at rest come before those that move."""
    sequence = _fan(num_frames, num_rests)
    assert sequence.num_rests == num_rests
    assert sequence.setting == setting


def test_frames_that_all_stand_still_are_not_called_so():
    """A still burst has a sentence of its own."""
    frames = tuple(TimedFrame(StillCamera(half_exposure=x), 0.01 * x) for x in (0.003, 0.0012))
    assert Exposures("stills", frames, 0.0, 30.0, 29.0).setting == "1 of 6 ms and 1 of 2.4 ms"


LENGTHS = 3e-3, 8e-3, 5e-3
BRACKET = Exposures(
    "three stills",
    tuple(TimedFrame(StillCamera(half_exposure=x / 2), 4 * x) for x in LENGTHS),
    0.0,
    27.0,
    26.0,
)
LIGHTS = np.random.default_rng(5).uniform(0.1, 0.9, (3, 4, 6))


def test_a_sensor_of_one_gain_records_a_frame_by_its_exposure():
    """The longest as it is, and the others as much darker as they are shorter."""
    recorded = BRACKET.of_one_gain(LIGHTS)
    np.testing.assert_allclose(recorded, LIGHTS * np.reshape(LENGTHS, (3, 1, 1)) / 8e-3)
    np.testing.assert_array_equal(recorded[1], LIGHTS[1])


def test_the_frames_of_one_gain_go_back_to_their_own_whites():
    """What `mishutter simulate` writes is what `mishutter restore` reads."""
    recorded = BRACKET.of_one_gain(LIGHTS)
    np.testing.assert_allclose(BRACKET.of_own_whites(recorded), LIGHTS, rtol=1e-15)
